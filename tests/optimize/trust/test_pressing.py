"""Limits of outputs: what they hold, against repeated measurements that are fitted within them."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.domain.constraints import Limit
from kennfeld.domain.criteria import Criterion
from kennfeld.optimize import Options, Problem, Stop
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.fit.result import Seconds
from kennfeld.optimize.trust.active_limits import multipliers
from tests.draws import mostly_slow
from tests.optimize.repetitions import agree
from tests.optimize.trust.dense_covariance import DenseCovariance, slopes

GRID = np.linspace(0, 10, 11)
U = np.random.default_rng(3).uniform(0, 10, 400)
WAVE = 3 * np.sin(GRID)
WEIGHTS = np.array([np.interp(U, GRID, unit) for unit in np.eye(GRID.size)]).T  # of each value at each sample
REPETITIONS = 100


def curve_problem(*limits, noise=0.3, seed=0, **more):
    z = np.interp(U, GRID, WAVE) + noise * np.random.default_rng(seed).standard_normal(U.size)
    start = kf.ParameterSet([kf.Curve("C", GRID, WAVE)])
    data = kf.Dataset.of("d", {"u": U, "z": z})
    return Problem(
        kf.formula("w = C(u)", parameters=["C"]), (data,), start, (Criterion("w", "z"),), limits=limits, **more
    )


def result_of(problem):
    return FitRun(problem, Options(continuation="off"), None, Seconds()).result()


def repeated_within(problem, truth, noise, count=REPETITIONS):
    """Values fitted to so many measurements of the true function within the limits, shape (count, values)."""
    run = FitRun(problem, Options(continuation="off", tolerance=1e-5), None, Seconds())
    target = problem.datasets[0]["z"].values
    target.setflags(write=True)  # what is compiled reads it where it lies
    outputs, original = run.outputs, target.copy()
    rng = np.random.default_rng(1)
    ends = []
    try:
        for _ in range(count):
            target[:] = truth + noise * rng.standard_normal(target.size)
            run.exact.samples.wanted.reread()
            outputs._penalised.samples.wanted.reread()
            end, _ = run.minimise()
            assert end.status == "converged"
            ends.append(end.values)
    finally:
        target[:] = original
    return np.array(ends)


def dense_within(result, lower, upper, *, pinned=(), smoothness=0.0):
    """The covariance of the curve whose samples at a limit stay there."""
    outputs = WEIGHTS @ result.parameters["C"].values
    reached = np.isclose(outputs, lower, atol=1e-4) | np.isclose(outputs, upper, atol=1e-4)
    holding = np.vstack([WEIGHTS[reached], np.eye(GRID.size)[list(pinned)]])
    bends = np.diff(np.eye(GRID.size), 2, axis=0) * np.sqrt(smoothness / GRID.size)
    return DenseCovariance(WEIGHTS, holding, bends)


@pytest.mark.slow
def test_samples_at_a_limit_stay_there():
    """Two flat tops, of which many neighbouring samples are at the limit, and a lone sample at the lower one."""
    result = result_of(curve_problem(Limit("w", -2.5, 2.0)))
    trust, noise = result.trust, result.trust.noise["w"]
    assert noise == pytest.approx(0.3, rel=0.1)  # not what the limits cost
    assert np.all(trust.deviation["C"][[1, 2, 7, 8]] < 1e-6)
    assert trust.deviation["C"][5] < 1e-3
    assert trust.covariance() == pytest.approx(dense_within(result, -2.5, 2.0).error(noise), rel=1e-9, abs=1e-12)


@pytest.mark.slow
def test_values_within_limits_scatter_as_predicted():
    """Two flat tops, of which many neighbouring samples are at the limit, and a lone sample at the lower one."""
    problem = curve_problem(Limit("w", -2.5, 2.0))
    trust = result_of(problem).trust
    ends = repeated_within(problem, np.interp(U, GRID, WAVE), 0.3)
    flat = [1, 2, 7, 8]
    assert np.all(trust.deviation["C"][flat] < 1e-6)
    assert np.all(np.std(ends, axis=0)[flat] < 1e-6)
    covariance = trust.covariance()
    rest = np.setdiff1d(np.arange(11), [*flat, 5])
    agree(covariance[np.ix_(rest, rest)], ends[:, rest])
    assert trust.deviation["C"][5] < 1e-3


STEP = "y = PT1(PT1(k * u, 0.3) + overshoot * (u - PT1(u, 0.4)), 0.1)"


@cache
def step_problem(upper):
    time = 0.04 * np.arange(150)
    u = np.where(time % 3 < 1.5, 1.0, 0.0)
    truth = kf.ParameterSet([kf.Scalar("k", 1.0), kf.Scalar("overshoot", 0.6)])
    clean = kf.simulate(STEP, kf.Dataset.of("d", {"u": u}, time=time), truth)["y"].values
    z = clean + 0.03 * np.random.default_rng(2).standard_normal(time.size)
    data = kf.Dataset.of("steps", {"u": u, "z": z}, time=time)
    model = kf.formula(STEP, parameters=["k", "overshoot"])
    limits = (Limit("y", upper=upper * clean.max()),)
    return Problem(model, (data,), truth, (Criterion("y", "z"),), limits=limits), clean


@pytest.mark.slow
def test_a_limit_of_a_peak_ties_the_gains_together():
    problem, _ = step_problem(0.97)
    result = result_of(problem)
    trust = result.trust
    (holding,) = trust.holdings
    assert holding.directions == 1
    assert set(holding.parameters) == {"k", "overshoot"}
    assert trust.correlation()[0, 1] == pytest.approx(-1.0, abs=1e-3)
    (data,) = problem.datasets
    jacobian = slopes(STEP, data, result.parameters, "y")
    highest = kf.simulate(STEP, data, result.parameters)["y"].values.argmax()
    dense = DenseCovariance(jacobian, jacobian[[highest]], np.zeros((0, 2)))
    predicted = trust.covariance(scatter=True)
    assert predicted == pytest.approx(
        dense.scatter(trust.noise["y"]) * trust.persistence["y"], rel=0.05
    )  # its neighbours hold a little
    loose = result_of(step_problem(1.5)[0]).trust
    assert np.all(predicted.diagonal() < loose.covariance().diagonal())


@pytest.mark.slow
def test_the_gains_tied_by_the_limit_of_a_peak_scatter_a_little_less_than_predicted():
    """The highest sample changes with the noise; the limit determines its height.

    Along the tie, neighbours of the highest sample hold a little as well: what is said is on the safe side.
    """
    problem, clean = step_problem(0.97)
    trust = result_of(problem).trust
    predicted = trust.covariance(scatter=True)
    ends = repeated_within(problem, clean, 0.03)
    ratio = np.std(ends, axis=0, ddof=1) / np.sqrt(np.diag(predicted)) * np.sqrt(trust.persistence["y"])
    assert np.all((ratio > 0.7) & (ratio < 1.1))


def test_an_inactive_limit_determines_no_values():
    trust = result_of(step_problem(1.5)[0]).trust
    assert trust.holdings == ()
    assert abs(trust.correlation()[0, 1]) < 0.99


@pytest.mark.slow
def test_values_determined_by_a_limit_are_described():
    trust = result_of(curve_problem(Limit("w", upper=2.0))).trust
    (holding,) = trust.holdings
    assert holding.limit == "w <= 2"
    assert holding.sentence.startswith(f"The limit w <= 2 is reached at {holding.samples} samples, e.g. sample ")
    assert holding.sentence.endswith(" of d. It, not the data, determines 4 combinations of values of C.")
    assert holding.parameters == ("C",)
    assert trust.as_json()["holdings"][0]["directions"] == 4
    assert str(holding) in str(trust)
    assert trust.freedom == pytest.approx(7.0)


def test_a_limit_reached_by_chance_is_listed_without_values():
    free = result_of(curve_problem())
    highest = float(np.interp(U, GRID, free.parameters["C"].values).max())
    trust = result_of(curve_problem(Limit("w", upper=highest * (1 + 1e-6)))).trust
    (holding,) = trust.holdings
    assert holding.directions == 0
    assert holding.sentence.endswith("but does not affect the result.")
    assert trust.deviation["C"] == pytest.approx(free.trust.deviation["C"], rel=1e-3)


def smooth_and_pinned(smoothness):
    return curve_problem(Limit("w", -2.5, 2.0), pins=(kf.Pin("C", (3.0,), 0.5),), smoothness={"C": smoothness})


def test_smoothness_pins_and_limits_determine_values_together():
    result = result_of(smooth_and_pinned(50.0))
    trust, noise = result.trust, result.trust.noise["w"]
    dense = dense_within(result, -2.5, 2.0, pinned=[3], smoothness=50.0)
    assert trust.deviation["C"][3] == 0
    assert trust.covariance() == pytest.approx(dense.error(noise), rel=1e-9, abs=1e-12)
    assert trust.covariance(scatter=True) == pytest.approx(dense.scatter(noise), rel=1e-9, abs=1e-12)
    assert np.abs(dense.error(noise) - dense.scatter(noise)).max() > 1e-4


@pytest.mark.slow
def test_smoothed_pinned_and_limited_values_scatter_as_predicted():
    problem = smooth_and_pinned(0.5)
    trust = result_of(problem).trust
    ends = repeated_within(problem, np.interp(U, GRID, WAVE), 0.3, 60)
    rest = np.setdiff1d(np.arange(11), [1, 2, 3, 5, 7, 8])
    assert trust.scatter["C"][rest] == pytest.approx(np.std(ends, axis=0)[rest], rel=0.35)


@pytest.mark.parametrize("edge", mostly_slow([0.0, -1.0], 1))
def test_limits_that_cannot_be_satisfied_give_no_trust(edge):
    result = result_of(curve_problem(Limit("w", upper=edge - 1), Limit("-w", upper=edge)))
    assert result.status == "infeasible"
    assert result.trust.deviation == {}
    assert result.trust.as_json()["undetermined"] is None


def test_a_limit_on_a_constant_determines_no_values():
    trust = result_of(curve_problem(Limit("0 * w", upper=0.0))).trust
    assert all(holding.directions == 0 for holding in trust.holdings)
    assert np.all(trust.deviation["C"] > 0)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 12))
def test_multipliers_are_those_of_the_best_values_within_the_limits(seed, values, samples):
    """Against the conditions of optimality: none is negative, and each belongs to a limit that is just met."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(samples, values)) * 10.0 ** rng.uniform(-2, 2, (samples, 1))
    rows[rng.random(samples) < 0.3] = rows[0]
    gram, beyond = rows @ rows.T, rows @ rng.normal(size=values)
    beyond -= np.abs(beyond) * rng.random(samples) * (rng.random(samples) < 0.5)
    pressure = multipliers(gram, beyond)
    gain = (beyond - gram @ pressure) / np.sqrt(np.diag(gram))
    size = np.abs(beyond / np.sqrt(np.diag(gram))).max()
    assert np.all(pressure >= 0)
    assert np.all(gain <= 1e-6 * size)
    assert np.all(np.abs(gain[pressure > 0]) <= 1e-6 * size)


