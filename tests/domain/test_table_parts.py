"""Ranges of axis values contain the breakpoints at their ends, whatever rounding has made of these."""

import numpy as np
import pytest

from kennfeld import Axis, Curve, Map
from kennfeld.domain.table_parts import grid_points_within


def within(points, first, last):
    return grid_points_within(Curve("C", points, np.zeros(len(points))), {"x": (first, last)}).tolist()


@pytest.mark.parametrize(
    "points",
    [[0.1, 0.2, 0.1 + 0.2, 0.4], np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32), [0.1, 0.2, 0.3 * (1 - 1e-15), 0.4]],
)
def test_a_breakpoint_that_differs_from_an_end_by_rounding_is_within(points):
    assert within(points, 0.2, 0.3) == [False, True, True, False]
    assert within(points, 0.3, 0.3) == [False, False, True, False]
    assert within(points, 0.3, np.inf) == [False, False, True, True]


def test_a_breakpoint_beyond_an_end_is_not():
    assert within([0.0, 1.0, 1.0 + 1e-9, 2.0], 0.0, 1.0) == [True, True, False, False]
    assert within([1e9, 1e9 + 1, 1e9 + 2], 1e9, 1e9 + 1) == [True, True, False]
    assert within([5.0], 5.1, 6.0) == [False]


def test_ranges_along_several_axes_are_all_met():
    table = Map("M", Axis([0, 1, 2]), Axis([0, 10]), np.zeros((3, 2)))
    assert grid_points_within(table, {"x": (1, 2), "y": (10, 10)}).tolist() == [
        [False, False],
        [False, True],
        [False, True],
    ]
