import numpy as np
import pytest
from scipy.sparse import csr_array

from kennfeld.optimize.rounding.joint_rounding import round_values
from kennfeld.optimize.rounding.lattice import PULL, violated_rows
from tests.optimize.rounding.lattices import correlated, cost_of, lattice_of, least_cost


@pytest.mark.parametrize("seed", range(25))
def test_six_values_are_rounded_as_well_as_by_trying_all(seed):
    rng = np.random.default_rng(seed)
    lattice, matrix = lattice_of(3 * rng.normal(size=6)), correlated(rng, 6)
    pulled = lattice.pulled(matrix)
    joint = round_values(lattice, matrix).joint[0]
    assert cost_of(lattice, pulled, joint) == pytest.approx(least_cost(lattice, pulled), rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_six_rising_values_are_rounded_as_well_as_by_trying_all_that_rise(seed):
    rng = np.random.default_rng(seed)
    rises = np.diff(np.eye(6), axis=0)
    centre = np.cumsum(rng.exponential(0.6, size=6))
    lattice = lattice_of(centre, (rises, np.zeros(5), np.full(5, 2.0)))
    matrix = correlated(rng, 6)
    pulled = lattice.pulled(matrix)
    joint = round_values(lattice, matrix).joint[0]
    assert not violated_rows(lattice, joint).any()
    assert cost_of(lattice, pulled, joint) == pytest.approx(least_cost(lattice, pulled), rel=1e-9)


def test_a_large_table_loses_less_than_by_nearest_within_the_shift_and_always_the_same():
    rng = np.random.default_rng(0)
    lattice, matrix = lattice_of(20 * rng.normal(size=400)), correlated(rng, 400)
    rounded, again = round_values(lattice, matrix), round_values(lattice, matrix)
    joint = rounded.joint[0]
    assert cost_of(lattice, matrix, joint) < 0.6 * cost_of(lattice, matrix, rounded.nearest)
    assert np.abs(joint - lattice.centre).max() <= 2.0
    np.testing.assert_array_equal(joint, again.joint[0])


def test_values_without_information_are_rounded_to_the_nearest():
    rng = np.random.default_rng(1)
    known = np.zeros((8, 8))
    known[:5, :5] = correlated(rng, 5).toarray()
    lattice = lattice_of(5 * rng.normal(size=8))
    joint = round_values(lattice, csr_array(known)).joint[0]
    np.testing.assert_array_equal(joint[5:], np.rint(lattice.centre[5:]))
    nothing = round_values(lattice, csr_array((8, 8)))
    np.testing.assert_array_equal(nothing.joint[0], np.rint(lattice.centre))


def test_the_pull_keeps_a_value_that_the_data_hardly_see_near_the_fit():
    # the second value could make up for the first one, if it moved by 50 steps
    strong, weak = 1.0, 0.01
    root = np.array([[strong, weak]])
    lattice = lattice_of(np.array([0.5, 0.0]), max_shift=60.0)
    joint = round_values(lattice, csr_array(root.T @ root)).joint[0]
    assert weak < PULL
    assert abs(joint[1]) <= 1


def test_values_whose_limits_no_storable_numbers_keep_are_left_out_and_the_others_rounded():
    # a slope between 0.3 and 0.6 steps has no whole number
    centre = np.array([0.2, 0.6, 7.4, 3.3])
    lattice = lattice_of(centre, (np.array([[-1.0, 1.0, 0.0, 0.0]]), np.array([0.3]), np.array([0.6])))
    rounded = round_values(lattice, csr_array(np.eye(4)))
    np.testing.assert_array_equal(rounded.impossible, [True, True, False, False])
    np.testing.assert_array_equal(rounded.lattice.places, [2, 3])
    np.testing.assert_array_equal(rounded.nearest, [7.0, 3.0])


def test_no_value_is_rounded_if_there_is_none():
    assert round_values(lattice_of(np.zeros(0)), csr_array((0, 0))).joint[0].size == 0
