import zipfile

import numpy as np
import pytest

from kennfeld import Axis, Curve, InputError, Map, ParameterSet, Scalar, read_parameters
from kennfeld.cli import run
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from kennfeld.importers.simulink.variables.dictionary_update import update_dictionary
from tests.importers.simulink.simulink_data import entry, sldd, thing
from tests.importers.simulink.simulink_runs import alone, imported


@pytest.fixture
def path(tmp_path):
    axis = thing("Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[700.0, 1500.0]], Unit="rpm", Min=0.0)
    table = thing("Simulink.lookuptable.Table", "Table", Value=[[1.0, 2.0]], Min=0.0, Unit="Nm")
    entries = {
        "K": entry(2.5),
        "Count": thing("Simulink.Parameter", Value=entry(3.0, "int16"), Min=-7.0, Description="a < b > c"),
        "Single": thing("Simulink.Parameter", Value=entry(1.0, "single")),
        # 4 x 3: a transposed table would be another one
        "M": entry(np.arange(12.0).reshape(4, 3)),
        "bp_x": entry([[0.0, 1.0, 2.0, 5.0]]),
        "Eta": thing("Simulink.LookupTable", table=table, axes=axis),
        "other": entry("turbo"),
    }
    (tmp_path / "data.sldd").write_bytes(sldd(entries, ["further.sldd"]))
    return tmp_path / "data.sldd"


def values():
    random = np.random.default_rng(1)
    return ParameterSet(
        [
            Scalar("K", -0.1),
            Scalar("Count", 12.0),
            Scalar("Single", 0.1),
            Map("M", Axis([0, 1.5, 2, 5], name="bp_x"), Axis([1, 2, 4], name="bp_y"), random.normal(size=(4, 3))),
            Curve("Eta", [800, 1600], [3.25, np.inf]),
            Scalar("Elsewhere", 1.0),
        ]
    )


def test_values_and_breakpoints_are_read_back_and_all_else_stays(path):
    result = update_dictionary(values(), path)
    (path.parent / "new.sldd").write_bytes(result.raw)
    before, after = read_dictionary(path, follow=False), read_dictionary(path.parent / "new.sldd", follow=False)
    entries = after.data.entries
    for name in ("K", "Count", "M"):
        np.testing.assert_array_equal(np.squeeze(entries[name].value), values()[name].values)
    assert entries["Single"].value.tolist() == [[float(np.float32(0.1))]]
    assert (entries["Count"].minimum, entries["Count"].description) == (-7.0, "a < b > c")
    assert entries["bp_x"].value.tolist() == [[0.0, 1.5, 2.0, 5.0]]
    assert (entries["Eta"].value.tolist(), entries["Eta"].minimum) == ([[3.25, np.inf]], 0.0)
    assert entries["Eta"].breakpoints[0].value.tolist() == [[800.0, 1600.0]]
    assert entries["other"] == before.data.entries["other"]
    assert after.references == before.references == ("further.sldd",)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(path.parent / "new.sldd") as new:
        assert old.namelist() == new.namelist()
    assert [str(finding) for finding in result.findings] == [
        "data.sldd: the breakpoints of M.y are not written: no entry is known to hold them",
        "data.sldd: has no entry Elsewhere. Change them in the model.",
    ]


def test_the_present_values_give_the_same_numbers(path):
    old = read_dictionary(path, follow=False).data.entries
    same = ParameterSet([Scalar("K", 2.5), Curve("Eta", [700, 1500], [1.0, 2.0])])
    path.with_name("same.sldd").write_bytes(update_dictionary(same, path).raw)
    new = read_dictionary(path.with_name("same.sldd"), follow=False).data.entries
    assert [(name, str(e)) for name, e in old.items()] == [(name, str(e)) for name, e in new.items()]


def test_a_model_computes_with_the_new_values(path, tmp_path):
    drawn = alone(
        "Lookup_n-D", NumberOfTableDimensions="2", Table="M", BreakpointsForDimension1="bp_x",
        BreakpointsForDimension2="[1 2 4]",
    )  # fmt: skip
    new = tmp_path / "new.sldd"
    new.write_bytes(update_dictionary(values(), path).raw)
    table = imported(drawn, tmp_path, parameters=[new]).values["M"]
    np.testing.assert_array_equal(table.values, values()["M"].values)
    np.testing.assert_array_equal(table.axes[0].breakpoints, [0, 1.5, 2, 5])
    assert table.axes[0].name == "bp_x"


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        (Scalar("Nothing", 1.0), "has none of the parameters"),
        (Scalar("Count", 1.5), "Count is of the class int16, which cannot hold 1.5"),
        (Curve("M", [0, 1], [1, 2]), "M has the size 4 x 3, the new values 2"),
        (Scalar("other", 1.0), "other holds no numbers"),
    ],
)
def test_values_that_the_dictionary_cannot_hold_are_refused(parameter, message, path):
    with pytest.raises(InputError, match=message):
        update_dictionary(ParameterSet([parameter]), path)


def test_the_command_writes_a_calibration_into_a_dictionary(path, capsys):
    values().without(["Elsewhere"]).save(path.with_name("new.json"))
    command = ["convert", str(path.with_name("new.json")), str(path.with_name("new.sldd")), "--image", str(path)]
    assert run(command) == 0
    assert read_dictionary(path.with_name("new.sldd"), follow=False).data.entries["K"].value.tolist() == [[-0.1]]
    assert read_parameters(path.with_name("new.json"))["K"].value == -0.1
