"""Function calls from outside of a model, and split between several subsystems."""

import pytest

from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.outline import summarize_model
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import imported, run

U = [1.0, 2.0, 3.0, 4.0]


def called(system, name, factor):
    """A function-call subsystem that adds up its input times a factor."""
    inner = system.subsystem(name)
    inner.block("TriggerPort", "T", TriggerType="function-call")
    inner.inport("u")
    inner.block("Gain", "G", Gain=factor)
    inner.block("Sum", "S", ports=(2, 1), Inputs="++")
    inner.block("UnitDelay", "D", SampleTime="-1")
    inner.outport("y")
    inner.chain("u", "G", "S:1")
    inner.line("D", "S:2")
    inner.line("S", "D", "y")


def total(**parameters):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("Run", OutputFunctionCall="on", **parameters)
    called(drawn, "S", 1)
    drawn.outport("y")
    drawn.line("u", "S")
    drawn.line("Run", "S#trigger")
    drawn.line("S", "y")
    return drawn


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
def test_a_function_call_from_outside_occurs_in_every_step(layout, tmp_path):
    model = imported(total(), tmp_path, layout)
    assert list(model.graph.inputs) == ["u"]
    assert run(model, {"u": U})["y"].tolist() == [1, 3, 6, 10]


def test_a_function_call_from_outside_occurs_at_the_hits_of_its_port(tmp_path):
    assert run(imported(total(SampleTime="0.2"), tmp_path), {"u": U})["y"].tolist() == [1, 1, 4, 4]


def test_the_outline_lists_a_function_call_from_outside_not_as_an_input(tmp_path):
    assert [port.name for port in summarize_model(total().write(tmp_path)).inputs] == ["u"]


@pytest.mark.parametrize(("rate", "occasion"), [("-1", "called in every step"), ("0.2", "called every 0.2 s")])
def test_the_report_states_when_a_function_call_from_outside_occurs(rate, occasion, tmp_path):
    report = import_simulink(total(SampleTime=rate).write(tmp_path)).report
    assert any(
        f"Run is a function call from outside of the model: it is {occasion}" in str(one) for one in report.remarks
    )


def test_a_function_call_from_outside_can_be_bound_to_a_channel(tmp_path):
    model = imported(total(), tmp_path, bind={"Run": "go"})
    assert run(model, {"u": U, "go": [0.0, 1.0, 0.0, 1.0]})["y"].tolist() == [0, 2, 2, 6]


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
def test_a_split_function_call_calls_all_subsystems(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.link("G", "simulink/Ports & Subsystems/Function-Call Generator", "Function-Call Generator", ports=(0, 1),
               sample_time="0.2")  # fmt: skip
    drawn.block("FunctionCallSplit", "F", ports=(1, 2))
    drawn.line("G", "F")
    for at, factor in enumerate((1, 10), 1):
        called(drawn, f"S{at}", factor)
        drawn.outport(f"y{at}")
        drawn.line(f"F:{at}", f"S{at}#trigger")
        drawn.line(f"S{at}", f"y{at}")
    drawn.line("u", "S1", "S2")
    outputs = run(imported(drawn, tmp_path, layout), {"u": U})
    assert outputs["y1"].tolist() == [1, 1, 4, 4]
    assert outputs["y2"].tolist() == [10, 10, 40, 40]
