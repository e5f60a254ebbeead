"""Subsystems that charts call, against numbers by hand."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.chart_runs import U, lone, pair
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run, slopes


def caller(chart, inputs=("u", "th"), gain="2"):
    """A chart C of the input u, whose event f calls a subsystem S that gives gain*a; they are not wired otherwise."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.chart("C", chart, inputs, ("y", "f()"))
    inner = drawn.subsystem("S")
    inner.block("TriggerPort", "call", TriggerType="function-call")
    inner.inport("a")
    inner.block("Gain", "G", Gain=gain)
    inner.outport("b", InitialOutput="0")
    inner.chain("a", "G", "b")
    drawn.inport("u")
    drawn.line("u", "C")
    drawn.line("C:2", "S#trigger")
    return drawn


def fed_back(chart, gain="2"):
    """A caller that calls with its output y and gets the result as its input th."""
    drawn = caller(chart, gain=gain)
    drawn.outport("y_out")
    drawn.outport("th_out")
    drawn.line("C", "S", "y_out")
    drawn.line("S", "C:2", "th_out")
    return drawn


CALLER = [("u", "INPUT_DATA"), ("th", "INPUT_DATA"), ("y", "OUTPUT_DATA")]
CALL = [("f", "OUTPUT_EVENT", "FUNCTION_CALL_EVENT")]


def test_a_chart_reads_what_it_calls_within_its_step(tmp_path):
    chart = lone("en: y = 1;\ndu: y = u; f; y = y + th;", CALLER, events=CALL)
    model = imported(fed_back(chart, "K"), tmp_path, parameters=[{"K": 3.0}])
    recorded = run(model, {"u": U[:20]})
    np.testing.assert_allclose(recorded["y_out"], np.r_[1, 4 * U[1:20]], atol=1e-12)
    np.testing.assert_allclose(recorded["th_out"], np.r_[0, 3 * U[1:20]], atol=1e-12)
    exact, near = slopes(model, {"u": U[:20]}, "K", "y_out")
    np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-8)


def test_a_chart_reads_what_an_earlier_call_has_left(tmp_path):
    chart = pair("en: y = 1;\ndu: y = y + th;", "du: y = u; f;", "[u > 0]", "[u < 0]", CALLER, events=CALL)
    recorded = run(imported(fed_back(chart), tmp_path), {"u": [0, 1, 2, 3, -1, 0, 0]})
    np.testing.assert_array_equal(recorded["y_out"], [1, 1, 2, 3, 1, 7, 13])
    np.testing.assert_array_equal(recorded["th_out"], [0, 0, 4, 6, 6, 6, 6])


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ("en: y = 1;\ndu: f; f;", "f may be called twice in one step"),
        ("en: f;\ndu: y = u; f; y = th;", "in several places"),
    ],
)
def test_calls_that_cannot_be_placed_are_refused(state, message, tmp_path):
    chart = lone(state, CALLER, events=CALL)
    with pytest.raises(InputError) as caught:
        imported(fed_back(chart), tmp_path)
    assert message in str(caught.value)


@pytest.mark.parametrize("first", ["N", "S"])
def test_a_block_between_a_chart_and_its_callee_is_reported_for_any_start_of_the_import(first, tmp_path):
    chart = lone("du: y = u; f; y = y + th;", CALLER, events=CALL)
    drawn = caller(chart)
    drawn.block("Gain", "N", Gain="2")
    for name in sorted(("N", "S"), key=lambda one: one != first):
        drawn.outport(f"{name}_out")
    drawn.chain("C", "N")
    drawn.line("N", "S", "N_out")
    drawn.line("S", "C:2", "S_out")
    with pytest.raises(InputError) as caught:
        imported(drawn, tmp_path)
    message = str(caught.value)
    assert "needs N, which needs the chart" in message or "algebraic loop: " in message


def test_an_output_that_changes_after_a_call_is_refused_where_the_called_subsystem_reads_it(tmp_path):
    chart = lone("du: f; y = u;", [CALLER[0], CALLER[2]], events=CALL)
    drawn = caller(chart, ("u",))
    drawn.outport("out")
    drawn.chain("C", "S", "out")
    with pytest.raises(InputError) as caught:
        imported(drawn, tmp_path)
    assert "y, which S/G reads, changes after the call of f" in str(caught.value)


def test_a_called_subsystem_that_needs_what_waits_for_the_chart_is_a_loop(tmp_path):
    chart = lone("du: y = u; f; y = y + th;", CALLER, events=CALL)
    drawn = caller(chart)
    drawn.block("Bias", "R", Bias="1")
    drawn.outport("y_out")
    drawn.chain("C", "R", "S", "C:2")
    drawn.line("R", "y_out")
    report = import_simulink(drawn.write(tmp_path)).report
    assert any(
        "C: the subsystem called by f requires R, which requires the chart" in str(one) for one in report.findings
    )
