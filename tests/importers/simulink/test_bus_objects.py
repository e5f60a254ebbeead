"""Buses whose objects scripts, MAT-files or dictionaries define: names, widths and nesting of their elements."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_data import Thing, entry, matfile, sldd, thing
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run

U, V, W = np.random.default_rng(48).normal(size=(3, 5))
SCRIPT = """
v = Simulink.BusElement; v.Name = 'v'; v.Dimensions = 3; v.Unit = 'rpm';
w = Simulink.BusElement; w.Name = 'w'; w.DataType = 'Bus: C';
B = Simulink.Bus; B.Elements = [v w];
C = Simulink.Bus; C.Elements(1) = Simulink.BusElement; C.Elements(1).Name = 'x'; C.Elements(1).Dimensions = [2 2];
"""
CELLS = """function cellInfo = buses(varargin)
if nargin > 1
    error('Invalid input argument(s) encountered');
end
cellInfo = {{'B', 'b.h', sprintf(''), {
    {'v', 3, 'double', -1, 'real', 'Sample', 'Fixed', [], [], 'rpm', 'speed'};
    {'w', 1, 'C', -1, 'real', 'Sample'}}}
  {'C', '', '', {{'x', [2 2], 'single', -1, 'real', 'Sample'}}}};
Simulink.Bus.cellToObject(cellInfo)
end
"""


def fixed_step(**options):
    return Model(step="0.1", solver="FixedStepDiscrete", **options)


def selecting(selected="v", kind="Sum", **parameters):
    """A model that selects a signal of an inport of the bus B and gives it to a block of one output."""
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals=selected)
    drawn.block(kind, "S", ports=(1, 1), **(parameters or {"Inputs": "+"}))
    drawn.outport("y")
    drawn.chain("In", "Pick", "S", "y")
    return drawn


def script(folder, text=SCRIPT):
    path = folder / "buses.m"
    path.write_text(text)
    return path


def stored_element(name, size, kind="double"):
    return Thing("Simulink.BusElement", {"Name": name, "Dimensions": size, "DataType": kind, "Unit": "rpm"})


def mat(folder):
    parts = [stored_element("v", 3.0), stored_element("w", 1.0, "Bus: C")]
    inner = stored_element("x", np.array([[2.0, 2.0]]))
    path = folder / "buses.mat"
    path.write_bytes(
        matfile({"B": Thing("Simulink.Bus", {"Elements": parts}), "C": Thing("Simulink.Bus", {"Elements": inner})})
    )
    return path


def dictionary(folder, suffix=""):
    def elements(*listed):
        written = "".join(
            f'<Element Class="Simulink.BusElement">{entry(name, name="Name")}{entry(size, name="Dimensions")}'
            f"{entry(kind, name='DataType' + suffix)}{entry('rpm', name='DocUnits')}</Element>"
            for name, size, kind in listed
        )
        return thing("Simulink.Bus", Elements=f'<P Name="Elements{suffix}">{written}</P>')

    path = folder / "buses.sldd"
    buses = {
        "B": elements(("v", 3.0, "double"), ("w", 1.0, "Bus: C")),
        "C": elements(("x", [2.0, 2.0], "single")),
    }
    path.write_bytes(sldd(buses))
    return path


SOURCES = {
    "script": script,
    "cells": lambda folder: script(folder, CELLS),
    "objects of a function": lambda folder: script(
        folder, f"define()\nfunction define\n{SCRIPT}\nassignin('base', 'B', B);\nassignin('base', 'C', C);\nend\n"
    ),
    "names in lower case": lambda folder: script(
        folder, SCRIPT.replace(".Name", ".name").replace(".Dimensions", ".dimensions")
    ),
    "MAT-file": mat,
    "dictionary": dictionary,
    "dictionary of a newer release": lambda folder: dictionary(folder, "_internal"),
}


@pytest.mark.parametrize("source", SOURCES)
def test_elements_have_the_widths_of_their_object(source, tmp_path):
    model = imported(selecting(), tmp_path, parameters=[SOURCES[source](tmp_path)])
    assert model.graph.inputs == ("In.v[1]", "In.v[2]", "In.v[3]")
    outputs = run(model, {"In.v[1]": U, "In.v[2]": V, "In.v[3]": W})
    np.testing.assert_allclose(outputs["y"], U + V + W)
    assert not any("width" in str(remark) for remark in model.remarks)


def test_an_element_of_an_enumerated_type_keeps_its_width(tmp_path):
    gears = [stored_element("v", 3.0, "Enum: Gear"), stored_element("g", 1.0, "Enum: Gear")]
    path = tmp_path / "gears.mat"
    path.write_bytes(matfile({"B": Thing("Simulink.Bus", {"Elements": gears})}))
    model = imported(selecting(), tmp_path, parameters=[path])
    assert model.graph.inputs == ("In.v[1]", "In.v[2]", "In.v[3]")


@pytest.mark.parametrize("source", SOURCES)
def test_elements_of_buses_in_buses_are_matrices_column_by_column(source, tmp_path):
    rows = selecting("w.x", Inputs="+", CollapseMode="Specified dimension", CollapseDim="2")
    model = imported(rows, tmp_path, parameters=[SOURCES[source](tmp_path)])
    names = [f"In.w.x[{at}]" for at in range(1, 5)]
    outputs = run(model, dict(zip(names, (U, V, W, 2 * U), strict=True)))
    np.testing.assert_allclose(outputs["y[1]"], U + W)
    np.testing.assert_allclose(outputs["y[2]"], V + 2 * U)


def test_an_unknown_width_is_reported_with_the_bus_that_is_not_defined(tmp_path):
    result = import_simulink(selecting().write(tmp_path))
    assert result.model.graph.inputs == ("In.v",)
    remark = next(str(finding) for finding in result.report.remarks if "width" in finding.message)
    assert remark.startswith("the width of In.v is unknown, assumed 1: the bus B is not defined. Give its Simulink.Bus")
    assert remark in map(str, result.model.remarks) or any("In.v" in str(note) for note in result.model.remarks)


def test_the_unit_of_an_element_is_that_of_the_input(tmp_path):
    model = imported(selecting("w.x"), tmp_path, parameters=[script(tmp_path, SCRIPT + "C.Elements(1).Dimensions = 1;"
                                                                    "C.Elements(1).Unit = 'K';")])  # fmt: skip
    assert model.graph.inputs == ("In.w.x",)
    assert model.graph.units["In.w.x"] == "K"


@pytest.mark.parametrize(
    ("kind", "parameters", "message"),
    [
        ("Demux", {"Outputs": "4"}, "S: a vector of 3 elements cannot be split into 4 outputs"),
        ("Selector", {"Indices": "[1:6]"}, r"S: its index \[1:6\] is out of range for 3 elements"),
        ("Gain", {"Gain": "[1 2]"}, "S: its inputs have the sizes 2, 3, which do not match"),
        ("Gain", {"Gain": "[1 2]", "Multiplication": "Matrix(K*u)"}, "S: matrices of size 1 x 2 and 3 x 1 cannot be"),
        ("Reshape", {"OutputDimensionality": "Customize", "OutputDimensions": "[2 2]"}, "S: 3 elements cannot be"),
    ],
)
def test_a_width_that_contradicts_a_later_block_names_both(kind, parameters, message, tmp_path):
    drawn = selecting("v", kind, **parameters)
    with pytest.raises(InputError, match=f"{message}.*; In.v has 3 elements by the bus B of buses.m"):
        imported(drawn, tmp_path, parameters=[script(tmp_path)])


def test_the_width_of_a_bus_stays_known_through_operations_by_elements(tmp_path):
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="v")
    drawn.block("Gain", "K", Gain="2")
    drawn.block("Demux", "D", ports=(1, 4), Outputs="4")
    drawn.outport("y")
    drawn.chain("In", "Pick", "K", "D", "y")
    with pytest.raises(InputError, match=r"D: a vector of 3 elements .* In.v has 3 elements by the bus B of buses.m"):
        imported(drawn, tmp_path, parameters=[script(tmp_path)])
    # without the object, the block says how many there are
    result = import_simulink(drawn.write(tmp_path))
    assert result.model.graph.inputs == ("In.v[1]", "In.v[2]", "In.v[3]", "In.v[4]")
    sentence = "the width of In.v is unknown, assumed 4, as D requires: the bus B is not defined"
    assert any(sentence in str(finding) for finding in result.report.remarks)


@pytest.mark.parametrize(
    ("kind", "parameters", "expected"),
    [
        ("Selector", {"Indices": "[1 6]"}, {"y[1]": "In.v[1]", "y[2]": "In.v[6]"}),
        ("Selector", {"Indices": "[0 2]", "IndexMode": "Zero-based"}, {"y[1]": "In.v[1]", "y[2]": "In.v[3]"}),
        ("Selector", {"Indices": "2", "InputPortWidth": "5"}, {"y": "In.v[2]"}),
    ],
)
def test_an_unknown_width_follows_from_the_block_that_selects(kind, parameters, expected, tmp_path):
    model = imported(selecting("v", kind, **parameters), tmp_path)
    samples = {name: U + at for at, name in enumerate(model.graph.inputs)}
    assert set(samples) == set(expected.values())
    outputs = run(model, samples)
    for output, name in expected.items():
        np.testing.assert_array_equal(outputs[output], samples[name])


def test_two_blocks_that_require_different_widths_are_both_named(tmp_path):
    drawn = selecting("v", "Demux", Outputs="3")
    drawn.block("Demux", "T", ports=(1, 5), Outputs="5")
    drawn.outport("z")
    drawn.chain("T", "z")
    drawn.line("Pick", "T")
    message = "T: a vector of 3 elements cannot be split into 5 outputs; the width of In.v is unknown, assumed 3, as S"
    with pytest.raises(InputError, match=f"{message} requires: the bus B is not defined"):
        imported(drawn, tmp_path)


def test_an_element_that_the_object_lacks_is_named_with_the_known_ones(tmp_path):
    with pytest.raises(InputError, match="Pick: it selects q, but the bus contains v, w"):
        imported(selecting("q"), tmp_path, parameters=[script(tmp_path)])


def test_a_bus_within_a_bus_may_be_undefined(tmp_path):
    result = import_simulink(selecting("w.x").write(tmp_path), parameters=[script(tmp_path, "clear C;" + SCRIPT
                                                                                  + "clear C")])  # fmt: skip
    assert result.model.graph.inputs == ("In.w.x",)
    assert any("width of In.w.x is unknown, assumed 1: the bus C is not" in str(f) for f in result.report.remarks)


def test_a_bus_that_contains_itself_is_refused(tmp_path):
    circle = "B = Simulink.Bus; B.Elements(1) = Simulink.BusElement; B.Elements(1).DataType = 'Bus: B';"
    with pytest.raises(InputError, match=r"In: the bus B of buses.m contains itself"):
        imported(selecting(), tmp_path, parameters=[script(tmp_path, circle)])


def test_an_array_of_buses_has_numbered_elements(tmp_path):
    arrays = SCRIPT.replace("w.DataType = 'Bus: C';", "w.DataType = 'Bus: C'; w.Dimensions = 2;")
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.outport("y")
    drawn.chain("In", "y")
    model = imported(drawn, tmp_path, parameters=[script(tmp_path, arrays)])
    assert {name for name in model.graph.outputs if "w" in name} == {
        f"y.w.({bus}).x[{at}]" for bus in (1, 2) for at in range(1, 5)
    }
    assert "In.w(2).x[3]" in model.graph.inputs


@pytest.mark.parametrize(("kind", "inputs"), [("Sum", "+"), ("Product", "*"), ("MinMax", "1")])
def test_a_result_of_all_elements_of_an_inherited_width_says_so(kind, inputs, tmp_path):
    drawn = fixed_step()
    drawn.inport("u")
    drawn.block(kind, "S", ports=(1, 1), Inputs=inputs)
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    report = import_simulink(drawn.write(tmp_path)).report
    sentence = "S combines the elements of its input: the width of u is unknown, assumed 1: its port inherits it"
    assert any(sentence in str(finding) for finding in report.remarks)


def test_a_value_type_gives_a_port_its_dimensions(tmp_path):
    drawn = fixed_step()
    drawn.inport("u", OutDataTypeStr="ValueType: T")
    drawn.block("Sum", "S", ports=(1, 1), Inputs="+")
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    text = "T = Simulink.ValueType; T.Dimensions = [1 2]; T.DataType = 'single';"
    model = imported(drawn, tmp_path, parameters=[script(tmp_path, text)])
    assert model.graph.inputs == ("u[1]", "u[2]")


def constant_bus(value, selected="v", **parameters):
    """A model that selects a signal of a constant."""
    drawn = fixed_step()
    drawn.inport("u")
    drawn.block("Constant", "K", Value=value, **parameters)
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals=selected)
    drawn.block("Product", "P", ports=(2, 1))
    drawn.outport("y")
    drawn.chain("K", "Pick", "P", "y")
    drawn.line("u", "P:2")
    return drawn


@pytest.mark.parametrize("value", ["S", "struct('v', [1 2 3], 'w', struct('x', [4 6; 5 7]))"])
@pytest.mark.parametrize(("selected", "numbers"), [("v", [1, 2, 3]), ("w.x", [4, 5, 6, 7])])
def test_a_constant_of_a_struct_is_a_bus(value, selected, numbers, tmp_path):
    text = SCRIPT + "S.v = [1 2 3]; S.w.x = [4 6; 5 7];"
    model = imported(
        constant_bus(value, selected, OutDataTypeStr="Bus: B"), tmp_path, parameters=[script(tmp_path, text)]
    )
    outputs = run(model, {"u": U})
    for at, number in enumerate(numbers, 1):
        np.testing.assert_allclose(outputs[f"y[{at}]"], number * U)
    # the numbers of a variable are parameters, those of an expression are not
    assert list(model.values) == ([f"S.{selected}"] if value == "S" else [])


def test_a_constant_of_a_parameter_object_is_a_bus(tmp_path):
    text = "S = Simulink.Parameter; S.Value = struct('v', 2.5);"
    model = imported(constant_bus("S"), tmp_path, parameters=[script(tmp_path, text)])
    np.testing.assert_allclose(run(model, {"u": U})["y"], 2.5 * U)


def test_a_number_is_the_value_of_all_elements_of_a_constant_bus(tmp_path):
    model = imported(constant_bus("2", "w.x", OutDataTypeStr="Bus: B"), tmp_path, parameters=[script(tmp_path)])
    np.testing.assert_allclose(run(model, {"u": U})["y[3]"], 2 * U)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("struct('v', [1 2])", r"K: its element v has size 2, but the bus B of buses.m specifies 3"),
        ("struct('q', 1)", r"K: it contains q, but the bus B of buses.m specifies v, w"),
        ("struct('w', 1)", ""),
        ("struct('v', struct('a', 1))", r"K: its element v is a bus, but the bus B of buses.m specifies numbers"),
    ],
)
def test_a_constant_must_have_the_elements_of_its_bus(value, message, tmp_path):
    drawn = constant_bus(value, OutDataTypeStr="Bus: B")
    if not message:
        model = imported(drawn, tmp_path, parameters=[script(tmp_path)])
        np.testing.assert_array_equal(run(model, {"u": U})["y[1]"], 0 * U)
        return
    with pytest.raises(InputError, match=message):
        imported(drawn, tmp_path, parameters=[script(tmp_path)])


def creating(names, source="In", **parameters):
    """A model of a Bus Creator of the bus D over signals of these names, of which one is selected."""
    drawn = fixed_step()
    drawn.block("BusCreator", "C", ports=(len(names), 1), Inputs=str(len(names)), **parameters)
    for at, name in enumerate(names, 1):
        drawn.inport(f"u{at}")
        drawn.line(f"u{at}", f"C:{at}", name=name)
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="b")
    drawn.outport("y")
    drawn.chain("C", "Pick", "y")
    return drawn


TWO = "D = Simulink.Bus; D.Elements = [Simulink.BusElement; Simulink.BusElement]; D.Elements(2).Name = 'b';"


@pytest.mark.parametrize(
    "fields",
    [{"OutDataTypeStr": "Bus: D"}, {"OutDataTypeStr": "bus :D"}, {"UseBusObject": "On", "BusObject": "D"}],
)
@pytest.mark.parametrize(("names", "renamed"), [(["a", "other"], "other as b"), (["b", "a"], "b as a, a as b")])
def test_a_bus_creator_names_its_elements_as_the_object(fields, names, renamed, tmp_path):
    result = import_simulink(creating(names, **fields).write(tmp_path), parameters=[script(tmp_path, TWO)])
    np.testing.assert_array_equal(run(result.model, {"u2": U})["y"], U)
    sentence = f"C takes elements in the order of its inputs, because the bus D of buses.m names {renamed}"
    assert any(sentence in str(finding) for finding in result.report.remarks)


def test_a_bus_creator_with_another_number_of_inputs_is_refused(tmp_path):
    drawn = creating(["a", "b", "c"], OutDataTypeStr="Bus: D")
    message = r"C: it contains a, b, c, but the bus D of buses.m specifies a, b"
    with pytest.raises(InputError, match=message):
        imported(drawn, tmp_path, parameters=[script(tmp_path, TWO)])


def test_a_bus_creator_tells_an_input_its_width(tmp_path):
    drawn = creating(["a", "b"], OutDataTypeStr="Bus: D")
    text = TWO + "D.Elements(2).Dimensions = 2;"
    model = imported(drawn, tmp_path, parameters=[script(tmp_path, text)])
    assert model.graph.outputs == ("y[1]", "y[2]")
    drawn.blocks[2].parameters["PortDimensions"] = "3"
    message = r"C: its element b has size 3, but the bus D of buses.m specifies 2; u2 has 3 elements by its port"
    with pytest.raises(InputError, match=message):
        imported(drawn, tmp_path, parameters=[script(tmp_path, text)])


def test_a_bus_assignment_must_keep_the_width_of_an_element(tmp_path):
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.inport("u", PortDimensions="2")
    drawn.block("BusAssignment", "Put", ports=(2, 1), AssignedSignals="v")
    drawn.outport("y")
    drawn.line("In", "Put:1")
    drawn.line("u", "Put:2")
    drawn.chain("Put", "y")
    message = r"Put: it assigns 2 elements to v; In.v has 3 elements by the bus B of buses.m; u has 2 elements by its"
    with pytest.raises(InputError, match=message):
        imported(drawn, tmp_path, parameters=[script(tmp_path)])


def test_code_gets_an_element_of_an_unknown_bus_as_a_number(tmp_path):
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="v")
    drawn.function("F", "function y = F(u)\ny = 2*u;")
    drawn.outport("y")
    drawn.chain("In", "Pick", "F", "y")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"In.v": U})["y"], 2 * U)


def test_code_gets_a_bus_as_a_struct(tmp_path):
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.function("F", "function y = F(u)\ny = sum(u.v) + u.w.x(1, 2);")
    drawn.outport("y")
    drawn.chain("In", "F", "y")
    model = imported(drawn, tmp_path, parameters=[script(tmp_path)])
    samples = {"In.v[1]": U, "In.v[2]": V, "In.v[3]": W, "In.w.x[3]": 2 * U}
    np.testing.assert_allclose(run(model, samples)["y"], U + V + W + 2 * U)


def looped(kind="UnitDelay", **parameters):
    """A model that sums u in the element a of a delayed bus, whose element b is the pair (u, a)."""
    drawn = fixed_step()
    drawn.inport("u")
    drawn.block("Sum", "Add", ports=(2, 1), Inputs="++")
    drawn.block("Mux", "Pair", ports=(2, 1), Inputs="2")
    drawn.block("BusCreator", "Make", ports=(2, 1), Inputs="2")
    drawn.block("BusCreator", "Wrap", ports=(1, 1), Inputs="1")
    drawn.block(kind, "Z", ports=(1, 1), **{"SampleTime": "-1", **parameters})
    drawn.block("BusSelector", "Old", ports=(1, 2), OutputSignals="in.a,in.b")
    for name in ("sum", "pair"):
        drawn.outport(name)
    drawn.line("u", "Add:1", "Pair:1")
    drawn.line("Old:1", "Add:2", "Pair:2")
    drawn.line("Add", "Make:1", "sum", name="a")
    drawn.line("Pair", "Make:2", name="b")
    drawn.line("Make", "Wrap", name="in")
    drawn.chain("Wrap", "Z", "Old")
    drawn.line("Old:2", "pair")
    return drawn


@pytest.mark.parametrize(
    ("kind", "parameters", "start"),
    [
        ("UnitDelay", {}, 0),
        ("Memory", {}, 0),
        ("UnitDelay", {"InitialCondition": "struct('in', struct('a', 7))"}, 7),
        ("Delay", {"DelayLength": "1", "InitialCondition": "3"}, 3),
    ],
)
def test_a_delay_delays_each_signal_of_a_bus(kind, parameters, start, tmp_path):
    outputs = run(imported(looped(kind, **parameters), tmp_path), {"u": U})
    total = start + np.cumsum(U)
    np.testing.assert_allclose(outputs["sum"], total)
    first = 3 if start == 3 else 0
    np.testing.assert_allclose(outputs["pair[1]"], [first, *U[:-1]])
    np.testing.assert_allclose(outputs["pair[2]"], [first, start, *total[:-2]])


def test_the_initial_value_of_a_delayed_bus_may_be_a_parameter(tmp_path):
    model = imported(looped(InitialCondition="X0"), tmp_path, parameters=[{"X0": {"in": {"a": 7.0}}}])
    assert list(model.values) == ["X0.in.a"]
    np.testing.assert_allclose(run(model, {"u": U})["sum"], 7 + np.cumsum(U))


def test_an_initial_value_that_does_not_fit_its_bus_is_refused(tmp_path):
    drawn = looped(InitialCondition="struct('in', struct('q', 7))")
    with pytest.raises(InputError, match=r"Z: its initial value has the signal in\.q, which its input lacks"):
        imported(drawn, tmp_path)


def test_a_held_bus_keeps_its_signals(tmp_path):
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.block("ZeroOrderHold", "H", SampleTime="0.2")
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="w.x")
    drawn.outport("y")
    drawn.chain("In", "H", "Pick", "y")
    model = imported(drawn, tmp_path, parameters=[script(tmp_path)])
    outputs = run(model, {f"In.w.x[{at}]": U * at for at in range(1, 5)})
    np.testing.assert_allclose(outputs["y[2]"], 2 * U[[0, 0, 2, 2, 4]])


def test_a_bus_assignment_behind_an_unsupported_block_is_not_reached(tmp_path):
    drawn = fixed_step()
    drawn.inport("u")
    drawn.block("S-Function", "S", ports=(1, 1))
    drawn.block("BusAssignment", "Put", ports=(2, 1), AssignedSignals="v")
    drawn.outport("y")
    drawn.line("u", "S", "Put:2")
    drawn.line("S", "Put:1")
    drawn.chain("Put", "y")
    report = import_simulink(drawn.write(tmp_path)).report
    assert [block.path for block in report.unsupported] == ["S"]
    assert report.unreached == ("Put", "y")


@pytest.mark.parametrize("written", ["Bus: B", "B", ""])
def test_the_reason_of_an_unknown_bus_is_what_its_port_says(written, tmp_path):
    drawn = selecting()
    drawn.blocks[0].parameters["OutDataTypeStr"] = written
    remarks = [str(finding) for finding in import_simulink(drawn.write(tmp_path)).report.remarks]
    reason = "the bus B is not defined" if written else "its port does not name a bus object"
    assert any(f"width of In.v is unknown, assumed 1: {reason}" in remark for remark in remarks)


@pytest.mark.parametrize(("kind", "field"), [("SignalSpecification", "Dimensions"), ("Outport", "PortDimensions")])
def test_specified_dimensions_must_be_those_of_the_signal(kind, field, tmp_path):
    drawn = fixed_step()
    drawn.inport("In", OutDataTypeStr="Bus: B")
    drawn.block("BusSelector", "Pick", ports=(1, 1), OutputSignals="v")
    if kind == "Outport":
        drawn.outport("y", PortDimensions="4")
        drawn.chain("In", "Pick", "y")
    else:
        drawn.block(kind, "y", ports=(1, 1), Dimensions="4")
        drawn.outport("z")
        drawn.chain("In", "Pick", "y", "z")
    message = rf"y: its input has size 3, but its {field} specifies 4; In\.v has 3 elements by the bus B of buses\.m"
    with pytest.raises(InputError, match=message):
        imported(drawn, tmp_path, parameters=[script(tmp_path)])
    assert len(imported(drawn, tmp_path).graph.inputs) == 4


def test_an_outport_of_a_bus_must_have_the_signals_of_its_object(tmp_path):
    drawn = fixed_step()
    drawn.block("BusCreator", "C", ports=(1, 1), Inputs="1")
    drawn.inport("u")
    drawn.outport("y", OutDataTypeStr="Bus: D")
    drawn.line("u", "C", name="a")
    drawn.chain("C", "y")
    with pytest.raises(InputError, match=r"y: it contains a, but the bus D of buses\.m specifies a, b"):
        imported(drawn, tmp_path, parameters=[script(tmp_path, TWO)])
