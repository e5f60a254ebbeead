import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.surrogate import Validity


@pytest.mark.parametrize(("count", "inputs"), [(30, 1), (60, 2), (2000, 2), (6000, 6)])
def test_other_points_of_the_same_kind_are_inside_and_far_ones_outside(count, inputs):
    rng = np.random.default_rng(0)
    validity = Validity.around(rng.uniform(-1, 1, (count, inputs)), np.full(inputs, 0.5))
    assert validity.outside(rng.uniform(-1, 1, (500, inputs))).mean() < 0.06
    assert validity.outside(rng.uniform(-1, 1, (500, inputs)) + 4).all()


def test_a_hole_in_the_data_is_outside():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (3000, 2))
    x = x[np.hypot(*x.T) > 0.6]
    validity = Validity.around(x, np.full(2, 0.3))
    assert validity.outside(np.zeros(2))
    assert not validity.outside(np.array([0.8, 0.0]))


def test_inputs_that_move_together_are_outside_where_they_do_not():
    together = np.random.default_rng(0).uniform(0, 10, 500)
    validity = Validity.around(
        np.column_stack([together, together + 0.1 * np.sin(9 * together)]), np.array([50.0, 50.0])
    )
    assert not validity.outside(np.array([5.0, 5.0]))
    assert validity.outside(np.array([1.0, 9.0]))


def test_a_missing_value_is_outside():
    validity = Validity.around(np.random.default_rng(0).normal(size=(50, 2)), np.ones(2))
    assert validity.outside(np.array([np.nan, 0.0]))
    assert validity.outside(np.array([np.inf, 0.0]))


def test_the_measure_is_the_deviation_that_a_process_keeps():
    rng = np.random.default_rng(0)
    z, x = rng.normal(size=(6, 2)), rng.normal(size=(4, 2))
    validity = Validity(z, np.array([1.0, 2.0]), 0.5, z.min(0), z.max(0))
    near = np.exp(-0.5 * np.sum(((x[:, None] - z) / [1, 2]) ** 2, axis=2))
    inner = np.exp(-0.5 * np.sum(((z[:, None] - z) / [1, 2]) ** 2, axis=2)) + 1e-3 * np.eye(6)
    expected = np.sqrt(1 - np.einsum("ij,ji->i", near, np.linalg.solve(inner, near.T)))
    np.testing.assert_allclose(validity.distance(x), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"centres": np.zeros(3)}, r"centres of a validity range have shape \(3,\)"),
        ({"lengths": np.ones(3)}, "lengths of a validity range must be one number per input, 2"),
        ({"lengths": np.zeros(2)}, "must be > 0, the smallest is 0"),
        ({"threshold": 0.0}, "threshold=0.0 of a validity range"),
    ],
)
def test_numbers_that_contradict_each_other_are_named(change, message):
    good = {"centres": np.eye(2), "lengths": np.ones(2), "threshold": 0.5, "least": np.zeros(2), "most": np.ones(2)}
    with pytest.raises(ArgumentError, match=message):
        Validity(**(good | change))