@pytest.mark.slow
def test_the_values_determined_by_each_side_of_a_limit_are_counted():
    trust = result_of(curve_problem(Limit("w", -2.5, 2.0))).trust
    assert {holding.limit: holding.directions for holding in trust.holdings} == {"w <= 2": 4, "w >= -2.5": 1}


def test_a_search_that_was_stopped_between_its_limits_has_a_trust():
    def stop(line):
        if line.stage == "limits 2":
            raise Stop

    run = FitRun(curve_problem(Limit("w", -2.5, 2.0)), Options(continuation="off"), stop, Seconds())
    trust = run.result().trust
    assert trust.remark.startswith("The search ended with status stopped.")
    assert np.all(trust.deviation["C"] >= 0)
    assert len(trust.holdings) == 2


def test_values_that_limits_of_outputs_determine_have_a_deviation_of_0():
    time = 0.1 * np.arange(300)
    u = np.repeat(np.random.default_rng(0).uniform(0, 5, 30), 10)
    truth = {"k": 1.5, "T": 0.8}
    clean = kf.simulate("m = PT1(k * u, T)", kf.Dataset.of("d", {"u": u}, time=time), truth)["m"].values
    z = clean + 0.05 * np.random.default_rng(1).standard_normal(time.size)
    data = kf.Dataset.of("d", {"u": u, "z": z}, time=time)
    start = {"k": 1.0, "T": 1.0}
    result = kf.calibrate("m = PT1(k * u, T)", data, start, target="z", limits=[Limit("m - u", upper=3.5)])
    trust = result.trust
    assert trust.holdings[0].directions == 2
    assert [float(deviation) for deviation in trust.deviation.values()] == [0.0, 0.0]
    assert trust.noise["m"] == pytest.approx(0.05, rel=0.15)
    assert not trust.covariance().any()


def test_a_pinned_value_has_a_deviation_of_0_even_with_too_few_samples_for_the_noise():
    tables = kf.ParameterSet([kf.Curve("C", [0.0, 1.0], [1.0, 1.0])])
    data = {"x": [1.0], "m": [3.0]}
    trust = kf.calibrate("y = C(x)", data, tables, target="m", pins=[kf.Pin("C", (0.0,), 1.0)]).trust
    assert trust.deviation["C"][0] == 0
    assert np.isnan(trust.deviation["C"][1])
