from itertools import combinations

import numpy as np
import pytest

from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.strategies.breakpoint_placement import DenseAxis, eliminate_breakpoints


def least(matrix, values, points, indices, lines):
    """Cost and values of the best fit that is straight between the kept points, by another way: as a regression."""
    weights, _ = cell_weights(position(points, points[indices], "clip"), len(indices))
    spread = np.kron(weights, np.eye(lines))
    best = np.linalg.solve(spread.T @ matrix @ spread, spread.T @ matrix @ values)
    rest = spread @ best - values
    return rest @ matrix @ rest, spread @ best


def problem(seed, count, lines):
    random = np.random.default_rng(seed)
    root = random.standard_normal((count * lines, count * lines))
    points = np.cumsum(random.uniform(0.3, 1.0, count))
    return root @ root.T + np.eye(count * lines), random.standard_normal(count * lines), points


@pytest.mark.parametrize("lines", [1, 3])
@pytest.mark.parametrize("seed", range(5))
def test_the_cheapest_breakpoint_is_removed_first(seed, lines):
    matrix, values, points = problem(seed, 6, lines)
    axis = DenseAxis(points, np.arange(6 * lines).reshape(6, lines), np.arange(6) % 5 == 0, 5)
    (remaining,), fitted = eliminate_breakpoints([axis], values, np.linalg.inv(matrix))
    costs = {gone: least(matrix, values, points, np.delete(np.arange(6), gone), lines)[0] for gone in range(1, 5)}
    assert set(range(6)) - set(remaining.tolist()) == {min(costs, key=costs.get)}
    np.testing.assert_allclose(fitted, least(matrix, values, points, remaining, lines)[1], atol=1e-7)


def test_values_are_optimal_for_any_number_of_removed_breakpoints():
    matrix, values, points = problem(1, 12, 2)
    axis = DenseAxis(points, np.arange(24).reshape(12, 2), np.arange(12) % 11 == 0, 4)
    (remaining,), fitted = eliminate_breakpoints([axis], values, np.linalg.inv(matrix))
    assert len(remaining) == 4
    np.testing.assert_allclose(fitted, least(matrix, values, points, remaining, 2)[1], atol=1e-6)


def test_breakpoints_at_kinks_remain():
    points = np.linspace(0, 10, 41)
    values = np.interp(points, [0, 1.25, 2.0, 6.5, 10], [0, 4, 1, 2, 8])
    stays = np.isin(points, [0, 10])
    (remaining,), _ = eliminate_breakpoints([DenseAxis(points, np.arange(41)[:, None], stays, 5)], values, np.eye(41))
    assert points[remaining].tolist() == [0, 1.25, 2.0, 6.5, 10]


def test_elimination_is_rarely_far_from_the_best_choice():
    ratios = []
    for seed in range(10):
        random = np.random.default_rng(seed)
        points, values = np.arange(10.0), np.cumsum(random.standard_normal(10))
        axis = DenseAxis(points, np.arange(10)[:, None], np.arange(10) % 9 == 0, 5)
        (remaining,), _ = eliminate_breakpoints([axis], values, np.eye(10))
        best = min(least(np.eye(10), values, points, [0, *inner, 9], 1)[0] for inner in combinations(range(1, 9), 3))
        ratios.append(least(np.eye(10), values, points, remaining, 1)[0] / best)
    assert np.median(ratios) < 1.2


def test_required_breakpoints_are_not_removed():
    stays = np.array([True, False, True, False, True])
    axis = DenseAxis(np.arange(5.0), np.arange(5)[:, None], stays, 4)
    (remaining,), _ = eliminate_breakpoints([axis], np.array([0.0, 5.0, 2.0, -5.0, 4.0]), np.eye(5))
    assert set(remaining.tolist()) > {0, 2, 4}


def test_locked_values_do_not_move():
    inverse = np.diag([0.0, 1.0, 1.0, 0.0])
    (remaining,), fitted = eliminate_breakpoints(
        [DenseAxis(np.arange(4.0), np.arange(4)[:, None], np.array([True, False, False, True]), 2)],
        np.array([0.0, 1.0, 5.0, 3.0]),
        inverse,
    )
    assert remaining.tolist() == [0, 3]
    np.testing.assert_allclose(fitted, [0, 1, 2, 3], atol=1e-9)


def test_two_axes_are_thinned_out_together():
    matrix, values, points = problem(3, 16, 1)
    grid = np.arange(16).reshape(4, 4)
    ends = np.array([True, False, False, True])
    axes = [DenseAxis(points[:4], grid, ends, 3), DenseAxis(points[:4], grid.T, ends, 3)]
    remaining, fitted = eliminate_breakpoints(axes, values, np.linalg.inv(matrix))
    assert [len(indices) for indices in remaining] == [3, 3]
    for indices, table in zip(remaining, (fitted.reshape(4, 4), fitted.reshape(4, 4).T), strict=True):
        for line in table.T:
            np.testing.assert_allclose(line, np.interp(points[:4], points[indices], line[indices]), atol=1e-7)
