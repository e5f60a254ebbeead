"""Subsystems and models whose content is a file of its own."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.importers.simulink.importing import import_simulink, simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

U = np.random.default_rng(3).normal(size=20)


def part(name="filter", gain="k", **options):
    """A file with a subsystem: a gain and a sum with the step before."""
    diagram = Model(name, kind="Subsystem", **options)
    diagram.inport("x")
    diagram.block("Gain", "K", Gain=gain)
    diagram.block("UnitDelay", "Z", SampleTime="-1")
    diagram.block("Sum", "S", ports=(2, 1))
    diagram.outport("y")
    diagram.line("x", "K")
    diagram.line("K", "S:1")
    diagram.line("Z", "S:2")
    diagram.line("S", "Z", "y")
    return diagram


def user(*names, **parameters):
    """A model with subsystems in a row, the content of each in a file."""
    diagram = Model(step="0.1", solver="FixedStepDiscrete")
    diagram.inport("u")
    before = "u"
    for at, name in enumerate(names, 1):
        diagram.block("SubSystem", f"R{at}", ports=(1, 1), ReferencedSubsystem=name, **parameters)
        diagram.line(before, f"R{at}")
        before = f"R{at}"
    diagram.outport("y")
    diagram.line(before, "y")
    return diagram


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
def test_the_content_of_a_subsystem_file_stands_in_its_place(layout, tmp_path):
    part().write(tmp_path, layout)
    model = imported(user("filter", "filter"), tmp_path, layout, parameters=[{"k": 0.5}])
    output = run(model, {"u": U})["y"]
    np.testing.assert_allclose(output, np.cumsum(0.5 * np.cumsum(0.5 * U)), atol=1e-13)
    exact, differences = slopes(model, {"u": U}, "k", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-8)


def test_each_place_sees_the_names_of_the_mask_around_it(tmp_path):
    part(gain="k").write(tmp_path)
    drawn = user("filter")
    drawn.blocks[1].mask = Mask({"k": "2*c"})
    output = run(imported(drawn, tmp_path, parameters=[{"c": 1.5}]), {"u": U})["y"]
    np.testing.assert_allclose(output, np.cumsum(3.0 * U), atol=1e-12)


def test_subsystem_files_in_further_folders_are_followed(tmp_path):
    (tmp_path / "parts").mkdir()
    outer = Model("outer", kind="Subsystem")
    outer.inport("a")
    outer.block("SubSystem", "In", ports=(1, 1), ReferencedSubsystem="filter.slx")
    outer.outport("b")
    outer.chain("a", "In", "b")
    outer.write(tmp_path / "parts")
    part(gain="2").write(tmp_path / "parts")
    model = simulink(user("outer").write(tmp_path), folders=[tmp_path / "parts"])
    np.testing.assert_allclose(run(model, {"u": U})["y"], np.cumsum(2 * U), atol=1e-12)


def test_a_subsystem_file_can_be_imported_by_itself(tmp_path):
    model = simulink(part(gain="2", step="0.1", solver="FixedStepDiscrete").write(tmp_path))
    np.testing.assert_allclose(run(model, {"x": U})["y"], np.cumsum(2 * U), atol=1e-12)


def test_a_missing_subsystem_file_is_reported_with_its_name(tmp_path):
    with pytest.raises(
        InputError, match=r"R1: .*in the file lost, which was not found or does not match. Put lost.slx"
    ):
        imported(user("lost"), tmp_path)


def test_subsystem_files_that_refer_in_a_circle_are_reported(tmp_path):
    for name, to in (("one", "two"), ("two", "one")):
        diagram = Model(name, kind="Subsystem")
        diagram.inport("a")
        diagram.block("SubSystem", "In", ports=(1, 1), ReferencedSubsystem=to)
        diagram.outport("b")
        diagram.chain("a", "In", "b")
        diagram.write(tmp_path)
    result = import_simulink(user("one").write(tmp_path))
    assert result.model is None
    assert any("one -> two -> one" in str(remark) for remark in result.report.remarks)
    with pytest.raises(InputError, match="In"):
        imported(user("one"), tmp_path)


@pytest.mark.parametrize("path", ["../secret", "/etc/passwd", "a b"])
def test_an_invalid_file_name_is_not_searched_for(path, tmp_path):
    with pytest.raises(InputError, match="was not found"):
        imported(user(path), tmp_path)


def test_a_model_is_not_a_subsystem_file(tmp_path):
    other = part("whole")
    other.kind = "Model"
    other.write(tmp_path)
    result = import_simulink(user("whole").write(tmp_path))
    assert result.model is None
    assert any("whole.slx, which is a model" in str(remark) for remark in result.report.remarks)


def scaled(name, code="", **options):
    """A model of a gain and a table that are variables, which its code gives values."""
    diagram = Model(name, step="0.1", solver="FixedStepDiscrete", code=code, **options)
    diagram.inport("x")
    diagram.block("Gain", "K", Gain="k")
    diagram.block("Lookup_n-D", "T", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[-9 0 9]")
    diagram.outport("y")
    diagram.outport("z")
    diagram.chain("x", "K", "y")
    diagram.chain("x", "T", "z")
    return diagram


def around(code=""):
    """A model around two others, which come first in the order of the outports."""
    diagram = Model("top", step="0.1", solver="FixedStepDiscrete", code=code)
    diagram.inport("u")
    for name in ("one", "two"):
        diagram.block("ModelReference", name, ports=(1, 2), ModelNameDialog=name)
        diagram.line("u", name)
        for port in (1, 2):
            diagram.outport(f"{name}{port}")
            diagram.line(f"{name}:{port}", f"{name}{port}")
    diagram.block("Gain", "K", Gain="k")
    diagram.outport("y")
    diagram.chain("u", "K", "y")
    return diagram


def test_variables_of_one_name_in_several_models_are_distinguished(tmp_path):
    scaled("one", "k = 2; Eta = [1 2 3];").write(tmp_path)
    scaled("two", "k = 3; Eta = [4 1 0];").write(tmp_path)
    model = imported(around("k = 5;"), tmp_path)
    outputs = run(model, {"u": U})
    for name, factor, values in (("one", 2, [1, 2, 3]), ("two", 3, [4, 1, 0])):
        np.testing.assert_allclose(outputs[f"{name}1"], factor * U, rtol=1e-13)
        np.testing.assert_allclose(outputs[f"{name}2"], np.interp(U, [-9, 0, 9], values), rtol=1e-12)
    np.testing.assert_allclose(outputs["y"], 5 * U, rtol=1e-13)
    assert {name: one.values.tolist() for name, one in model.values.items()} == {
        "k": 5.0, "k_2": 2.0, "k_3": 3.0, "Eta": [1.0, 2.0, 3.0], "Eta_2": [4.0, 1.0, 0.0],
    }  # fmt: skip
    exact, differences = slopes(model, {"u": U}, "k_3", "two1")
    np.testing.assert_allclose(exact, differences, atol=1e-8)


@pytest.mark.parametrize("visibility", ["global", "scoped"])
def test_tags_of_one_name_in_several_models_are_distinguished(visibility, tmp_path):
    for name, factor in (("one", "2"), ("two", "3")):
        model = Model(name, step="0.1", solver="FixedStepDiscrete")
        model.inport("x")
        model.block("GotoTagVisibility", "V", ports=(0, 0), GotoTag="A")
        inner = model.subsystem("S")
        inner.inport("a")
        inner.block("Gain", "K", Gain=factor)
        inner.block("Goto", "T", ports=(1, 0), GotoTag="A", TagVisibility=visibility)
        inner.chain("a", "K", "T")
        model.block("From", "F", ports=(0, 1), GotoTag="A")
        model.line("x", "S")
        for port in ("y", "z"):
            model.outport(port)
            model.line("F", port)
        model.write(tmp_path)
    outputs = run(imported(around("k = 5;"), tmp_path), {"u": U})
    for name, factor in (("one", 2), ("two", 3)):
        np.testing.assert_allclose(outputs[f"{name}1"], factor * U, rtol=1e-13)


def test_variables_of_one_name_and_value_are_one_parameter(tmp_path):
    for name in ("one", "two"):
        scaled(name, "k = 5; Eta = [1 2 3];").write(tmp_path)
    assert list(imported(around("k = 5;"), tmp_path).values) == ["k", "Eta"]


def test_a_calibration_file_goes_over_the_variable_of_a_referenced_model_that_is_known_there_alone(tmp_path):
    for name in ("one", "two"):
        scaled(name, "k = 2; Eta = [1 2 3];").write(tmp_path)
    calibration = ParameterSet([Scalar("k", 7.0), Curve("Eta", [-9, 0, 9], [0.0, 5.0, 5.0])])
    outputs = run(imported(around("k = 5;"), tmp_path, parameters=[calibration]), {"u": U})
    np.testing.assert_allclose(outputs["y"], 7 * U, rtol=1e-13)
    np.testing.assert_allclose(outputs["one1"], 2 * U, rtol=1e-13)
    np.testing.assert_allclose(outputs["two2"], np.interp(U, [-9, 0, 9], [0.0, 5.0, 5.0]), rtol=1e-12)


def with_arguments(names, values, listed):
    """A model around a model to whose arguments it gives values."""
    diagram = around("a = 4;")
    keys = ("ParameterArgumentNames", "ParameterArgumentValues")
    for block in diagram.blocks:
        if block.name == "one" and listed:
            block.lists = dict(zip(keys, (names, values), strict=True))
        elif block.name == "one":
            block.parameters |= dict(zip(keys, (",".join(names), ",".join(values)), strict=True))
    next(block for block in diagram.blocks if block.name == "K").parameters["Gain"] = "a"
    return diagram


@pytest.mark.parametrize(("layout", "listed"), [("slx parts", True), ("slx parts", False), ("mdl", False)])
def test_arguments_of_a_referenced_model_take_the_values_of_the_block(layout, listed, tmp_path):
    for name in ("one", "two"):
        scaled(name, "k = 2; Eta = [1 2 3];").write(tmp_path, layout)
    model = imported(with_arguments(["k", "Eta"], ["3*a", "[5,6,a]"], listed), tmp_path, layout)
    outputs = run(model, {"u": U})
    np.testing.assert_allclose(outputs["one1"], 12 * U, rtol=1e-13)
    np.testing.assert_allclose(outputs["one2"], np.interp(U, [-9, 0, 9], [5, 6, 4]), rtol=1e-12)
    np.testing.assert_allclose(outputs["two1"], 2 * U, rtol=1e-13)
    exact, differences = slopes(model, {"u": U}, "a", "one1")
    np.testing.assert_allclose(exact, differences, atol=1e-8)


def test_an_argument_without_a_value_keeps_that_of_the_model(tmp_path):
    for name in ("one", "two"):
        scaled(name, "k = 2; Eta = [1 2 3];").write(tmp_path)
    outputs = run(imported(with_arguments(["k"], [""], True), tmp_path), {"u": U})
    np.testing.assert_allclose(outputs["one1"], 2 * U, rtol=1e-13)


def test_a_referenced_model_that_is_imported_by_itself_has_its_own_names(tmp_path):
    for name in ("one", "two"):
        scaled(name, "k = 2; Eta = [1 2 3];").write(tmp_path)
    drawn = with_arguments(["k"], ["3*a"], True)
    for name, factor in (("one", 12), ("two", 2)):
        outputs = run(imported(drawn, tmp_path, subsystem=name), {"x": U})
        np.testing.assert_allclose(outputs["y"], factor * U, rtol=1e-13)
