"""Limits of outputs, against a general convex solver and a search over a grid."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.constraints import Limit
from kennfeld.domain.criteria import Criterion
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize import Options, Problem, run
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.strategies.limit_excess import FEASIBLE
from kennfeld.preprocessing.binding import bind_inputs
from tests.draws import mostly_slow
from tests.optimize import idle

GRID = np.linspace(0, 10, 11)


class Curve:
    """A noisy curve, its fit within limits, and the same as a convex program."""

    def __init__(self, seed=1, samples=400):
        random = np.random.default_rng(seed)
        self.u = random.uniform(0, 10, samples)
        self.z = 3 * np.sin(self.u) + 0.3 * random.standard_normal(samples)

    def fitted(self, *limits, start=0.0, **more):
        parameters = kf.ParameterSet([kf.Curve("C", GRID, np.full(11, start))])
        problem = Problem(
            kf.formula("w = C(u)", parameters=["C"]),
            (kf.Dataset.of("d", {"u": self.u, "z": self.z} | more),),
            parameters,
            (Criterion("w", "z"),),
            limits=limits,
        )
        return run(problem, Options())

    def judged(self, conditions):
        """Cost and values of the convex program."""
        import cvxpy

        weights = cell_weights(position(self.u, GRID, "clip"), 11)[0]
        z = cvxpy.Variable(11)
        program = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(weights @ z - self.z)), conditions(weights @ z))
        program.solve(solver=cvxpy.CLARABEL, tol_gap_rel=1e-12, tol_feas=1e-12)
        return program.value, z.value


@pytest.mark.parametrize("seed", mostly_slow(range(3), 1))
def test_a_fit_within_limits_is_that_of_a_convex_solver(seed):
    curve = Curve(seed)
    result = curve.fitted(Limit("w", -2.5, 2.0), Limit("w + 0.1 * u", upper=2.2, where="u > 5"))
    right = curve.u > 5
    cost, values = curve.judged(lambda w: [w <= 2, w >= -2.5, (w + 0.1 * curve.u)[right] <= 2.2])
    assert result.status == "converged"
    assert result.cost_after == pytest.approx(cost, rel=1e-5)
    np.testing.assert_allclose(result.parameters["C"].values, values, atol=1e-4)
    w = np.interp(curve.u, GRID, result.parameters["C"].values)
    assert w.max() <= 2 * (1 + FEASIBLE)
    assert w.min() >= -2.5 * (1 + FEASIBLE)


def test_limits_that_the_best_fit_satisfies_have_no_effect():
    curve = Curve()
    free, limited = curve.fitted(), curve.fitted(Limit("w", -4.0, 4.0))
    assert limited.parameters == free.parameters
    assert limited.cost_after == free.cost_after


def test_a_limit_may_be_0():
    result = Curve().fitted(Limit("w", upper=0.0))
    assert result.status == "converged"
    assert np.interp(Curve().u, GRID, result.parameters["C"].values).max() <= 1e-5


def test_a_limit_may_follow_a_channel():
    curve = Curve()
    result = curve.fitted(Limit("w - ceiling", upper=0.0), ceiling=1 + 0.1 * curve.u)
    cost, _ = curve.judged(lambda w: [w <= 1 + 0.1 * curve.u])
    assert result.cost_after == pytest.approx(cost, rel=1e-5)


@pytest.mark.slow
def test_contradictory_limits_are_reported_with_their_distance():
    result = Curve().fitted(Limit("w", lower=2.0), Limit("w", upper=1.0, where="u > 5"))
    assert result.status == "infeasible"
    assert "w >= 2 is exceeded at" in result.message
    assert "w <= 1 is exceeded at" in result.message


LOOP = """
scalar kp
scalar ki
error = n_set - n
integral = integrator(error)
command = kp * error + ki * integral
n = prev(n_next, 0)
n_next = n + dt * (3 * command - 2 * n - load)
"""


def loop():
    """A set-value step and a load step."""
    time = np.arange(0, 10, 0.02)
    data = {"n_set": np.where(time < 1, 0.0, 1.0), "load": np.where(time > 6, 0.5, 0.0)}
    return kf.Dataset.of("step", data, time=time)


def overshoot(kp, ki):
    """The cost and the largest n of the loop."""
    simulation = kf.simulate(LOOP, loop(), {"kp": kp, "ki": ki})
    return float(np.sum((simulation["n"].values - loop()["n_set"].values) ** 2)), float(simulation["n"].values.max())


@pytest.mark.slow
def test_a_closed_loop_is_the_best_with_its_overshoot_within_the_limit():
    start = kf.ParameterSet([kf.Scalar("kp", 0.5).with_bounds(0.0, 6.0), kf.Scalar("ki", 0.5).with_bounds(0.0, 20.0)])
    free = kf.calibrate(LOOP, loop(), start, target="n_set", node="n")
    assert overshoot(*(free.parameters[name].value for name in ("kp", "ki")))[1] > 1.03
    limited = kf.calibrate(LOOP, loop(), start, target="n_set", node="n", limits={"n": (-np.inf, 1.01)})
    kp, ki = (limited.parameters[name].value for name in ("kp", "ki"))
    cost, highest = overshoot(kp, ki)
    assert highest <= 1.01 * (1 + 1e-5)
    assert limited.cost_after == pytest.approx(cost, rel=1e-9)
    around = [overshoot(a * kp, b * ki) for a in np.linspace(0.9, 1.0, 3) for b in np.linspace(0.9, 1.1, 5)]
    assert cost <= 1.001 * min(c for c, top in around if top <= 1.01)


@pytest.mark.slow
def test_an_idle_governor_stays_below_its_limit_and_no_gains_nearby_are_better():
    data, model, start = idle.mean_value()
    free = kf.calibrate(model, data, start, target="rpm_ref", node="rpm")
    limited = kf.calibrate(model, data, start, target="rpm_ref", node="rpm", limits={"rpm": (-np.inf, 2990.0)})
    nodes = NodeSimulator(model.graph, start, ["rpm"])
    bound = bind_inputs(data, model.graph, {})

    def run_with(kp, ki):
        """Cost and highest speed."""
        rpm = nodes.values(bound, idle.gains(kp, ki))[0]
        return float(np.sum((rpm - data["rpm_ref"].values) ** 2)), float(rpm.max())

    best = [limited.parameters[name].value for name in ("kp", "kI")]
    assert run_with(*(free.parameters[name].value for name in ("kp", "kI")))[1] > 3050
    cost, highest = run_with(*best)
    assert highest <= 2990 * (1 + FEASIBLE)
    assert limited.cost_after == pytest.approx(cost, rel=1e-9)
    around = [run_with(a * best[0], b * best[1]) for a in np.linspace(0.7, 1.4, 8) for b in np.linspace(0.7, 1.4, 8)]
    assert cost <= 1.001 * min(c for c, rpm in around if rpm <= 2990)


@pytest.mark.slow
def test_datasets_of_the_same_name_have_separate_limits():
    halves = [{"u": np.linspace(0, 5, 60), "z": np.full(60, 3.0)}, {"u": np.linspace(5, 10, 35), "z": np.full(35, 4.0)}]
    data = [kf.Dataset.of("bench", columns) for columns in halves]
    start = kf.ParameterSet([kf.Curve("C", GRID, np.zeros(11))])
    limit = Limit("w", upper=2.5, where="u < 5")
    for order in (data, data[::-1]):
        values = kf.calibrate("w = C(u)", order, start, target="z", limits=[limit]).parameters["C"].values
        assert np.interp(halves[0]["u"][:-1], GRID, values).max() <= 2.5 * (1 + FEASIBLE)
        assert values[:3] == pytest.approx(2.5, abs=1e-4)
        assert values[8:] == pytest.approx(4.0, abs=0.05)


def test_samples_of_output_limits_are_numbered_from_1():
    data = {"x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}
    result = kf.calibrate("y = a * x", data, {"a": 0.5}, target="m", limits=[kf.Limit("y", upper=3.0)])
    assert "The limit y <= 3 is reached at sample 3 of" in str(result.trust)
    failed = kf.calibrate(
        "y = a * x", data, {"a": 0.5}, target="m", limits=[kf.Limit("y", upper=3.0), kf.Limit("a * x", lower=4.0)]
    )
    assert "sample 0" not in failed.message
    assert "at sample 1 of" in failed.message or "at sample 3 of" in failed.message


@pytest.mark.parametrize("method", ["gauss-newton", "global"])
def test_values_that_limits_alone_determine_do_not_return_to_their_start(method):
    x = np.arange(6.0)
    start = {
        "a": kf.Scalar("a", 0.5, lower=0.0, upper=5.0),
        "k": kf.Scalar("k", 9.0, lower=0.0, upper=15.0),
    }
    options = kf.Options(method=method, max_evaluations=300)
    formula = "m = a * x\nz = k * x"
    result = kf.calibrate(
        formula, {"x": x, "y": 2 * x + 0.1}, start, "y", node="m", limits={"z": (0, 20)}, options=options
    )
    assert result.status != "infeasible"
    assert result.parameters["k"].value * 5 <= 20 + 1e-6
    assert "of k" not in result.message  # k was moved, so that it is not at its start
