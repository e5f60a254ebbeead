"""The factors that a fit proposes next."""

from types import SimpleNamespace

import numpy as np
import pytest

from kennfeld.optimize.solver.levenberg_marquardt import SolverResult
from kennfeld.optimize.tuning.smoothness import RANGE, Round

FIT = SolverResult(np.zeros(1), 0.0, "converged", "", 0, 0)
MIDDLE = np.array([2.0, -1.0])


def at_levels(function, logarithms=(1.0, 3.0, -np.inf)):
    """A fit whose criterion is a function of the levels; no data reach the third table."""
    prediction = SimpleNamespace(at=lambda live: SimpleNamespace(value=function(live - MIDDLE)))
    return Round(np.array(logarithms), FIT, 0.0, prediction, np.array([True, True, False]), MIDDLE)


def test_the_lowest_level_is_raised_and_a_higher_one_stays():
    raised, rise = at_levels(lambda levels: levels[0]).raise_lowest(allowed=3.0, stride=100.0)
    assert rise == pytest.approx(4.0, abs=0.25)
    assert raised == pytest.approx([5.0, 3.0, -np.inf], abs=0.25)


def test_levels_rise_together_once_they_are_equal():
    raised, _ = at_levels(lambda levels: levels.sum()).raise_lowest(allowed=20.0, stride=100.0)
    assert raised[:2] - MIDDLE == pytest.approx([10.0, 10.0], abs=0.25)
    assert raised[2] == -np.inf


def test_no_step_is_longer_than_the_stride_nor_leads_out_of_the_range():
    assert at_levels(lambda levels: 0.0).raise_lowest(1.0, 2.5)[1] == pytest.approx(2.5)
    highest, _ = at_levels(lambda levels: 0.0).raise_lowest(1.0, 100.0)
    assert highest[:2] - MIDDLE == pytest.approx(np.full(2, np.log(RANGE)))


def test_nothing_rises_where_the_error_is_at_its_limit():
    raised, rise = at_levels(lambda levels: levels[0]).raise_lowest(allowed=-1.0, stride=10.0)
    assert rise == pytest.approx(0.0, abs=0.25)
    assert raised[1] == 3.0


def test_a_fit_that_was_cut_short_proposes_itself():
    raised, rise = Round(np.array([1.0]), FIT).raise_lowest(1.0, 1.0)
    assert (raised.tolist(), rise) == ([1.0], 0.0)
