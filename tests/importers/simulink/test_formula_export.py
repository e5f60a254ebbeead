"""Models as formula text: the same numbers, derivatives instead of the stages of a solver, and names of blocks."""

import re
from dataclasses import replace

import numpy as np
import pytest

from kennfeld.graph import GraphBuilder
from kennfeld.graph.integration import SOLVERS
from kennfeld.importers.simulink.formula_export import formula_lines
from kennfeld.importers.simulink.importer import IMPORTER
from kennfeld.models.formula import formula
from kennfeld.models.formula import read as read_formula
from kennfeld.models.importer import ImportOptions, ImportRequest
from kennfeld.models.model_export import write_formula
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_data import sldd
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

U = np.sin(np.arange(40) * 0.7) * 3 + 0.5
R = (np.arange(40) % 11 == 7).astype(float)


def text_of(model):
    return "\n".join(line.text for line in formula_lines(model))


def read_back(model):
    return formula(text_of(model), parameters=model.values)


def node_lines(model):
    return [line for line in text_of(model).splitlines() if " = " in line]


def assert_equal_graphs(model):
    """The text has the graph of the model, except for the names that it leaves out or shortens."""
    names = {line.text.partition(" = ")[0].partition("[")[0].strip("%"): line.node for line in formula_lines(model)}
    read = read_back(model)
    own = {name: model.graph.names[names[name]] for name in read.graph.names}
    expected = GraphBuilder.of(model.graph).finish(own, {}, read.graph.outputs)
    assert (read.graph.nodes, read.graph.states) == (expected.nodes, expected.states)
    assert read.step == model.step


