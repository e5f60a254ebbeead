import numpy as np

from kennfeld.importers.fmu.evaluation_code import DIFFERENCES, DIRECTIONAL, SKIPPED
from kennfeld.importers.fmu.slope_selection import agreeing_columns


def test_derivatives_that_are_right_at_the_start_alone_do_not_agree():
    kinds = np.array([SKIPPED, DIFFERENCES, DIFFERENCES])  # along the time, x and y
    start, magnitudes = np.array([0.0, 1.0, 1.0]), np.array([1.0, 1.0, 10.0])
    points = []

    def evaluate(point):
        """Return x^2 + y with slopes; the directional derivative along x is that at the start."""
        points.append(point)
        _, x, y = point
        along_x = 2 * start[1] if kinds[1] == DIRECTIONAL else 2 * x
        return np.array([x**2 + y]), np.array([[0.0, along_x, 1.0]])

    assert agreeing_columns(evaluate, kinds, start, magnitudes) == [2]
    assert kinds.tolist() == [SKIPPED, DIFFERENCES, DIFFERENCES]
    assert {point[0] for point in points} == {0.0}
