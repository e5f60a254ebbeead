"""Properties that the format of a calibration file cannot state stay as in the project, for any format."""

import numpy as np
import pytest

from kennfeld import Curve, ParameterSet, Scalar, read_parameters
from kennfeld.domain.axis import Axis
from kennfeld.project import Project

TOML = """\
model.file = "f.kf"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "y"
target = "m"
[parameters.C]
x = { input = "x", breakpoints = [0, 5, 10] }
initial = [0, 1, 3]
bounds = [-1, 9]
extrapolation = "linear"
lock = [{ x = [0, 0] }]
"""
FORMATS = (".json", ".dcm", ".cdfx", ".csv", ".xlsx", ".mat", ".m")


@pytest.fixture
def project(tmp_path):
    (tmp_path / "f.kf").write_text("input x[rpm]\ny = C(x)\n", encoding="utf-8")
    (tmp_path / "d.csv").write_text("x,m\n-5,0\n5,1\n15,5\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(TOML, encoding="utf-8")
    return Project.read(tmp_path / "kennfeld.toml")


@pytest.mark.parametrize("ending", FORMATS)
def test_values_of_any_format_are_simulated_equally(project, ending):
    file = project.path.with_name(f"values{ending}")
    project.problem().parameters.save(file)
    [simulated] = project.simulate(project.read_values(file))
    np.testing.assert_array_equal(simulated["y"].values, [-1.0, 1.0, 5.0])


@pytest.mark.parametrize("ending", FORMATS)
def test_a_completed_set_equals_the_original(project, ending):
    file = project.path.with_name(f"values{ending}")
    whole = project.problem().parameters
    whole.save(file)
    completed = read_parameters(file).completed(whole)["C"]
    for name in ("axes", "extrapolation", "lower", "upper", "locked", "unit"):
        np.testing.assert_array_equal(getattr(completed, name), getattr(whole["C"], name))


@pytest.mark.parametrize("ending", FORMATS)
def test_a_file_without_extrapolation_has_that_of_the_project(project, ending):
    file = project.path.with_name(f"values{ending}")
    ParameterSet([Curve("C", Axis([0.0, 5.0, 10.0], input="x"), [0.0, 1.0, 3.0])]).save(file)
    [simulated] = project.simulate(project.read_values(file))
    np.testing.assert_array_equal(simulated["y"].values, [-1.0, 1.0, 5.0])


def test_properties_stated_by_a_file_take_precedence(project):
    project.path.write_text(TOML.replace('extrapolation = "linear"\n', ""), encoding="utf-8")
    file = project.path.with_name("values.json")
    continued = Curve("C", Axis([0.0, 5.0, 10.0], input="x"), [0.0, 1.0, 3.0], extrapolation="linear")
    ParameterSet([continued]).save(file)
    clipping = Project.read(project.path)
    [simulated] = clipping.simulate(clipping.read_values(file))
    np.testing.assert_array_equal(simulated["y"].values, [-1.0, 1.0, 5.0])


def test_a_set_from_python_is_not_completed(project):
    clipped = ParameterSet([Curve("C", Axis([0.0, 5.0, 10.0], input="x"), [0.0, 1.0, 3.0])])
    [simulated] = project.simulate(clipped)
    np.testing.assert_array_equal(simulated["y"].values, [0.0, 1.0, 3.0])
    assert clipped.completed(project.problem().parameters) is clipped


@pytest.mark.parametrize(
    "change",
    [
        lambda values: values.with_parameters(Scalar("K", 3.0)),
        lambda values: values.with_parameters(values["C"].with_values([0.0, 1.0, 3.0])),
        lambda values: ParameterSet([Scalar("K", 3.0)]).merged(values),
        lambda values: ParameterSet().merged(values),
        lambda values: values.select(["C"]),
        lambda values: values.without(["K"]),
        lambda values: values.from_origin(None),
        lambda values: ParameterSet(values.values()),
    ],
)
def test_values_of_a_file_are_simulated_equally_in_any_set(project, change):
    file = project.path.with_name("values.dcm")
    project.problem().parameters.save(file)
    [simulated] = project.simulate(change(project.read_values(file)))
    np.testing.assert_array_equal(simulated["y"].values, [-1.0, 1.0, 5.0])


def test_a_variant_of_a_file_is_completed():
    values = [Curve("C", [0.0, 1.0], [0.0, k], variant=f"Engine={k}") for k in (1, 2)]
    stored = ParameterSet(values[:1], others=values[1:]).read_without(["extrapolation", "bounds"])
    parameters = ParameterSet([Curve("C", [0.0, 1.0], [0.0, 0.0], extrapolation="linear", lower=0.0)])
    completed = stored.in_variant("Engine=2").completed(parameters)["C"]
    assert (completed.values[1], completed.extrapolation, completed.lower[1]) == (2.0, "linear", 0.0)


def test_each_parameter_of_a_merged_set_is_completed_by_its_own_file():
    parameters = ParameterSet([Curve(name, [0.0, 1.0], [0.0, 0.0], extrapolation="linear", lower=0.0) for name in "AB"])
    stored = {name: ParameterSet([Curve(name, [0.0, 1.0], [0.0, 1.0])]) for name in "AB"}
    merged = stored["A"].read_without(["extrapolation"]).merged(stored["B"].read_without(["bounds"]))
    completed = merged.completed(parameters)
    assert [completed[name].extrapolation for name in "AB"] == ["linear", "clip"]
    assert [completed[name].limited for name in "AB"] == [False, True]
    assert merged.unstated == {"extrapolation", "bounds"}


def test_properties_changed_in_python_take_precedence():
    parameters = ParameterSet([Curve("C", [0.0, 1.0], [0.0, 0.0], extrapolation="linear", lower=0.0, locked=True)])
    stored = ParameterSet([Curve("C", [0.0, 1.0], [0.0, 1.0])], unstated=["extrapolation", "bounds", "locks"])
    for changes in ({"extrapolation": "clip"}, {"lower": -np.inf}, {"locked": False}):
        changed = stored["C"].changed(**changes)
        completed = stored.with_parameters(changed).completed(parameters)["C"]
        for name in changes:
            np.testing.assert_array_equal(getattr(completed, name), getattr(changed, name))
    freed = stored["C"].read_without(["free axes"]).changed(axes=[Axis([0.0, 1.0], free=True)])
    assert ParameterSet([freed]).completed(parameters)["C"].axes[0].free


def test_a_file_with_other_breakpoints_keeps_the_extrapolation(project):
    file = project.path.with_name("values.dcm")
    ParameterSet([Curve("C", [0.0, 10.0], [0.0, 3.0])]).save(file)
    [simulated] = project.simulate(project.read_values(file))
    np.testing.assert_allclose(simulated["y"].values, [-1.5, 1.5, 4.5])


def test_an_image_is_read_by_the_description_of_the_project(project):
    from tests.calfiles.a2l_files import axis, hex_file, label, layout, method, module

    folder = project.path.parent
    blocks = (
        layout("FNC_VALUES 1 UBYTE COLUMN_DIR DIRECT"),
        method("CM", "RAT_FUNC", "COEFFS 0 100 0 0 0 1"),
        label("CURVE", axis("FIX_AXIS", 3, "FIX_AXIS_PAR_DIST 0 5 3"), name="C", conversion="CM", limits="0 2.5"),
    )
    (folder / "ecu.a2l").write_bytes(module(*blocks))
    (folder / "ecu.hex").write_bytes(hex_file({0x1000: bytes([0, 100, 200])}))
    (folder / "delivery").mkdir()
    (folder / "delivery" / "new.hex").write_bytes(hex_file({0x1000: bytes([0, 50, 150])}))
    project.path.write_text(f'calibration.initial = "ecu.hex"\n{TOML.replace("initial = [0, 1, 3]", "")}', "utf-8")
    again = Project.read(project.path)
    [simulated] = again.simulate(again.read_values(folder / "delivery" / "new.hex"))
    np.testing.assert_allclose(simulated["y"].values, [-0.5, 0.5, 2.5])


@pytest.mark.parametrize("ending", FORMATS)
def test_a_later_initial_file_keeps_properties_that_it_cannot_state(tmp_path, ending):
    axis = Axis([0.0, 5.0, 10.0], input="x")
    curve = Curve("C", axis, [0.0, 1.0, 3.0], lower=-1.0, upper=9.0, extrapolation="linear")
    ParameterSet([curve]).save(tmp_path / "first.json")
    ParameterSet([Curve("C", axis, [0.0, 2.0, 6.0])]).save(tmp_path / f"second{ending}")
    (tmp_path / "f.kf").write_text("input x\ny = C(x)\n", encoding="utf-8")
    (tmp_path / "d.csv").write_text("x,m\n-5,0\n5,1\n15,5\n", encoding="utf-8")
    text = TOML.partition("[parameters")[0] + f'[calibration]\ninitial = ["first.json", "second{ending}"]\n'
    (tmp_path / "kennfeld.toml").write_text(text, encoding="utf-8")
    problem = Project.read(tmp_path / "kennfeld.toml").problem()
    assert problem.parameters["C"].values.tolist() == [0.0, 2.0, 6.0]
    assert problem.parameters["C"].extrapolation == "linear"
