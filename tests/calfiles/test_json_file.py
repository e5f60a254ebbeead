import json

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text


def findings(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return [str(finding) for finding in caught.value.findings]


def test_the_entries_are_those_of_the_contract(tmp_path):
    speed = Axis([1, 2], input="Speed", unit="rpm", name="AxisSpeed")
    parameters = ParameterSet(
        [
            Scalar("b1", 1.0),
            Map("MapX", [1, 2], [0, 9], [[1, 2], [3, 4]], unit="Nm", description="torque"),
            Curve("C", speed, [1, 2]),
            Block("B", [[1, 2]]),
        ],
        [Text("T", "text")],
        [Axis([5], name="Spare")],
    )
    write(parameters, tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {
        "b1": {"kind": "scalar", "unit": "", "value": 1.0},
        "MapX": {
            "kind": "map",
            "unit": "Nm",
            "description": "torque",
            "x": [1, 2],
            "y": [0, 9],
            "values": [[1, 2], [3, 4]],
        },
        "C": {
            "kind": "curve",
            "unit": "",
            "x_name": "AxisSpeed",
            "x_unit": "rpm",
            "x_input": "Speed",
            "x": [1, 2],
            "values": [1, 2],
        },
        "B": {"kind": "block", "unit": "", "values": [[1, 2]]},
        "T": {"kind": "text", "text": "text"},
        "Spare": {"kind": "axis", "unit": "", "x": [5]},
    }
    assert read(tmp_path / "a.json") == parameters


def test_linear_extrapolation_is_written(tmp_path):
    parameters = ParameterSet([Curve("C", [1, 2], [3, 4], extrapolation="linear"), Curve("D", [1, 2], [3, 4])])
    write(parameters, tmp_path / "a.json")
    entries = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert entries["C"]["extrapolation"] == "linear"
    assert "extrapolation" not in entries["D"]
    assert read(tmp_path / "a.json") == parameters


def test_another_extrapolation_is_reported(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"C": {"kind": "curve", "unit": "", "x": [1, 2], "values": [3, 4], "extrapolation": "cubic"}}')
    assert any('C.extrapolation: must be "clip" or "linear", got \'cubic\'' in finding for finding in findings(path))
    path.write_text('{"K": {"kind": "scalar", "unit": "", "value": 1, "extrapolation": "linear"}}')
    assert any("K.extrapolation: unknown key of a scalar" in finding for finding in findings(path))


def test_a_nonfinite_number_is_null_and_reads_as_nan(tmp_path):
    parameters = ParameterSet([Curve("C", [1, 2], [np.nan, 1]), Scalar("S", np.nan)])
    write(parameters, tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["C"]["values"] == [None, 1]
    assert read(tmp_path / "a.json") == parameters


def test_a_cube_of_four_axes_is_read_back(tmp_path):
    parameters = ParameterSet([Cube("Q", [[1, 2], [1], [1, 2, 3], [4]], np.arange(6).reshape(2, 1, 3, 1))])
    write(parameters, tmp_path / "a.json")
    assert read(tmp_path / "a.json") == parameters


def test_an_empty_set_is_read_back(tmp_path):
    write(ParameterSet(), tmp_path / "a.json")
    assert read(tmp_path / "a.json") == ParameterSet()


def test_two_entries_of_one_name_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.json K: is defined twice"):
        write(ParameterSet([Scalar("K", 1)], [Text("K", "a")]), tmp_path / "a.json")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"kind": "map", "x": [1, 2], "y": [1], "values": [[1], [1, 2]]}, "K.values[1]: must have length 1, got 2"),
        ({"kind": "map", "x": [1, 2], "y": [1], "values": [[1]]}, "K.values: must have length 2, got 1"),
        (
            {"kind": "map", "x": [1, 2], "y": [1], "values": [[1], 2]},
            "K.values[1]: must be a list of length 1, got 2.0",
        ),
        ({"kind": "curve", "x": [1, 2], "values": [1, "a"]}, "K.values[1]: must be a number, got 'a'"),
        ({"kind": "curve", "x": [1, 2], "values": [1, True]}, "K.values[1]: must be a number, got True"),
        ({"kind": "curve", "x": [1, 2], "values": [1, [2]]}, "K.values[1]: must be a number, got a list"),
        ({"kind": "curve", "x": [2, 1], "values": [1, 2]}, "K.x[1]: the axis is not strictly increasing: 1 follows 2"),
        ({"kind": "curve", "x": [1, None], "values": [1, 2]}, "K.x[1]: must be a finite number"),
        ({"kind": "curve", "x": [], "values": []}, "K.x: must be a list of breakpoints, got a list"),
        ({"kind": "curve", "values": [1]}, "K.x: is missing"),
        ({"kind": "scalar", "unit": ""}, "K.value: is missing"),
        ({"kind": "scalar", "value": 1, "unit": 3}, "K.unit: must be a text, got 3.0"),
        ({"kind": "scalar", "value": 1, "values": 3}, "K.values: unknown key of a scalar. Did you mean value?"),
        ({"kind": "maps"}, "K.kind: unknown kind 'maps'. Did you mean map?"),
        ({"kind": "block", "values": 3}, "K.values: must have one to four dimensions, got 0"),
        ({"kind": "block", "values": [[1, 2], [3]]}, "K.values[1]: must have length 2, got 1"),
    ],
)
def test_errors_are_reported_with_their_path(written, entry, message):
    path = written(json.dumps({"K": entry}), "p.json")
    assert any(finding.startswith(f"p.json {message}") for finding in findings(path))


def test_all_problems_are_reported_at_once(written):
    path = written('{"A": 3, "B": {"kind": "scalar", "value": "x"}, "B": {"kind": "scalar"}}', "p.json")
    messages = "\n".join(findings(path))
    assert "A: must be an object" in messages
    assert "p.json B: is defined twice" in messages


def test_a_group_axis_with_other_breakpoints_in_another_table_is_refused(written):
    entry = {"kind": "curve", "x_name": "G", "x": [1], "values": [1]}
    path = written(json.dumps({"A": entry, "B": entry | {"x": [2]}}), "p.json")
    assert findings(path) == ["p.json B.x: group axis G has other breakpoints in A"]


@pytest.mark.parametrize("text", ['{"A": {"kind": "sca', "{" * 100_000, '{"A": ' + "[" * 100_000, '{"A": 1} x'])
def test_broken_json_is_refused_with_its_line(written, text):
    assert len(findings(written(text, "p.json"))) == 1


def test_json_of_another_kind_is_refused_in_one_sentence(written):
    assert findings(written('{"a": {"b": 1}, "c": 2}', "p.json"))[0].startswith("p.json: is JSON, but contains no")
