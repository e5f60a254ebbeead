"""Trial values without finite numbers end no run; they are counted, and the message says what went wrong."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.quality.rejected_steps import RejectionReasons
from tests.draws import mostly_slow

STEP = 0.1


def levels(count=40, length=50, seed=0):
    return np.repeat(np.random.default_rng(seed).normal(size=count), length)


def lagged(u, constant):
    y, outputs = u[0], []
    for x in u:
        y += STEP / (constant + STEP) * (x - y)
        outputs.append(y)
    return np.array(outputs)


def recorded(u, measured, name="drive", **columns):
    return kf.Dataset.of(name, {"u": u, "m": measured, **columns}, time=STEP * np.arange(u.size))


def noisy(values, deviation=0.01, seed=1):
    return values + np.random.default_rng(seed).normal(0.0, deviation, values.size)


def test_rejected_steps_to_a_negative_time_constant_are_counted_and_reported():
    u = levels()
    result = kf.calibrate("y = PT1(u, 2 * T)", recorded(u, noisy(u)), {"T": 0.5}, "m")
    assert result.converged
    assert 0 <= result.parameters["T"].value < 0.01
    assert "rejected: the time constant T of a PT1 was below 0 at sample 1 of drive" in result.message


def test_a_run_without_rejected_steps_does_not_mention_them():
    u = levels()
    result = kf.calibrate("y = PT1(u, T)", recorded(u, noisy(lagged(u, 2.0))), {"T": 1.0}, "m")
    assert result.parameters["T"].value == pytest.approx(2.0, rel=0.02)
    assert "rejected" not in result.message


def test_a_time_constant_of_several_parameters_is_reported_without_a_name():
    u = levels()
    result = kf.calibrate("y = PT1(u, A + B * abs(u))", recorded(u, noisy(u)), {"A": -1.0, "B": 0.0}, "m")
    assert result.status == "failed"
    assert "At these values the time constant of a PT1 was below 0 at sample 1 of drive" in result.message


def test_a_named_time_constant_is_reported_by_its_node():
    u = levels()
    result = kf.calibrate("lag = A - B\ny = PT1(u, lag)", recorded(u, u), {"A": 1.0, "B": 2.0}, "m", node="y")
    assert "the time constant lag of a PT1 was below 0" in result.message


def test_a_loop_that_explodes_at_the_start_is_named_with_its_first_sample():
    u = np.ones(3000)
    result = kf.calibrate("y = a * prev(y, 0) + u", recorded(u, u), {"a": 2.0}, "m")
    assert result.status == "failed"
    assert "y was not finite at sample 1024 of drive" in result.message  # 2^1024 is beyond all floats


@pytest.mark.parametrize("seed", mostly_slow(range(4), 2))
def test_trial_values_that_explode_do_not_end_a_run(seed):
    u = levels(200, 40, seed)
    y, outputs = 0.0, []
    for x in u:
        y = 0.998 * y + 0.02 * x
        outputs.append(y)
    data = recorded(u, noisy(np.array(outputs), 0.001, seed))
    result = kf.calibrate("y = a * prev(y, 0) + b * u", data, {"a": 0.0, "b": 1.0}, "m")
    assert result.converged
    assert result.parameters["a"].value == pytest.approx(0.998, abs=1e-4)


def test_overflow_of_squares_is_distinguished_from_overflow_of_nodes():
    data = kf.Dataset.of("bench", {"x": [1.0, 2.0], "m": [1.0, 2.0]})
    result = kf.calibrate("y = a * x", data, {"a": 1e200}, "m")
    assert result.status == "failed"
    assert "the errors overflowed" in result.message


def test_a_division_by_zero_is_traced_to_its_own_node():
    data = kf.Dataset.of("bench", {"x": [1.0, 0.0, 2.0], "m": [1.0, 2.0, 3.0]})
    result = kf.calibrate("last = 2 * share\nshare = a / x", data, {"a": 1.0}, "m", node="last")
    assert "share was not finite at sample 2 of bench" in result.message


def test_a_node_without_a_criterion_is_not_the_reason():
    data = kf.Dataset.of("bench", {"x": [0.0, 1.0, 4.0], "m": [1.0, 2.0, 3.0]})
    text = "shown = 1 / x\nlast = a / (x - 1)"
    result = kf.calibrate(text, data, {"a": 1.0}, "m", node="last")
    assert "last was not finite at sample 2 of bench" in result.message


def test_a_node_that_a_criterion_uses_through_a_memory_is_the_reason():
    data = recorded(np.array([1.0, 0.0, 2.0, 1.0]), np.ones(4))
    result = kf.calibrate("last = prev(share, a)\nshare = a / u", data, {"a": 1.0}, "m", node="last")
    assert "share was not finite at sample 2 of drive" in result.message


def test_the_sample_is_counted_in_the_recording_with_its_gaps():
    x = np.array([1.0, np.nan, 0.0, 2.0])
    data = kf.Dataset.of("bench", {"x": x, "m": np.ones(4)})
    result = kf.calibrate("y = a / x", data, {"a": 1.0}, "m")
    assert "at sample 3 of bench" in result.message


def test_several_reasons_are_counted():
    from kennfeld.optimize.problem.setup import ProblemSetup
    from kennfeld.optimize.quality.rejected_steps import describe_rejections
    from kennfeld.optimize.sums.rejected_trials import RejectedTrials

    u = np.ones(3000)
    problem = ProblemSetup("y = PT1(a * prev(y, 0) + u, T)", recorded(u, u), {"T": 1.0, "a": 0.5}, "m").problem()
    rejected = RejectedTrials()
    for values in ([-1.0, 0.0], [-2.0, 0.0], [0.0, 3.0]):
        rejected.add(np.array(values))

    def parameters(values):
        return problem.parameters.with_parameters(
            *(problem.parameters[name].with_values(value) for name, value in zip("Ta", values, strict=True))
        )

    message = describe_rejections(problem, rejected, parameters)
    assert message.startswith("3 trial steps were rejected: in 2 the time constant T of a PT1 was below 0")
    assert "in 1 y was not finite" in message


def test_values_that_can_be_evaluated_have_no_reason():
    from kennfeld.optimize.problem.setup import ProblemSetup

    u = levels()
    problem = ProblemSetup("y = PT1(u, T)", recorded(u, u), {"T": 1.0}, "m").problem()
    assert RejectionReasons(problem).of(problem.parameters) == "the errors overflowed"


@pytest.mark.parametrize("workers", mostly_slow([1, 2], 1))
def test_each_of_several_starts_reports_its_own_reasons(workers):
    u = levels()
    bounds = {"T": (-5.0, 5.0)}
    options = kf.Options(starts=3, workers=workers)
    data = recorded(u, noisy(lagged(u, 0.5)))
    result = kf.calibrate("y = PT1(u, T)", data, {"T": 4.0}, "m", bounds=bounds, options=options)
    assert result.parameters["T"].value == pytest.approx(0.5, rel=0.05)
    failed = [row for row in result.starts if row.status == "failed"]
    assert all("the time constant T of a PT1 was below 0" in row.message for row in failed)
