"""A chain of lookups with creases, on which the plain descent stops early."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings
from kennfeld.optimize.strategies.smoothing_continuation import LONG_SCHEDULE, SHORT_SCHEDULE, Continuation
from kennfeld.optimize.sums import compiled as compilation
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.project.demo import torque
from tests.draws import mostly_slow

TEXT = "delta = Opt(u, v) - w\nm = M(u, v) * Eta(delta)"
GRID = np.linspace(0, 1, 6)
DELTA = np.linspace(-3, 3, 13)


def chain(opt, eta, size):
    return kf.ParameterSet([kf.Map("Opt", GRID, GRID, opt), kf.Curve("Eta", DELTA, eta), kf.Map("M", GRID, GRID, size)])


def problem(samples=600, seed=0):
    random = np.random.default_rng(seed)
    columns = {"u": random.random(samples), "v": random.random(samples), "w": random.uniform(-2, 2, samples)}
    truth = chain(np.add.outer(GRID, -(GRID**2)), np.cos(DELTA / 2), 50 + 30 * np.multiply.outer(GRID, GRID))
    y = kf.simulate(TEXT, columns, truth)["m"].values + 0.5 * random.standard_normal(samples)
    return columns | {"y": y}, chain(np.zeros((6, 6)), np.linspace(1.0, 0.9, 13), np.full((6, 6), 40.0))


def calibrated(**arguments):
    data, start = problem()
    return kf.calibrate(TEXT, data, start, target="y", node="m", smoothness=1e-3, **arguments)


@pytest.fixture(scope="module")
def both():
    return calibrated()


@pytest.fixture(scope="module")
def plain():
    return calibrated(options=kf.Options(continuation="off"))


def stages(result):
    """Each stage that the trace went through, with the cost at its end."""
    ends = []
    for line in result.trace:
        if not ends or ends[-1][0] != line.stage:
            ends.append((line.stage, line.cost))
        ends[-1] = (line.stage, line.cost)
    return ends


def widths(names):
    return [float(name.split()[1]) for name in names if name.startswith("smooth")]


@pytest.mark.parametrize(("continuation", "most", "highest"), [("auto", 170, 8695.0), ("off", 85, 8720.0)])
def test_the_torque_bench_takes_few_evaluations(continuation, most, highest):
    """Notice stages that cost much and gain little: unlike seconds, evaluations do not depend on the load."""
    result = kf.calibrate(
        torque.FORMULA,
        torque.bench(),
        torque.start(),
        target="Torque",
        node="TorquePredict",
        smoothness=torque.SMOOTHNESS,
        pins=[kf.Pin(*torque.PIN)],
        options=kf.Options(continuation=continuation),
    )
    assert result.converged
    assert not result.warnings
    assert result.cost_after < highest
    assert result.evaluations < most
    if continuation == "auto":
        # within 0.1 % of the lowest cost known once the first lookups are sharp
        steps = [line.stage for line in result.trace if not line.stage.startswith("smooth") and line.cost < 8699.4]
        before = next(number for number, line in enumerate(result.trace) if line.stage == steps[0])
        assert steps[0] == "exact"
        assert before < 35


@pytest.mark.slow
def test_both_schedules_are_tried_if_creases_matter(both):
    names = [name for name, _ in stages(both)]
    plain = names.index("plain")
    assert names[plain - 1] == "exact"
    assert names[-1] == "final"
    final = names.index("final")
    again = names[final : final + 1 + names[final + 1 :].index("final")]  # from the best end
    for part, ladder in (
        (names[:plain], SHORT_SCHEDULE),
        (names[plain:final], LONG_SCHEDULE),
        (again, SHORT_SCHEDULE),
    ):
        assert widths(part) == sorted(widths(part), reverse=True)
        assert set(widths(part)) <= set(ladder.widths)


def test_the_long_schedule_is_omitted_if_the_short_one_and_the_plain_descent_agree():
    data, _ = problem()
    smooth = kf.Curve("Eta", DELTA, np.cos(DELTA / 2))
    start = chain(np.zeros((6, 6)), smooth.values, np.full((6, 6), 40.0))
    fixed = kf.calibrate(TEXT, data, start, target="y", node="m", smoothness=10.0, free=["M", "Opt"])
    names = [name for name, _ in stages(fixed)]
    assert names[names.index("plain") - 1] == "exact"
    assert max(widths(names)) == max(SHORT_SCHEDULE.widths)


def test_the_end_with_the_lowest_cost_is_returned(both):
    ends = stages(both)
    assert both.cost_after == min(cost for name, cost in ends if name == "final")
    assert both.cost_after <= min(cost for name, cost in ends if name in ("plain", "exact"))


def test_the_plain_descent_runs_alone_if_the_continuation_is_off(plain):
    assert {line.stage for line in plain.trace} == {"plain"}
    [warning] = plain.warnings
    assert "no step reaches it" in warning.message
    assert warning.remedy == 'Search with continuation = "auto": it crosses kinks of lookups.'


def test_the_continuation_overcomes_creases_that_stop_the_plain_descent(both, plain):
    assert both.cost_after < 0.97 * plain.cost_after


def test_the_reported_cost_is_that_of_the_exact_function(both):
    squares = both.quality[0].samples * both.quality[0].rmse_after ** 2
    assert squares <= both.cost_after <= 1.2 * squares


def test_a_function_without_creases_to_smooth_has_one_descent():
    result = kf.calibrate(
        "m = C(x)", {"x": [0.0, 1, 2], "y": [1.0, 2, 1]}, kf.ParameterSet([kf.Curve("C", [0, 1, 2], np.zeros(3))]), "y"
    )
    assert {line.stage for line in result.trace} == {"plain"}


@pytest.mark.parametrize(
    "stage",
    mostly_slow(["smooth 1", "smooth 0.25", "plain", "smooth 4", "exact", "final"], ["smooth 0.25", "plain", "exact"]),
)
def test_a_stop_during_the_continuation_keeps_the_better_values(stage):
    def stop(line):
        if line.stage == stage:
            raise kf.Stop

    result = calibrated(progress=stop)
    assert result.status == "stopped"
    known = [line.cost for line in result.trace if line.stage in ("plain", "exact", "final")]
    assert result.cost_after <= min([result.cost_before, *known])
    data, _ = problem()
    again = kf.calibrate(
        TEXT,
        data,
        result.parameters,
        target="y",
        node="m",
        smoothness=1e-3,
        options=kf.Options(max_iterations=0, continuation="off"),
    )
    assert again.cost_after == pytest.approx(result.cost_after, rel=1e-12)


def test_bounds_hold_at_the_end_of_the_continuation():
    data, start = problem()
    bounded = start.with_parameters(start["Opt"].with_bounds(-0.2, 0.25), start["Eta"].with_bounds(0.3, 1.0))
    result = kf.calibrate(TEXT, data, bounded, target="y", node="m", pins=[kf.Pin("Eta", (0.1,), 0.95)])
    assert np.all((result.parameters["Opt"].values >= -0.2) & (result.parameters["Opt"].values <= 0.25))
    assert np.all(result.parameters["Eta"].values <= 1.0)
    assert np.interp(0.1, DELTA, result.parameters["Eta"].values) == pytest.approx(0.95, rel=1e-9)


@pytest.fixture
def few_search_samples(monkeypatch):
    monkeypatch.setattr(compilation, "SEARCH_SAMPLES", 2000)
    return compilation.SEARCH_SAMPLES


@pytest.mark.slow
def test_many_samples_are_thinned_except_at_the_end_of_the_search(few_search_samples):
    data, start = problem(samples=2 * few_search_samples)
    result = kf.calibrate(TEXT, data, start, target="y", node="m", smoothness=1e-3)
    assert result.converged
    squares = result.quality[0].samples * result.quality[0].rmse_after ** 2
    assert result.quality[0].samples == 2 * few_search_samples
    assert squares <= result.cost_after <= 1.01 * squares
    searched = [line.cost for line in result.trace if line.stage in ("exact", "plain")]
    assert min(searched) == pytest.approx(result.cost_after, rel=0.05)  # with the weight of all samples


@pytest.mark.parametrize("stage", ["smooth 1", "plain"])
def test_a_search_stopped_on_thinned_samples_has_the_cost_of_all_samples(stage, few_search_samples):
    data, start = problem(samples=2 * few_search_samples)

    def stop(line):
        if line.stage == stage:
            raise kf.Stop

    result = kf.calibrate(TEXT, data, start, target="y", node="m", progress=stop)
    assert result.status == "stopped"
    squares = result.quality[0].samples * result.quality[0].rmse_after ** 2
    assert result.cost_after == pytest.approx(squares, rel=1e-9)
    assert result.cost_after < result.cost_before


@pytest.mark.parametrize("text", mostly_slow(["y = PT1(G(u) * k, T)", "y = PT1(G(k * u), T)"], 1))
def test_a_search_of_a_model_with_memory_begins_with_some_recordings(text, monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.sums.compiled.SEARCH_PIECE_SAMPLES", 1000)
    rng, truth = np.random.default_rng(1), {"k": 2.0, "T": 0.5}
    curve = kf.Curve("G", np.linspace(-3.0, 3.0, 7), np.linspace(-1.0, 2.0, 7) ** 3)
    drives = []
    for number in range(40):
        u = np.repeat(rng.uniform(-1.0, 1.0, 20), 10)
        drive = kf.Dataset.of(f"drive {number}", {"u": u}, time=0.1 * np.arange(u.size))
        simulated = kf.simulate(text, drive, truth | {"G": curve})["y"].values
        drives.append(drive.with_channels(kf.Channel("m", simulated + rng.normal(0.0, 0.01, u.size))))
    start = kf.ParameterSet([curve, kf.Scalar("k", 1.0), kf.Scalar("T", 2.0)])
    result = kf.calibrate(text, drives, start, "m", free=["k", "T"])
    costs = {line.stage: line.cost for line in result.trace}
    assert result.converged
    assert result.trace[-1].stage == "final"
    assert costs["plain"] == pytest.approx(costs["final"], rel=0.3)  # with the weight of all samples
    assert result.cost_after == pytest.approx(40 * 200 * 0.01**2, rel=0.05)
    assert result.parameters["k"].value == pytest.approx(2.0, rel=0.01)
    assert result.parameters["T"].value == pytest.approx(0.5, rel=0.02)


@pytest.mark.slow
def test_a_search_is_abandoned_if_an_earlier_one_was_as_good():
    data, start = problem()
    compiled = CompiledProblem(ProblemSetup(TEXT, data, start, "y", node="m", smoothness=1e-3).problem())
    continuation, limits = Continuation.of(compiled), linear_limits(compiled.problem, compiled.values)
    begin, settings = compiled.start[: compiled.values.free], SolverSettings(tolerance=1e-3)
    lines = []

    def search(earlier):
        lines.clear()
        return continuation.descend(
            SHORT_SCHEDULE, begin, limits, settings, lambda stage, *_: lines.append(stage), earlier
        )

    first, costs = search(None)
    assert list(costs) == list(SHORT_SCHEDULE.widths)
    again, _ = search(costs)
    assert again.cost == np.inf
    assert set(lines) == {"smooth 1"}
    better, _ = search({width: 1.01 * cost for width, cost in costs.items()})
    assert better.cost == first.cost
