"""Rate transitions: a slower sample time holds a signal, a faster one sees it a hit of its own late."""

import numpy as np
import pytest

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
    made = Model(step="0.1", solver="FixedStepDiscrete")
    made.inport("u")
    made.block("ZeroOrderHold", "Hold", SampleTime=slow)
    made.block("RateTransition", "R", ports=(1, 1), **transition)
    made.block("Gain", "K", Gain="2")
    made.block("UnitDelay", "Z", SampleTime=fast)
    made.outport("y")
    made.outport("z")
    made.chain("u", "Hold", "R", "K", "Z", "z")
    made.line("K", "y")
    return made


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
def test_a_faster_sample_time_sees_a_signal_one_hit_late(layout, tmp_path):
    model = imported(drawn(X0="x0"), tmp_path, layout, parameters=[{"x0": 5.0}])
    found = run(model, {"u": U})
    np.testing.assert_allclose(found["y"], 2 * LATE)
    np.testing.assert_allclose(found["z"], [0.0, *2 * LATE[:-1]])
    exact, differences = slopes(model, {"u": U}, "x0", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-9)


@pytest.mark.parametrize(
    "settings",
    [{"OutPortSampleTime": "0.1"}, {"OutPortSampleTimeOpt": "Multiple of input port sample time",
                                    "OutPortSampleTimeMultiple": "1/3"}],
)  # fmt: skip
def test_the_sample_time_behind_may_be_stated(settings, tmp_path):
    found = run(imported(drawn(fast="-1", InitialCondition="5", **settings), tmp_path), {"u": U})
    np.testing.assert_allclose(found["y"], 2 * LATE)
    np.testing.assert_allclose(found["z"], [0.0, *2 * LATE[:-1]])


@pytest.mark.parametrize("settings", [{"Deterministic": "off"}, {"Integrity": "off"}])
def test_a_transition_that_need_not_be_deterministic_is_not_late(settings, tmp_path):
    found = run(imported(drawn(X0="5", **settings), tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(found, 2 * SLOW)


def test_what_is_behind_takes_the_faster_sample_time(tmp_path):
    made = drawn(X0="5", OutPortSampleTime="0.1", fast="-1")
    made.block("DiscreteIntegrator", "I", ports=(1, 1), SampleTime="-1")
    made.outport("x")
    made.line("R", "I")
    made.line("I", "x")
    found = run(imported(made, tmp_path), {"u": U})["x"]
    np.testing.assert_allclose(found, T * np.concatenate([[0.0], np.cumsum(LATE)[:-1]]), atol=1e-13)


def test_a_continuous_state_behind_sees_it_late_as_well(tmp_path):
    made = Model(step="0.1", solver="ode4")
    made.inport("u")
    made.block("ZeroOrderHold", "Hold", SampleTime="0.3")
    made.block("RateTransition", "R", ports=(1, 1), X0="5")
    made.block("Integrator", "I", ports=(1, 1))
    made.outport("x")
    made.chain("u", "Hold", "R", "I", "x")
    found = run(imported(made, tmp_path), {"u": U})["x"]
    np.testing.assert_allclose(found, T * np.concatenate([[0.0], np.cumsum(LATE)[:-1]]), atol=1e-13)


def test_a_slower_sample_time_holds_a_signal(tmp_path):
    made = drawn(slow="0.1", fast="-1", OutPortSampleTime="0.3", X0="5")
    found = run(imported(made, tmp_path), {"u": U})
    np.testing.assert_allclose(found["y"], 2 * SLOW)
    np.testing.assert_allclose(found["z"][3:], 2 * SLOW[:-3])


def test_signals_of_one_sample_time_pass(tmp_path):
    found = run(imported(drawn(slow="0.3", fast="0.3", X0="5"), tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(found, 2 * SLOW)


def scheduled(slow, fast, u, first):
    """What the faster of two tasks reads of the slower one, which runs behind it; both periods in steps."""
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
    made = drawn(f"{slow / 10}", f"{fast / 10}", X0="5", **settings)
    made.solver |= TASKS[0]
    found = run(imported(made, tmp_path, layout), {"u": U})
    read = 2 * scheduled(slow, fast, U, 5.0)
    np.testing.assert_allclose(found["y"], read)
    before = np.repeat(np.concatenate([[0.0], read[::fast][:-1]]), fast)
    np.testing.assert_allclose(found["z"], before[: U.size])


@pytest.mark.parametrize("tasks", TASKS)
def test_every_release_says_in_its_way_that_sample_times_are_tasks(tasks, tmp_path):
    made = drawn("0.3", "0.2", X0="5", Deterministic="off")
    made.solver |= tasks
    found = import_simulink(made.write(tmp_path))
    np.testing.assert_allclose(run(found.model, {"u": U})["y"], 2 * scheduled(3, 2, U, 5.0))
    assert found.report.remarks == ()


@pytest.mark.parametrize("tasks", [{"SolverMode": "SingleTasking"}, {"EnableMultiTasking": "off"}])
def test_in_a_single_task_a_transition_shows_what_the_same_step_makes(tasks, tmp_path):
    made = drawn("0.3", "0.2", X0="5", Deterministic="off")
    made.solver |= tasks
    found = import_simulink(made.write(tmp_path))
    np.testing.assert_allclose(run(found.model, {"u": U})["y"], 2 * np.repeat(SLOW[::2], 2))
    assert found.report.remarks == ()


def test_what_the_tasks_would_decide_is_told_where_the_file_does_not_say_them(tmp_path):
    remarks = import_simulink(drawn(Deterministic="off").write(tmp_path)).report.notes
    assert any(str(one).startswith("R passes on") and "Select deterministic" in str(one) for one in remarks)
    assert import_simulink(drawn().write(tmp_path)).report.notes == ()
