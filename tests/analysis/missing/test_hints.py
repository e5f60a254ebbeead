"""Lines after a calibration."""

from dataclasses import replace

import numpy as np

from kennfeld.analysis.missing.hints import hints, is_affordable
from kennfeld.optimize.fit.result import Seconds
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.multistart import run


def fitted(text, start, **options):
    rng = np.random.default_rng(0)
    x, z = rng.uniform(0, 1, (2, 400))
    data = {"x": x, "z": z, "m": np.exp(2 * x) + z**2 + 0.02 * rng.normal(size=400)}
    problem = ProblemSetup(text, data, start, "m").problem()
    return problem, run(problem, Options(**options))


def test_a_short_calibration_is_not_prolonged():
    _, result = fitted("y = exp(a * x) + z", {"a": 1.0})
    assert not is_affordable(replace(result, seconds=Seconds(1.0, 0.0, 0.2, 0.1), evaluations=10))
    assert is_affordable(replace(result, seconds=Seconds(100.0, 0.0, 0.2, 90.0), evaluations=1000))


def test_a_long_one_says_what_the_best_term_would_take():
    problem, result = fitted("y = exp(a * x) + z", {"a": 1.0})
    long = replace(result, seconds=Seconds(100.0, 0.0, 0.2, 90.0), evaluations=1000)
    [line] = hints(problem, long)
    assert "a curve of z" in line
    assert line.endswith("off the cost; see kennfeld propose.")


def test_a_search_that_stopped_early_says_what_it_left():
    problem, result = fitted("y = exp(a * x) + b * z", {"a": 0.1, "b": 5.0}, max_iterations=1)
    short = replace(result, seconds=Seconds(1.0, 0.0, 0.5, 0.5))
    [line] = hints(problem, short)
    assert line.endswith("% of the cost is still to be had from the values themselves.")
