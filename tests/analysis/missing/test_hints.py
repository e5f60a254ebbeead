"""Lines after a calibration."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.missing import hints as module
from kennfeld.analysis.missing.excerpt import excerpt
from kennfeld.analysis.missing.hints import FEWEST, Hints, affordable_samples, hints
from kennfeld.optimize.fit.result import Seconds
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.multistart import run

CURVE = kf.Curve("C", np.linspace(0, 1, 9), np.zeros(9))


def fitted(text, start, samples=400, *, timed=False, **options):
    rng = np.random.default_rng(0)
    x, z = rng.uniform(0, 1, (2, samples))
    data = {"x": x, "z": z, "m": np.exp(2 * x) + z**2 + 0.02 * rng.normal(size=samples)}
    data |= {"time": 0.1 * np.arange(samples)} if timed else {}
    problem = ProblemSetup(text, data, start, "m", smoothness={"C": 0.1} if "C(" in text else {}).problem()
    return problem, run(problem, Options(**options))


def test_scores_take_a_tenth_of_the_time_or_what_is_always_allowed():
    # 20 evaluations of 1 s would take 20 s, of which 8 are left
    assert affordable_samples(Seconds(100.0, 0.0, 1.0, 90.0), 90, 1_000_000, 2.0) == pytest.approx(400_000, abs=1)
    assert affordable_samples(Seconds(100.0, 0.0, 1.0, 90.0), 90, 1_000_000, 11.0) == 0
    # a short calibration waits for few samples, but not for a large function
    assert affordable_samples(Seconds(1.0, 0.0, 0.2, 0.7), 9, 1_000_000, 0.1) == FEWEST
    assert affordable_samples(Seconds(1.0, 0.0, 0.2, 0.7), 9, 1_000_000, 0.4) == 0
    assert affordable_samples(Seconds(1.0, 0.0, 0.0, 0.0), 0, 100, 0.0) >= 100


def test_a_calibration_says_what_the_best_term_would_take():
    problem, result = fitted("y = exp(a * x) + z", {"a": 1.0})
    [line] = hints(problem, result).lines()
    assert "a curve of z" in line
    assert line.endswith("off the cost; see kennfeld propose.")


def test_a_function_that_lacks_nothing_gets_a_line_as_well():
    problem, result = fitted("y = exp(a * x) + C(z)", {"a": 1.0, "C": CURVE})
    [line] = hints(problem, result).lines()
    assert line.startswith("No lag, and no curve of a channel that the function reads, would take 1% off the cost;")


def test_a_search_that_stopped_early_says_what_it_left(monkeypatch):
    monkeypatch.setattr(module, "affordable_samples", lambda *_: 0)
    problem, result = fitted("y = exp(a * x) + b * z", {"a": 0.1, "b": 5.0}, max_iterations=1)
    [line] = hints(problem, result).lines()
    assert line.endswith("% of the cost is still to be had from the values themselves.")


@pytest.mark.parametrize("timed", [False, True], ids=["steady", "in time"])
def test_an_excerpt_of_large_data_gives_about_the_same_share(monkeypatch, timed):
    problem, result = fitted("y = C(x) + k", {"k": 0.0, "C": CURVE}, 9000, timed=timed)
    whole = hints(problem, result)
    monkeypatch.setattr(module, "affordable_samples", lambda *_: 2700)
    part = hints(problem, result)
    assert part.best == whole.best
    assert part.share == pytest.approx(whole.share, abs=0.02)


def test_an_excerpt_keeps_the_balance_of_data_and_smoothness():
    problem, _ = fitted("y = C(x) + k", {"k": 0.0, "C": CURVE}, 1000)
    [data] = problem.fitted_datasets
    part = excerpt(replace(problem, datasets=(replace(data, piece_starts=np.array([0, 600])),)), 0.25)
    [kept] = part.fitted_datasets
    assert (kept.samples, kept.piece_starts.tolist()) == (250, [0, 150])
    np.testing.assert_array_equal(kept["x"].values[:3], data["x"].values[[0, 4, 8]])
    assert part.factors("C") == (0.025,)


def test_hints_are_read_as_they_were_written():
    known = Hints(0.125, scored=True, best="Add a curve of z to y", share=0.5)
    assert Hints.from_json(known.as_json()) == known
    assert Hints.from_json({"scored": 1}) is Hints.from_json(None) is None
