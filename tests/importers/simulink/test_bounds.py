"""Models beyond the limits are reported with block and number, before memory or time run out."""

import json

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.graph import builder
from kennfeld.importers.simulink.importable_subsystems import inspect_simulink
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from kennfeld.matlab.errors import Budget
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Chart, Model
from tests.importers.simulink.simulink_runs import alone, imported, run


def problems(drawn, folder, layout="slx parts", **options):
    """Return the findings of an import, one line each."""
    try:
        return [str(one) for one in import_simulink(drawn.write(folder, layout), **options).report.findings]
    except InputError as error:
        return [str(one) for one in error.findings]


def product(rows, columns):
    """An outer product: as many operations as the matrix has elements."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions=f"[{rows} 1]")
    drawn.inport("v", PortDimensions=f"[1 {columns}]")
    drawn.block("Product", "P", ports=(2, 1), Multiplication="Matrix(*)")
    drawn.outport("y")
    drawn.line("u", "P:1")
    drawn.line("v", "P:2")
    drawn.line("P", "y")
    return drawn


def test_a_graph_ends_at_a_number_of_operations_and_names_the_block(tmp_path, monkeypatch):
    monkeypatch.setattr(builder, "_MAX_NODES", 500)
    assert import_simulink(product(20, 20).write(tmp_path)).model is not None
    (message,) = problems(product(30, 30), tmp_path)
    assert message == (
        "model.slx P: the blocks up to here require more than 500 operations per step. "
        "Import a subsystem, or make the arrays in it smaller."
    )


@pytest.mark.parametrize("field", ["Inport", "SignalSpecification", "Outport"])
def test_more_elements_than_memory_has_room_for_are_refused(field, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", **({"PortDimensions": "1e9"} if field == "Inport" else {}))
    drawn.block("SignalSpecification", "S", **({"Dimensions": "1e9"} if field == "SignalSpecification" else {}))
    drawn.outport("y", **({"PortDimensions": "1e9"} if field == "Outport" else {}))
    drawn.chain("u", "S", "y")
    assert any("it has 1000000000 elements; at most 10000 are supported" in line for line in problems(drawn, tmp_path))


def test_a_solver_with_too_many_operations_is_reported(tmp_path, monkeypatch):
    drawn = Model(step="0.1", solver="ode5")
    drawn.inport("u", PortDimensions="20")
    drawn.block("Integrator", "I")
    drawn.outport("y")
    drawn.chain("u", "I", "y")
    path = drawn.write(tmp_path)
    assert import_simulink(path).model is not None
    monkeypatch.setattr(builder, "_MAX_NODES", 200)
    with pytest.raises(InputError, match=r"model.slx ode5: the blocks up to here require more than 200 operations"):
        import_simulink(path)


def test_a_product_of_too_large_matrices_is_refused_beforehand(tmp_path):
    (message,) = problems(product(5000, 5000), tmp_path)
    assert "P: a matrix product takes 25000000 multiplications; the maximum is 2000000" in message


def test_arrays_that_broadcast_beyond_all_bounds_are_reported(tmp_path):
    (message,) = problems(alone("Gain", Gain="ones(1,20000) .* ones(20000,1)"), tmp_path)
    assert "its Gain (ones(1,20000) .* ones(20000,1)) has no value: it creates an array of 4e+08 elements" in message


@pytest.mark.slow
def test_a_large_memory_is_built_in_one_go(tmp_path):
    graph = imported(alone("UnitDelay", SampleTime="0.1", InitialCondition="1:3000"), tmp_path).graph
    states = [graph.nodes[graph.names[name]].payload for name in graph.outputs]
    assert [graph.nodes[graph.states[which].init].payload for which in states] == list(range(1, 3001))


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
def test_a_line_to_a_port_that_no_block_can_have_is_loose(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "G", Gain="2")
    drawn.outport("y")
    drawn.chain("u", "G", "y")
    drawn.line("u", "G:999999999")
    report = import_simulink(drawn.write(tmp_path, layout)).report
    assert any(
        "port 999999999 of" in str(remark) and "treated as unconnected" in str(remark) for remark in report.remarks
    )


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
def test_a_block_with_more_ports_than_any_is_refused(layout, tmp_path):
    drawn = alone("Mux", 1)
    drawn.blocks[0].ports = {"in": 999_999, "out": 1}
    (message,) = problems(drawn, tmp_path, layout)
    assert "B: has 999999 ports; at most 10000 are supported" in message


@pytest.mark.parametrize("outputs", ["inf", "0/0", "[1 nan]", "2.5"])
def test_outputs_of_a_demux_must_be_integers(outputs, tmp_path):
    messages = problems(alone("Demux", 1, 2, Outputs=outputs), tmp_path)
    assert any(f"its Outputs must be integers, got {outputs}" in line for line in messages)


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        ("Integrator", {"LimitOutput": "on", "UpperSaturationLimit": "[1 2]"}),
        ("Integrator", {"InitialCondition": "[1 2]"}),
        ("UnitDelay", {"InitialCondition": "[1 2]"}),
        ("Delay", {"InitialCondition": "[1 2]", "DelayLength": "1"}),
    ],
)
def test_the_initial_value_of_a_memory_must_fit_its_input(kind, given, tmp_path):
    drawn = Model(step="0.1", solver="ode1")
    drawn.inport("u", PortDimensions="3")
    drawn.block(kind, "B", ports=(1, 1), **given)
    drawn.outport("y")
    drawn.chain("u", "B", "y")
    (message,) = problems(drawn, tmp_path)
    assert "B: its initial value has size 2, but its input has size 3" in message


def test_resets_and_initial_values_of_different_sizes_are_reported(tmp_path):
    drawn = Model(step="0.1", solver="ode1")
    drawn.inport("u")
    drawn.inport("r", PortDimensions="2")
    drawn.block("Integrator", "B", ports=(2, 1), ExternalReset="rising", InitialCondition="[1 2 3]")
    drawn.outport("y")
    drawn.line("u", "B:1")
    drawn.line("r", "B:2")
    drawn.line("B", "y")
    (message,) = problems(drawn, tmp_path)
    assert "B: its inputs have the sizes 3, 2, which do not match" in message


def test_a_sample_time_below_the_smallest_unit_is_reported(tmp_path):
    (message,) = problems(alone("UnitDelay", SampleTime="1e-12"), tmp_path)
    assert "the sample time 1e-12 (1e-12 s) must be at least 1e-09 s" in message


def test_a_merge_that_stops_half_way_gives_the_reason(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "K", Gain="nowhere")
    drawn.block("Gain", "L", Gain="2")
    drawn.block("Merge", "M", ports=(2, 1))
    drawn.outport("y")
    drawn.line("u", "K", "L")
    drawn.line("K", "M:1")
    drawn.line("L", "M:2")
    drawn.line("M", "y")
    (message,) = problems(drawn, tmp_path)
    assert message.startswith("variable nowhere: undefined")


def test_an_invalid_port_number_counts_as_1(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.function("F", "function y = F(u)\ny = 3 * u;")
    drawn.outport("y")
    drawn.chain("u", "F", "y")
    for block in drawn.blocks[1].system.blocks:
        block.parameters["Port"] = "1;2"
    outputs = run(imported(drawn, tmp_path, subsystem="F"), {"u": np.arange(3.0)})
    np.testing.assert_array_equal(outputs["y"], [0.0, 3.0, 6.0])


def test_a_statement_that_fails_over_and_over_uses_up_the_steps_of_a_script(tmp_path, monkeypatch):
    monkeypatch.setattr(Budget.__init__, "__defaults__", (20_000, *Budget.__init__.__defaults__[1:]))
    drawn = alone("Gain", Gain="k", model=Model(step="0.1", code="for i=1:1000, for j=1:1000, y=u+i; end, end"))
    report = inspect_simulink(drawn.write(tmp_path))
    assert list(report.undefined) == ["k"]
    assert any("the script takes too many steps" in str(remark) for remark in report.remarks)


@pytest.mark.parametrize("text", ["zeros(nan)", "zeros(inf,1)", "k(nan)", "k(1.5)", "ones(2.5)", "reshape(k,nan,1)"])
def test_sizes_and_indices_must_be_integers(text, tmp_path):
    code = "k = [1 2 3];"
    messages = problems(alone("Gain", Gain=text, model=Model(step="0.1", code=code)), tmp_path)
    assert any("must be an integer" in line for line in messages)
    drawn = alone("Integrator", model=Model(solver="ode4", step=text, code=code))
    assert [*map(str, import_simulink(drawn.write(tmp_path)).report.remarks)] == [
        f"the solver setting {text} has no value"
    ]


def test_an_array_in_empty_parentheses_is_the_array(tmp_path):
    drawn = alone("Gain", Gain="k()", model=Model(step="0.1", solver="FixedStepDiscrete", code="k = [1 2 3];"))
    outputs = run(imported(drawn, tmp_path), {"u1": np.array([2.0])})
    assert [float(outputs[f"y1[{at}]"][0]) for at in (1, 2, 3)] == [2.0, 4.0, 6.0]


@pytest.mark.parametrize(("text", "count"), [("[]", 0), ("[u1 u1] > 0", 2)])
def test_a_condition_must_be_scalar(text, count, tmp_path):
    (message, *_) = problems(alone("If", 1, 2, IfExpression=text), tmp_path)
    assert f"must be scalar, got {count} values" in message


@pytest.mark.parametrize("written", ["xx 1", "ssIdNumber 2"])
def test_a_chart_with_ambiguous_states_is_refused(written, tmp_path):
    drawn = Model("model", step="0.1", solver="FixedStepDiscrete")
    states = Chart({"A": "A\nen: y = 1;", "B": "B"}, [("", "A", ""), ("A", "B", "[u > 0]")], [("u", "INPUT_DATA")])
    drawn.inport("u")
    drawn.chart("C", states, outputs=("y",))
    drawn.outport("y")
    drawn.chain("u", "C", "y")
    path = drawn.write(tmp_path, "mdl")
    path.write_text(path.read_text().replace("ssIdNumber 1\n", f"{written}\n", 1))
    findings = import_simulink(path).report.findings
    assert "states and junctions have no unique identifiers" in str(findings[0])


def test_sizes_in_a_dictionary_must_be_numbers(tmp_path):
    entries = [{"name": "k", "value": {"_array_class": "A", "_dimensions": [1e999], "_elements": []}}]
    content = {"__MW_TEXT_PARTS__": {"__MW_TEXT_PART__/data/chunk0": {"__MW_TEXT_content": {"entries": entries}}}}
    path = tmp_path / "data.sldd"
    path.write_text(json.dumps({"__MW_TEXT_COREPROPERTIES__": {}} | content))
    with pytest.raises(InputError, match="is not a data dictionary: cannot convert float infinity"):
        read_dictionary(path)


def test_sample_times_without_a_common_step_run_at_the_shortest(tmp_path):
    drawn = Model(solver="ode45")
    drawn.inport("u")
    times = [0.1, 0.1137, 0.1337211, 0.1571313]
    for at, time in enumerate(times):
        drawn.block("ZeroOrderHold", f"Z{at}", SampleTime=str(time))
    drawn.outport("y")
    drawn.chain("u", *(f"Z{at}" for at in range(len(times))), "y")
    report = import_simulink(drawn.write(tmp_path)).report
    assert report.step == 0.1
    assert any("no step hits all sample times: using the shortest, 0.1 s" in line for line in report.substitutions)
