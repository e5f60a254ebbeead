"""Text to model: the paper's Figure 3, files, extensions, expressions."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import InputError, Location
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import expression, extend, formula, read

FIGURE_3 = """\
1 trqOpt[-] = MapOptTorque(Speed,Rel_Airmass)
2 ignOpt[-] = MapOptIgnition(Speed,Rel_Airmass)
3 deltaSpark[-] = ignOpt - Ignition
4 etaSpark[-] = CurveEtaDeltaSpark(deltaSpark)
5 product[-] = trqOpt * etaSpark
6 dragTorque[-] = MapDragTorque(Speed,Rel_Airmass)
7 TorquePredict[-] = product - dragTorque
"""
TABLES = {"MapOptTorque": 2, "MapOptIgnition": 2, "CurveEtaDeltaSpark": 1, "MapDragTorque": 2}


@pytest.mark.parametrize("parameters", [None, list(TABLES)])
@pytest.mark.parametrize("blank", [" ", "\t"])
def test_figure_3_is_read_verbatim(parameters, blank):
    model = formula(FIGURE_3.replace(" ", blank), "torque.kf", parameters)
    assert model.graph.inputs == ("Speed", "Rel_Airmass", "Ignition")
    assert model.graph.parameters == TABLES
    assert model.graph.outputs == ("TorquePredict",)
    assert list(model.graph.names) == [
        "trqOpt",
        "ignOpt",
        "deltaSpark",
        "etaSpark",
        "product",
        "dragTorque",
        "TorquePredict",
    ]


def test_a_place_is_kept_for_every_name():
    places = {name: str(location) for name, location in formula(FIGURE_3, "torque.kf").locations.items()}
    assert places["etaSpark"] == "torque.kf line 4"
    assert places["CurveEtaDeltaSpark"] == "torque.kf line 4, column 17"
    assert places["Ignition"] == "torque.kf line 3, column 28"


def test_declarations_make_a_text_complete():
    model = formula(
        """
        step 0.01
        input n[1/min]
        input unused[K]
        scalar K[Nm]
        cube Q
        cube R
        output y
        z[W] = Q(n, n, n, n) * K
        y[%] = z / 2
        w = y
        """
    )
    assert model.step == 0.01
    assert model.declared == {"K": 0, "Q": 4, "R": 3}
    assert model.graph.outputs == ("y",)
    assert model.graph.units == {"n": "1/min", "K": "Nm", "z": "W", "y": "%"}
    assert (model.name, model.source) == ("formula", "formula")


def test_a_text_without_nodes_is_an_error():
    with pytest.raises(InputError, match="the text defines no node"):
        formula("# nothing\ninput u", "torque.kf")


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_file_is_read_with_and_without_a_byte_order_mark(tmp_path: Path, mark: bytes):
    path = tmp_path / "torque.KF"
    path.write_bytes(mark + "T[°C] = Öl * 2\r\n".encode())
    model = read(path)
    assert (model.name, model.source) == ("torque", str(path))
    assert str(model.locations["T"]) == "torque.KF line 1"
    assert model.graph.units == {"T": "°C"}


def test_a_file_is_read_with_known_parameters(tmp_path: Path):
    path = tmp_path / "torque.kf"
    path.write_text("y = K * u")
    assert read(path, ["K"]).graph.parameters == {"K": 0}


@pytest.mark.parametrize(
    ("name", "content", "finding"),
    [
        ("m.slx", b"y = u", "not a formula text file. Formula text files have the extension .kf."),
        ("m.kf", b"PK\x03\x04\x00\x00", "the file is binary, not text. Formula text must be UTF-8."),
        (
            "m.kf",
            "a = u\nT[°C] = u".encode("latin-1"),
            "m.kf line 2: byte 0xb0 is not valid UTF-8. Save the file as UTF-8.",
        ),
        ("m.kf", None, "the file cannot be read: No such file or directory"),
        ("m.kf", b"y = u +", "m.kf line 1, column 8: incomplete expression"),
    ],
)
def test_a_file_that_cannot_be_read_is_an_error(tmp_path: Path, name: str, content: bytes | None, finding: str):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        read(tmp_path / name)
    assert str(caught.value).endswith(finding)


def test_a_folder_is_refused(tmp_path: Path):
    (tmp_path / "m.kf").mkdir()
    with pytest.raises(InputError, match="the file cannot be read"):
        read(tmp_path / "m.kf")


def test_an_extension_adds_nodes_over_those_of_the_model():
    model = formula("n[rpm] = PT1(u * K, 0.5)\nscalar K\noutput n", "idle.kf")
    more = extend(
        model, {"deviation": "abs(n_set - n)", "worst": "max(deviation, K)"}, Location("kennfeld.toml limit 1")
    )
    assert more.graph.inputs == ("u", "n_set")
    assert more.graph.outputs == ("n", "deviation", "worst")
    assert more.graph.units == {"n": "rpm"}
    limit = Location("kennfeld.toml limit 1")
    assert more.locations == {**model.locations, "deviation": limit, "worst": limit}
    columns = {"u": np.array([1.0, 2.0, 3.0]), "n_set": np.array([5.0, 5.0, 5.0]), "dt": np.full(3, 0.1)}
    parameters = ParameterSet([Scalar("K", 2.0)])
    run = evaluate(more.graph, columns, parameters)
    n = evaluate(model.graph, columns, parameters)["n"]
    np.testing.assert_array_equal(run["n"], n)
    np.testing.assert_array_equal(run["worst"], np.maximum(abs(5 - n), 2))


def test_an_extension_shares_memory_with_the_model():
    model = formula("y = prev(u, 0) * 2")
    assert len(extend(model, {"z": "prev(u, 0) * 3"}, Location("limit")).graph.states) == 1


def test_an_extension_leaves_the_model_as_it_is():
    model = formula("y = u * 2")
    before = model.graph
    extend(model, {"z": "y * 3"}, Location("limit"))
    assert model.graph == before
    assert list(before.names) == ["y"]


def test_findings_of_an_extension_show_its_expression():
    with pytest.raises(InputError) as caught:
        extend(formula("y = u"), {"z": "abs(y"}, Location("kennfeld.toml limit 2"))
    assert str(caught.value) == "kennfeld.toml limit 2, column 4: unclosed parenthesis"
    assert caught.value.findings[0].excerpt == "abs(y\n   ^"


def test_an_expression_is_the_graph_of_its_value():
    graph = expression("air / n * 1000", Location("kennfeld.toml"), ["air", "n", "unused"])
    assert graph.inputs == ("air", "n")
    assert list(graph.names) == ["value"]
    assert evaluate(graph, {"air": np.array([3.0]), "n": np.array([2.0])}, ParameterSet())["value"] == [1500.0]


def test_an_expression_may_have_memory_and_several_lines():
    graph = expression("derivative(n)  # slope\n + value", Location("kennfeld.toml where"))
    assert graph.inputs == ("n", "value")
    with pytest.raises(InputError, match="where line 2, column 3: incomplete expression"):
        expression("n\n +", Location("kennfeld.toml where"))


@pytest.mark.parametrize("text", ["", "  ", "# none"])
def test_an_empty_expression_is_an_error(text):
    with pytest.raises(InputError, match="here, column 1: incomplete expression"):
        expression(text, Location("here"))