def integrator(solver):
    drawn = Model(solver=solver, step="0.1")
    drawn.inport("u")
    drawn.block("Integrator", "x", InitialCondition="x0")
    drawn.block("Fcn", "f", Expr="-k*u*abs(u)")
    drawn.block("Sum", "slope", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.line("u", "slope:1")
    drawn.chain("x", "f", "slope:2")
    drawn.chain("slope", "x", "y")
    return drawn


def resettable(solver):
    drawn = Model(solver=solver, step="0.1")
    drawn.inport("u")
    drawn.inport("r")
    drawn.block("Gain", "G", Gain="k")
    drawn.block(
        "Integrator", "I", ports=(2, 1), InitialCondition="x0", ExternalReset="rising", LimitOutput="on",
        UpperSaturationLimit="0.8", LowerSaturationLimit="-0.4",
    )  # fmt: skip
    drawn.block("Integrator", "J")
    drawn.outport("y")
    drawn.outport("z")
    drawn.chain("u", "G", "I:1")
    drawn.line("r", "I:2")
    drawn.line("I", "y", "J")
    drawn.line("J", "z")
    return drawn


def transfer(solver):
    drawn = Model(solver=solver, step="0.1")
    drawn.inport("u")
    drawn.block("TransferFcn", "Lag", Numerator="[1 k]", Denominator="[0.5 0.3 x0+1]")
    drawn.block("StateSpace", "Space", A="[0 1; -k -0.4]", B="[0; 1]", C="[1 x0]", D="0.1", InitialCondition="[0.2; 0]")
    drawn.outport("y")
    drawn.chain("u", "Lag", "Space", "y")
    return drawn


def tabulated(solver):
    drawn = Model(solver=solver, step="0.1")
    drawn.inport("u")
    drawn.block(
        "Lookup_n-D", "Table", ports=(1, 1), NumberOfTableDimensions="1", Table="[2 1 -1 -4]",
        BreakpointsForDimension1="[-2 -0.5 0.5 2]",
    )  # fmt: skip
    drawn.block("Gain", "G", Gain="k")
    drawn.block("Sum", "slope", ports=(2, 1), Inputs="++")
    drawn.block("Integrator", "x", InitialCondition="x0")
    drawn.outport("y")
    drawn.line("u", "slope:1")
    drawn.chain("x", "Table", "G", "slope:2")
    drawn.chain("slope", "x", "y")
    return drawn


def sampled(solver):
    """A discrete controller of a continuous plant in an enabled subsystem, with a zero-order hold in the loop."""
    drawn = Model(solver=solver, step="0.1")
    drawn.inport("u")
    drawn.inport("r")
    drawn.block("Sum", "error", ports=(2, 1), Inputs="+-")
    drawn.block("ZeroOrderHold", "Hold", SampleTime="0.2")
    drawn.block("DiscreteIntegrator", "Control", gainval="k", SampleTime="0.2")
    inner = drawn.subsystem("Plant")
    inner.block("EnablePort", "E", StatesWhenEnabling="held")
    inner.inport("a")
    inner.block("Integrator", "x", InitialCondition="x0")
    inner.block("Derivative", "d")
    inner.block("Sum", "sum", ports=(3, 1), Inputs="+-+")
    inner.block("Gain", "Small", Gain="0.01")
    inner.outport("b")
    inner.line("a", "sum:1")
    inner.line("x", "sum:2", "d", "b")
    inner.chain("d", "Small", "sum:3")
    inner.line("sum", "x")
    drawn.outport("y")
    drawn.line("u", "error:1")
    drawn.chain("error", "Hold", "Control", "Plant")
    drawn.block("Constant", "one", Value="1")
    drawn.block("Sum", "enable", ports=(2, 1), Inputs="+-")
    drawn.line("one", "enable:1")
    drawn.line("r", "enable:2")
    drawn.line("enable", "Plant#enable")
    drawn.line("Plant", "error:2", "y")
    return drawn


DRAWINGS = (integrator, resettable, transfer, tabulated, sampled)
VALUES = {"k": 0.8, "x0": 0.3}


@pytest.mark.parametrize(
    ("draw", "solver"),
    [  # each drawing and each solver
        pytest.param(draw, solver, marks=() if at % len(DRAWINGS) == number else pytest.mark.slow)
        for number, draw in enumerate(DRAWINGS)
        for at, solver in enumerate(SOLVERS)
    ],
)
def test_the_text_gives_the_numbers_of_the_model_to_the_last_digit(draw, solver, tmp_path):
    model = imported(draw(solver), tmp_path, parameters=[VALUES])
    columns = {name: {"u": U, "r": R}[name] for name in model.graph.inputs}
    outputs, expected = run(read_back(model), columns, parameters=model.values), run(model, columns)
    for name in model.graph.outputs:
        np.testing.assert_array_equal(outputs[name], expected[name])
        assert np.ptp(expected[name]) > 0.1
    assert_equal_graphs(model)
    assert f"solver {solver}" in text_of(model).splitlines()


@pytest.mark.slow
@pytest.mark.parametrize("draw", mostly_slow(DRAWINGS, [resettable, sampled]))
def test_derivatives_pass_through_the_text(draw, tmp_path):
    model = imported(draw("ode4"), tmp_path, parameters=[VALUES])
    columns = {name: {"u": U, "r": R}[name] for name in model.graph.inputs}
    read = read_back(model)
    exact = slopes(model, columns, "k", "y")[0]
    again = slopes(type(model)(read.graph, step=read.step, values=model.values), columns, "k", "y")
    # the order of nodes decides which products machine code fuses with sums
    np.testing.assert_allclose(again[0], exact, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(again[0], again[1], rtol=1e-5, atol=1e-7)


def test_a_continuous_state_is_written_as_its_derivative(tmp_path):
    model = imported(integrator("ode5"), tmp_path, parameters=[VALUES])
    assert text_of(model).splitlines()[:3] == ["", "step 0.1", "solver ode5"]
    assert node_lines(model) == ["f = -k * y * abs(y)", "slope = u + f", "y = integrator(slope, x0)"]


def test_a_reset_is_written_as_the_value_from_which_the_step_starts(tmp_path):
    lines = node_lines(imported(resettable("ode3"), tmp_path, parameters=[VALUES]))
    [start] = [line for line in lines if "integrator(G" in line]
    assert re.fullmatch(r"y = if\(.*, (_I_\d+), integrator\(G, \1, -0\.4, 0\.8, y\)\)", start)
    assert "z = integrator(y)" in lines


@pytest.mark.parametrize(
    ("block", "line"),
    [
        (("Integrator", {}), "y = integrator(u, clip(x0, -0.4, 0.8), -0.4, 0.8)"),
        (("DiscreteIntegrator", {"SampleTime": "0.1"}), "y = prev(clip(y + 0.1 * u, -0.4, 0.8), clip(x0, -0.4, 0.8))"),
    ],
)  # fmt: skip
def test_the_limits_of_an_integrator_are_written_once(block, line, tmp_path):
    drawn = Model(solver="ode3", step="0.1")
    drawn.inport("u")
    limits = {"LimitOutput": "on", "UpperSaturationLimit": "0.8", "LowerSaturationLimit": "-0.4"}
    drawn.block(block[0], "I", InitialCondition="x0", **block[1], **limits)
    drawn.outport("y")
    drawn.chain("u", "I", "y")
    model = imported(drawn, tmp_path, parameters=[VALUES])
    assert node_lines(model) == [line]
    y = run(model, {"u": 5 * U})["y"]
    assert (y.min(), y.max()) == (-0.4, 0.8)


def test_a_node_has_one_name_and_an_outport_before_a_signal_before_a_block(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    for name in ("A", "B", "C", "D"):
        drawn.block("Gain", name, Gain="2")
    drawn.block("SignalConversion", "Copy", ports=(1, 1))
    drawn.outport("y")
    drawn.outport("z")
    drawn.line("u", "A", name="first")
    drawn.line("A", "Copy", name="second")
    drawn.line("Copy", "B")
    drawn.line("B", "C")
    drawn.line("C", "D", "y", name="third")
    drawn.line("D", "z")
    model = imported(drawn, tmp_path)
    assert node_lines(model) == ["second = 2 * u", "B = 2 * second", "y = 2 * B", "z = 2 * y"]


def test_outputs_of_one_signal_and_those_that_pass_an_input_on_keep_their_names(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.block("Gain", "G", Gain="2")
    for name in ("y", "z", "through"):
        drawn.outport(name)
    drawn.line("u", "G", "through")
    drawn.line("G", "y", "z")
    assert node_lines(imported(drawn, tmp_path)) == ["y = 2 * u", "z = y", "through = u"]


def test_inner_nodes_of_a_block_have_its_name(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.block("Fcn", "My block", Expr="sin(u*u) + cos(u*u)")
    drawn.block("Gain", "G", Gain="2")
    drawn.outport("y")
    drawn.chain("u", "My block", "G", "y")
    assert node_lines(imported(drawn, tmp_path))[:-1] == [
        "_My_block_1 = u * u",
        "%My block% = sin(_My_block_1) + cos(_My_block_1)",
    ]


def exported(source, target, step=None):
    script = target.with_name("values.m")
    script.write_text("".join(f"{name} = {value};\n" for name, value in VALUES.items()), encoding="utf-8")
    return write_formula(IMPORTER, ImportRequest(source, ImportOptions(step, parameters=(script,))), target)


def test_the_file_that_is_written_is_read_as_the_model(tmp_path):
    source = transfer("ode2").write(tmp_path, "slx parts")
    target, values = exported(source, tmp_path / "plant.kf")
    read = read_formula(target)
    assert (read.step, read.solver, values.name) == (0.1, "ode2", "plant.json")
    model = imported(transfer("ode2"), tmp_path, parameters=[VALUES])
    output = run(read, {"u": U}, parameters=model.values)["y"]
    np.testing.assert_array_equal(output, run(model, {"u": U})["y"])


def test_a_step_can_be_chosen_for_the_text(tmp_path):
    source = transfer("ode2").write(tmp_path, "slx parts")
    exported(source, tmp_path / "plant.kf", step=0.025)
    assert read_formula(tmp_path / "plant.kf").step == 0.025


def arithmetic():
    """Two subsystems with blocks of the names that the library gives, in an order that is not that of the signals."""
    drawn = Model(solver="ode3", step="0.1")
    drawn.inport("u", Unit="rpm")
    outer = drawn.subsystem("After")
    outer.inport("a")
    outer.block("Gain", "Gain", Gain="1/175")
    outer.outport("b")
    outer.chain("a", "Gain", "b")
    inner = drawn.subsystem("Before")
    inner.inport("a")
    inner.block("Gain", "Gain", Gain="pi/30")
    inner.block("Bias", "Bias", Bias="1")
    inner.block("Sqrt", "Shared")
    inner.block("Sum", "Sum", ports=(2, 1), Inputs="++")
    inner.outport("b")
    inner.chain("a", "Gain", "Bias", "Shared", "Sum:1")
    inner.line("Shared", "Sum:2")
    inner.line("Sum", "b")
    drawn.outport("y", Unit="Nm")
    drawn.chain("u", "Before", "After", "y")
    return drawn


def test_statements_follow_the_signals_by_subsystem_and_blocks_without_a_name_of_their_own_are_written_in_place(
    tmp_path,
):
    model = imported(arithmetic(), tmp_path)
    assert text_of(model).split("\n\n")[-3:] == [
        "output y",
        "# Before\nShared = sqrt(pi / 30 * u + 1)\nSum = Shared + Shared",
        "# After\ny[Nm] = 1 / 175 * Sum",
    ]
    assert "input u[rpm]" in text_of(model).splitlines()
    read = read_back(model)
    np.testing.assert_array_equal(run(read, {"u": 9 + U})["y"], run(model, {"u": 9 + U})["y"])


def test_each_block_can_have_its_own_line(tmp_path):
    lines = {line.node: line.text for line in formula_lines(imported(arithmetic(), tmp_path), each_block=True)}
    assert (lines["Before/Bias"], lines["Before/Gain"]) == ("Bias = Gain + 1", "Gain = pi / 30 * u")


def test_names_that_several_blocks_have_are_as_long_as_needed(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    for part, law in (("A", "u*u"), ("B", "u*u*u")):
        outer = drawn.subsystem(part)
        inner = outer.subsystem("Core")
        inner.inport("u")
        inner.block("Fcn", "Law", Expr=law)
        inner.block("Fcn", f"Only{part}", Expr="u+1")
        inner.outport("v")
        inner.chain("u", "Law", f"Only{part}", "v")
        outer.inport("u")
        outer.block("Gain", "K", Gain="2")
        outer.outport("v")
        outer.chain("u", "Core", "K", "v")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.line("u", "A", "B")
    drawn.line("A", "S:1")
    drawn.line("B", "S:2")
    drawn.line("S", "y")
    names = [line.partition(" = ")[0] for line in node_lines(imported(drawn, tmp_path))]
    assert names == ["%A/Core/Law%", "OnlyA", "%A/K%", "%B/Core/Law%", "OnlyB", "%B/K%", "y"]


def test_long_names_of_tables_are_written_once_and_stay_those_of_the_calibration(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    part = "A rather long name of a part"
    inner = drawn.subsystem(part)
    inner.inport("u")
    for name in ("Torque", "1-Kappa"):
        inner.block(
            "Lookup_n-D", name, ports=(1, 1), NumberOfTableDimensions="1", Table="[2 1 -1 -4]",
            BreakpointsForDimension1="[-2 -0.5 0.5 2]",
        )  # fmt: skip
    inner.outport("y")
    inner.chain("u", "Torque", "1-Kappa", "y")
    drawn.outport("y")
    drawn.chain("u", part, "y")
    model = imported(drawn, tmp_path)
    lines = text_of(model).splitlines()
    assert "def Torque_Table(x) = %A rather long name of a part/Torque:Table%(x)" in lines
    assert node_lines(model)[-2:] == ["Torque = Torque_Table(u)", "y = Table_1_Kappa(Torque)"]
    assert set(read_back(model).graph.parameters) == set(model.values)
    again = run(read_back(model), {"u": U}, parameters=model.values)
    np.testing.assert_array_equal(again["y"], run(model, {"u": U})["y"])


def test_the_hits_of_a_sample_time_and_auxiliary_nodes_have_names_of_their_own(tmp_path):
    lines = node_lines(imported(sampled("ode3"), tmp_path, parameters=[VALUES]))
    assert any(line.startswith("_hit_0.2s = sampled(floor(t / 0.2") for line in lines)
    assert all(re.match(r"_(hit|Hold|Control|error|x|d|E|sum)_|[^_]", line) for line in lines)


def test_descriptions_and_units_of_parameters_stand_at_the_head(tmp_path):
    model = imported(integrator("ode3"), tmp_path, parameters=[VALUES])
    values = model.values.with_parameters(
        model.values["k"].changed(unit="1/s", description="damping"),
        model.values["x0"].changed(description="start\nof the mass"),
    )
    graphs = [replace(graph, units={"k": "1/s"}) for graph in (model.graph, model.equations)]
    lines = text_of(replace(model, values=values, graph=graphs[0], equations=graphs[1])).splitlines()
    assert {"scalar k[1/s]  # damping", "scalar x0      # start of the mass"} <= set(lines)


def test_elements_of_arrays_are_counted_from_1_as_in_matlab(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.block("Gain", "First", Gain="data(1)")
    drawn.block("Gain", "Last", Gain="data(3)")
    drawn.block("Gain", "Corner", Gain="K(2,1)")
    drawn.outport("y")
    drawn.chain("u", "First", "Last", "Corner", "y")
    model = imported(drawn, tmp_path, parameters=[{"data": [2.0, 3.0, 5.0], "K": np.array([[1.0, 7.0], [11.0, 13.0]])}])
    lines = text_of(model).splitlines()
    assert "def data_at(i) = data(i - 1)  # elements counted from 1" in lines
    assert node_lines(model)[-3:] == ["First = data_at(1) * u", "Last = data_at(3) * First", "y = K_at(2, 1) * Last"]
    again = run(read_back(model), {"u": U}, parameters=model.values)
    np.testing.assert_allclose(again["y"], 2 * 5 * 11 * U)
    assert set(read_back(model).graph.parameters) == {"data", "K"}


def test_a_node_is_named_after_the_block_that_computes_it_not_one_that_passes_it_on(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.block("DataTypeConversion", "Cast", ports=(1, 1), OutDataTypeStr="double")
    drawn.block("Signum", "Direction")
    drawn.block("Gain", "G", Gain="2")
    drawn.outport("y")
    drawn.chain("u", "Direction", "Cast", "G", "y")
    assert node_lines(imported(drawn, tmp_path)) == ["Direction = sign(u)", "y = 2 * Direction"]


@pytest.mark.parametrize("source", ["script", "dictionary"])
def test_signals_have_the_units_of_the_objects_of_their_names_unless_a_port_states_its_own(source, tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("n")
    drawn.block("Gain", "First", Gain="2")
    drawn.block("Gain", "Second", Gain="3")
    drawn.outport("y", Unit="Nm")
    drawn.chain("n", "First")
    drawn.line("First", "Second", name="air")
    drawn.line("Second", "y")
    units = {"n": "rpm", "air": "mg", "y": "kW"}
    if source == "script":
        path = tmp_path / "signals.m"
        lines = [f"{name} = Simulink.Signal; {name}.Unit = '{unit}';" for name, unit in units.items()]
        path.write_text("\n".join(lines), encoding="utf-8")
    else:
        entries = {
            name: f'<P Name="Value"><Element Class="Simulink.Signal"><P Name="DocUnits" Class="char">{unit}</P>'
            "</Element></P>"
            for name, unit in units.items()
        }
        path = tmp_path / "signals.sldd"
        path.write_bytes(sldd(entries))
    lines = text_of(imported(drawn, tmp_path, parameters=[path])).splitlines()
    assert {"input n[rpm]", "air[mg] = 2 * n", "y[Nm] = 3 * air"} <= set(lines)
