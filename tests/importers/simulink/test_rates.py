"""Rate transitions: a slower sample time holds a signal, a faster one sees it a hit of its own late."""

import re

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

U = np.random.default_rng(23).normal(size=30)
T = 0.1
SLOW = np.repeat(U[::3], 3)[: U.size]  # U at the hits of 0.3 s
LATE = np.concatenate([[5.0] * 3, SLOW[:-3]])


def drawn(slow="0.3", fast="0.1", **transition):
    """A slow hold, a transition, a gain, and a memory of another sample time."""
    diagram = Model(step="0.1", solver="FixedStepDiscrete")
    diagram.inport("u")
    diagram.block("ZeroOrderHold", "Hold", SampleTime=slow)
    diagram.block("RateTransition", "R", ports=(1, 1), **transition)
    diagram.block("Gain", "K", Gain="2")
    diagram.block("UnitDelay", "Z", SampleTime=fast)
    diagram.outport("y")
    diagram.outport("z")
    diagram.chain("u", "Hold", "R", "K", "Z", "z")
    diagram.line("K", "y")
    return diagram


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
def test_a_faster_sample_time_sees_a_signal_one_hit_late(layout, tmp_path):
    model = imported(drawn(X0="x0"), tmp_path, layout, parameters=[{"x0": 5.0}])
    outputs = run(model, {"u": U})
    np.testing.assert_allclose(outputs["y"], 2 * LATE)
    np.testing.assert_allclose(outputs["z"], [0.0, *2 * LATE[:-1]])
    exact, differences = slopes(model, {"u": U}, "x0", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-9)


@pytest.mark.parametrize(
    "settings",
    [{"OutPortSampleTime": "0.1"}, {"OutPortSampleTimeOpt": "Multiple of input port sample time",
                                    "OutPortSampleTimeMultiple": "1/3"}],
)  # fmt: skip
def test_the_sample_time_behind_may_be_stated(settings, tmp_path):
    outputs = run(imported(drawn(fast="-1", InitialCondition="5", **settings), tmp_path), {"u": U})
    np.testing.assert_allclose(outputs["y"], 2 * LATE)
    np.testing.assert_allclose(outputs["z"], [0.0, *2 * LATE[:-1]])


