"""Scores are the gains of full refits where the function is linear, without memory and with it."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.missing.candidate_sums import block_sums, family_sums
from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.families import HatAxis, channel_families, series_families
from kennfeld.analysis.missing.probes import Nodes, Probes, factor, offset
from kennfeld.analysis.missing.score import Linearisation
from kennfeld.analysis.missing.scoring import score_problem, trial_series
from kennfeld.analysis.missing.terms import MissingTerm, extended_model
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.sums.compiled import CompiledProblem

AXES = [HatAxis(name, name, (-2.0, -1.0, 0.0, 1.0, 2.0)) for name in ("x", "z", "w")]
EXACT = Options(tolerance=1e-14, continuation="off", max_iterations=200)
CURVE = kf.Curve("C", np.linspace(-3, 3, 9), np.zeros(9))


def columns(samples=300, seed=0):
    rng = np.random.default_rng(seed)
    data = {name: rng.normal(size=samples) for name in ("x", "z", "w")}
    return data | {"m": np.sin(data["x"]) + 0.3 * np.abs(data["z"]) + 0.2 * rng.normal(size=samples)}


def fitted(text, start, data, **settings):
    problem = ProblemSetup(text, data, start, "m", **settings).problem()
    result = run(problem, EXACT)
    return replace(problem, parameters=result.parameters), result


def scores_of(problem, kinds=("add",), axes=AXES, series=()):
    nodes = Nodes.of(problem)
    probes = Probes.of(problem, nodes.names)
    compiled = CompiledProblem(probes.problem)
    names = [name for number in range(len(nodes.names)) for name in (offset(number), factor(number))]
    linear = Linearisation(compiled, compiled.start, block_sums(compiled, compiled.start, {}, 0), names)
    families = [
        *channel_families(probes, axes, kinds, nodes.constant, compiled.values.free),
        *series_families(probes, series),
    ]
    scores = [
        score
        for family in families
        for score in linear.scores(family, family_sums(compiled, [family], compiled.start, {}, 0)[0])
    ]
    return {(s.term.node, s.term.kind, s.term.channel or s.term.seconds or s.term.steps): s for s in scores}, linear


def refitted(problem, term):
    """Return the result of a fit with a term, from scratch."""
    label = "New"
    parameter = term.parameter(label)
    parameters = problem.parameters if parameter is None else problem.parameters.with_parameters(parameter)
    return run(replace(problem, model=extended_model(problem.model, term, label), parameters=parameters), EXACT)


def refit_with_column(data):
    """Return a fit of the curve and of a factor of the channel u."""
    start = {"C": CURVE, "q": 0.0}
    return kf.calibrate("y = C(x) + q * u", data, start, "m", smoothness={"C": 1.0}, options=EXACT)


def data_cost(result):
    return sum(row.samples * row.rmse_after**2 for row in result.quality)


@pytest.mark.parametrize("timed", [False, True], ids=["without memory", "with memory"])
def test_the_gain_of_a_linear_function_is_that_of_a_full_refit(timed):
    data = columns() | ({"time": 0.1 * np.arange(300)} if timed else {})
    text = "y = PT1(C(x), 0.5) + k" if timed else "y = C(x) + k"
    problem, result = fitted(text, {"k": 0.0, "C": CURVE}, data, smoothness=1.0)
    scores, linear = scores_of(problem)
    assert linear.own_gain == pytest.approx(0.0, abs=1e-12)
    for score in scores.values():
        refit = refitted(problem, score.term)
        assert score.gain == pytest.approx(result.cost_after - refit.cost_after, rel=1e-9)
        assert score.predicted == pytest.approx(data_cost(refit), rel=1e-9)


def test_values_at_a_bound_and_pins_take_no_part():
    data = columns()
    settings = {"bounds": {"C": (-0.5, 0.5)}, "pins": [kf.Pin("C", (0.75,), 0.2)], "smoothness": 0.1}
    problem, result = fitted("y = C(x) + k", {"k": 0.0, "C": CURVE}, data, **settings)
    scores, _ = scores_of(problem)
    score = scores["y", "add", "z"]
    refit = refitted(problem, score.term)
    # bounds that stay as they are leave a linear problem
    at_bound = np.abs(result.parameters["C"].values) >= 0.5
    assert at_bound.any()
    assert np.array_equal(at_bound, np.abs(refit.parameters["C"].values) >= 0.5)
    assert score.gain == pytest.approx(result.cost_after - refit.cost_after, rel=1e-7)


def test_a_base_that_is_not_at_its_optimum_is_corrected():
    data = columns()
    problem, result = fitted("y = C(x) + k", {"k": 0.0, "C": CURVE}, data, smoothness=1.0)
    moved = problem.parameters.with_parameters(problem.parameters["C"].with_values(np.linspace(0, 1, 9)))
    best, _ = scores_of(problem)
    scores, linear = scores_of(replace(problem, parameters=moved))
    before = run(replace(problem, parameters=moved), EXACT).cost_before
    assert linear.own_gain == pytest.approx(before - result.cost_after, rel=1e-8)
    for key, score in scores.items():
        assert score.gain == pytest.approx(best[key].gain, rel=1e-7)


def test_a_node_and_its_factor_have_the_slopes_of_differences():
    data = columns()
    problem, _ = fitted("a = C(x)\ny = a * exp(0.3 * z)", {"C": CURVE}, data)
    scores, _ = scores_of(problem, ("add", "multiply"))
    by_hand = {}
    simulated = kf.simulate("a = C(x)\ny = a * exp(0.3 * z)", data, problem.parameters)
    slope = np.exp(0.3 * data["z"])
    hats = np.array([np.interp(data["w"], AXES[2].points, row) for row in np.eye(5)]).T
    rows = np.array([np.interp(data["x"], CURVE.axes[0].breakpoints, row) for row in np.eye(9)]).T * slope[:, None]
    r = data["m"] - simulated["y"].values
    for kind, times in (("add", 1.0), ("multiply", simulated["a"].values)):
        both = np.hstack([rows, hats * (slope * times)[:, None]])
        left = r - both @ np.linalg.lstsq(both, r, rcond=None)[0]
        by_hand[kind] = r @ r - left @ left
    for kind, gain in by_hand.items():
        assert scores["a", kind, "w"].gain == pytest.approx(gain, rel=1e-6)


def test_lags_and_delays_are_scored_as_columns_of_a_linear_problem():
    data = columns() | {"time": 0.1 * np.arange(300)}
    problem, result = fitted("y = C(x)", {"C": CURVE}, data, smoothness=1.0)
    series = trial_series(problem, ["y"], ["lag", "delay"])
    scores, _ = scores_of(problem, (), series=series)
    lag = next(score for score in scores.values() if score.term.kind == "lag")
    y = kf.simulate("y = C(x)", data, problem.parameters)["y"].values
    lagged = kf.simulate(f"z = PT1(y, {lag.term.seconds!r})", {"time": data["time"], "y": y}, {})["z"].values
    extended = data | {"u": lagged - y}
    refit = refit_with_column(extended)
    assert lag.gain == pytest.approx(result.cost_after - refit.cost_after, rel=1e-8)
    delay = next(score for score in scores.values() if score.term.kind == "delay")
    later = np.concatenate([np.full(delay.term.steps, y[0]), y[: -delay.term.steps]])
    extended = data | {"u": later - y}
    refit = refit_with_column(extended)
    assert delay.gain == pytest.approx(result.cost_after - refit.cost_after, rel=1e-8)
    # a delay has no size that could be fitted
    whole = kf.calibrate("y = C(x) + u", extended, {"C": CURVE}, "m", smoothness={"C": 1.0}, options=EXACT)
    assert delay.whole == pytest.approx(result.cost_after - whole.cost_after, rel=1e-8)


def test_columns_that_the_function_can_produce_itself_are_skipped():
    data = columns()
    curve = kf.Curve("C", [-2.0, -1.0, 0.0, 1.0, 2.0], np.zeros(5))
    problem, _ = fitted("y = C(x)", {"C": curve}, data)
    scores, _ = scores_of(problem)
    assert ("y", "add", "x") not in scores
    assert ("y", "add", "z") in scores


def test_a_term_without_a_node_is_refused():
    model = kf.formula("y = k * x", parameters=["k"])
    with pytest.raises(kf.ArgumentError, match="no node nothing"):
        extended_model(model, MissingTerm("nothing", "add", "z", (0.0, 1.0)), "New")


def test_a_level_with_slow_errors_makes_no_fast_channel_significant():
    rng = np.random.default_rng(0)
    count = 6000
    slow = np.cumsum(rng.normal(size=count)) * 0.02
    u = 2 + np.sin(np.arange(count) / 300)
    data = {name: rng.normal(size=count) for name in ("x", "z", "w")} | {"u": u, "time": 0.1 * np.arange(count)}
    # a constant at y is not what k can produce: its errors have few degrees of freedom
    problem, _ = fitted("y = k * u", {"k": 1.0}, data | {"m": 3 * u + slow + 0.01 * rng.normal(size=count)})
    scored = score_problem(problem, Channels(tuple(AXES), {}), Nodes.of(problem), ["add"])
    assert min(score.p for score in scored.scores) > 1e-4
