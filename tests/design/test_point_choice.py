from itertools import combinations

import numpy as np
import pytest

from kennfeld.design.point_choice import PointSearch


@pytest.mark.parametrize("seed", range(5))
def test_of_few_candidates_the_best_points_are_chosen_and_their_cost_is_right(seed):
    random = np.random.default_rng(seed)
    half = random.normal(size=(4, 4))
    curvature, rows = half @ half.T + 0.1 * np.eye(4), random.normal(size=(9, 2, 4)) * random.lognormal(size=(9, 1, 1))
    functions = random.normal(size=(2, 4))

    def left(chosen):
        own = rows[list(chosen)].reshape(-1, 4)
        after, before = (
            np.diagonal(functions @ np.linalg.solve(matrix, functions.T))
            for matrix in (curvature + own.T @ own, curvature)
        )
        return np.sqrt(np.mean(after / before))

    choice = PointSearch(curvature, rows, functions).choose(3)
    assert choice.factor == pytest.approx(left(choice.chosen), rel=1e-9)
    assert choice.factor == pytest.approx(min(map(left, combinations(range(9), 3))), rel=1e-9)
