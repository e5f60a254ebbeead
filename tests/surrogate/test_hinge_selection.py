import numpy as np
import pytest

from kennfeld.domain.rbf import evaluate_hinges
from kennfeld.surrogate.hinge_selection import select_hinges
from kennfeld.surrogate.training_points import TrainingPoints


def groups(count, parts=5):
    return np.array_split(np.random.default_rng(0).permutation(count), parts)


def test_kinks_are_identified_near_their_place_with_their_height():
    x = np.random.default_rng(0).normal(size=(400, 2))
    y = 0.5 * x[:, 0] + 2 * np.maximum(x[:, 1] - 0.4, 0)
    choice = select_hinges(TrainingPoints.of(x, y), groups(400))
    heights = [hinge.height for hinge in choice.hinges if hinge.input == 1]
    assert {hinge.input for hinge in choice.hinges} >= {1}
    assert sum(heights) == pytest.approx(2, abs=0.05)
    assert np.sqrt(np.mean(choice.left_out**2)) < 0.05


def test_residuals_left_out_do_not_depend_on_the_values_left_out():
    x = np.random.default_rng(0).normal(size=(100, 2))
    y = np.maximum(x[:, 1], 0) + 0.1 * np.random.default_rng(1).normal(size=100)
    parts = groups(100)
    first = select_hinges(TrainingPoints.of(x, y), parts)
    changed = y.copy()
    changed[parts[0]] += 0.01
    second = select_hinges(TrainingPoints.of(x, changed), parts)
    assert len(first.hinges) == len(second.hinges)
    np.testing.assert_allclose(second.left_out[parts[0]] - first.left_out[parts[0]], 0.01, atol=1e-12)


def test_two_levels_have_no_place_for_a_kink_beyond_the_plane():
    x = np.random.default_rng(0).integers(2, size=(60, 1)).astype(float)
    choice = select_hinges(TrainingPoints.of(x + np.arange(60)[:, None] * 1e-9, x[:, 0]), groups(60))
    assert np.abs(evaluate_hinges(choice.hinges, x)).max(initial=0.0) < 1e-6


def test_no_hinges_are_worth_0():
    np.testing.assert_array_equal(evaluate_hinges((), np.ones((3, 2))), np.zeros(3))