@pytest.mark.parametrize("settings", [{"Deterministic": "off"}, {"Integrity": "off"}])
def test_a_transition_that_need_not_be_deterministic_is_not_late(settings, tmp_path):
    output = run(imported(drawn(X0="5", **settings), tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(output, 2 * SLOW)


def test_blocks_behind_a_transition_take_the_faster_sample_time(tmp_path):
    diagram = drawn(X0="5", OutPortSampleTime="0.1", fast="-1")
    diagram.block("DiscreteIntegrator", "I", ports=(1, 1), SampleTime="-1")
    diagram.outport("x")
    diagram.line("R", "I")
    diagram.line("I", "x")
    output = run(imported(diagram, tmp_path), {"u": U})["x"]
    np.testing.assert_allclose(output, T * np.concatenate([[0.0], np.cumsum(LATE)[:-1]]), atol=1e-13)


def test_a_continuous_state_behind_sees_it_late_as_well(tmp_path):
    diagram = Model(step="0.1", solver="ode4")
    diagram.inport("u")
    diagram.block("ZeroOrderHold", "Hold", SampleTime="0.3")
    diagram.block("RateTransition", "R", ports=(1, 1), X0="5")
    diagram.block("Integrator", "I", ports=(1, 1))
    diagram.outport("x")
    diagram.chain("u", "Hold", "R", "I", "x")
    output = run(imported(diagram, tmp_path), {"u": U})["x"]
    np.testing.assert_allclose(output, T * np.concatenate([[0.0], np.cumsum(LATE)[:-1]]), atol=1e-13)


def test_a_slower_sample_time_holds_a_signal(tmp_path):
    diagram = drawn(slow="0.1", fast="-1", OutPortSampleTime="0.3", X0="5")
    outputs = run(imported(diagram, tmp_path), {"u": U})
    np.testing.assert_allclose(outputs["y"], 2 * SLOW)
    np.testing.assert_allclose(outputs["z"][3:], 2 * SLOW[:-3])


def test_signals_of_one_sample_time_pass(tmp_path):
    output = run(imported(drawn(slow="0.3", fast="0.3", X0="5"), tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(output, 2 * SLOW)


def scheduled(slow, fast, u, first):
    """Return the values that the faster of two tasks reads of the slower one, which runs after it; periods in steps."""
    buffer, shown, read = first, first, []
    for k, value in enumerate(u):
        if k % fast == 0:
            shown = buffer
        if k % slow == 0:
            buffer = value
        read.append(shown)
    return np.array(read)


TASKS = [{"SolverMode": "MultiTasking"}, {"SolverMode": "Auto"}, {"EnableMultiTasking": "on"}]


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
@pytest.mark.parametrize("settings", [{"Deterministic": "off"}, {"Integrity": "off"}])
@pytest.mark.parametrize(("slow", "fast"), [(3, 2), (3, 1), (4, 2)])
def test_a_faster_task_runs_before_the_slower_one(slow, fast, settings, layout, tmp_path):
    diagram = drawn(f"{slow / 10}", f"{fast / 10}", X0="5", **settings)
    diagram.solver |= TASKS[0]
    outputs = run(imported(diagram, tmp_path, layout), {"u": U})
    read = 2 * scheduled(slow, fast, U, 5.0)
    np.testing.assert_allclose(outputs["y"], read)
    before = np.repeat(np.concatenate([[0.0], read[::fast][:-1]]), fast)
    np.testing.assert_allclose(outputs["z"], before[: U.size])


@pytest.mark.parametrize("tasks", TASKS)
def test_sample_times_as_tasks_are_recognised_in_every_release(tasks, tmp_path):
    diagram = drawn("0.3", "0.2", X0="5", Deterministic="off")
    diagram.solver |= tasks
    result = import_simulink(diagram.write(tmp_path))
    np.testing.assert_allclose(run(result.model, {"u": U})["y"], 2 * scheduled(3, 2, U, 5.0))
    assert result.report.remarks == ()


@pytest.mark.parametrize("tasks", [{"SolverMode": "SingleTasking"}, {"EnableMultiTasking": "off"}])
def test_in_a_single_task_a_transition_shows_what_the_same_step_makes(tasks, tmp_path):
    diagram = drawn("0.3", "0.2", X0="5", Deterministic="off")
    diagram.solver |= tasks
    result = import_simulink(diagram.write(tmp_path))
    np.testing.assert_allclose(run(result.model, {"u": U})["y"], 2 * np.repeat(SLOW[::2], 2))
    assert result.report.remarks == ()


def test_the_effect_of_undeclared_tasks_is_reported(tmp_path):
    remarks = import_simulink(drawn(Deterministic="off").write(tmp_path)).report.notes
    assert any(str(one).startswith("R passes on") and "Select deterministic" in str(one) for one in remarks)
    assert import_simulink(drawn().write(tmp_path)).report.notes == ()


@pytest.mark.parametrize(("slow", "fast"), [(3, 2), (5, 2), (3, 1), (4, 2)])
@pytest.mark.parametrize("stated", [True, False])
def test_a_double_buffer_is_filled_at_the_hits_of_the_slower_task(slow, fast, stated, tmp_path):
    # sample times as in a model of one block: those of the ports, and of the transition itself
    diagram = Model(step="0.1", solver="FixedStepDiscrete")
    diagram.solver |= TASKS[0]
    diagram.inport("u", SampleTime=f"{slow / 10}")
    own = {"OutPortSampleTime": f"{fast / 10}"} if stated else {}
    diagram.block("RateTransition", "R", ports=(1, 1), Deterministic="off", X0="5", **own)
    diagram.outport("y", SampleTime=f"{fast / 10}")
    diagram.chain("u", "R", "y")
    np.testing.assert_allclose(run(imported(diagram, tmp_path), {"u": U})["y"], scheduled(slow, fast, U, 5.0))


def test_an_output_sample_time_may_have_an_offset(tmp_path):
    diagram = drawn(slow="0.1", fast="-1", OutPortSampleTime="[0.3 0.1]")
    output = run(imported(diagram, tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(output[1:], 2 * np.repeat(U[1::3], 3)[: U.size - 1])


@pytest.mark.parametrize(
    ("slow", "fast", "why"),
    [("0.3", "0.2", "R: it transfers from 0.3 s to 0.2 s deterministically, but 0.3 s is not a multiple"),
     ("[0.4 0.1]", "0.2", "R: it transfers between sample times with offsets of 0.1 s and 0 s deterministically")],
)  # fmt: skip
def test_a_transfer_whose_delay_would_vary_is_refused_as_in_simulink(slow, fast, why, tmp_path):
    with pytest.raises(InputError, match=re.escape(why)):
        imported(drawn(slow, fast), tmp_path)
