import numpy as np
import pytest

from kennfeld.optimize.rounding.lattice import violated_rows
from kennfeld.optimize.rounding.repair import repair
from tests.optimize.rounding.lattices import lattice_of

RISING = np.diff(np.eye(5), axis=0)


def test_only_values_around_a_violated_row_move_and_as_little_as_possible():
    centre = np.array([0.0, 1.4, 1.6, 2.0, 9.0])
    lattice = lattice_of(centre, (RISING, np.zeros(4), np.full(4, np.inf)))
    repaired = repair(lattice, np.array([0.0, 3.0, 2.0, 2.0, 9.0]), np.ones(5))
    assert not violated_rows(lattice, repaired.numbers).any()
    assert np.abs(repaired.numbers - [0, 3, 2, 2, 9]).sum() == 1
    assert not repaired.impossible.any()


def test_the_value_with_the_smaller_weight_moves():
    lattice = lattice_of(np.array([1.4, 1.2]), (np.array([[-1.0, 1.0]]), np.zeros(1), np.full(1, np.inf)))
    weights = np.array([1.0, 5.0])
    np.testing.assert_array_equal(repair(lattice, np.array([2.0, 1.0]), weights).numbers, [1.0, 1.0])
    np.testing.assert_array_equal(repair(lattice, np.array([2.0, 1.0]), weights[::-1].copy()).numbers, [2.0, 2.0])


def test_a_violation_that_only_distant_values_can_mend_is_repaired():
    # rising by at least one step each, from numbers that leave no room near the violation
    lattice = lattice_of(np.arange(30.0), (np.diff(np.eye(30), axis=0), np.ones(29), np.full(29, np.inf)))
    target = np.arange(30.0)
    target[15:] -= 1
    repaired = repair(lattice, target, np.ones(30))
    assert not repaired.impossible.any()
    assert not violated_rows(lattice, repaired.numbers).any()


@pytest.mark.parametrize("centre", [np.zeros(3), np.array([0.4, 0.4, 0.4])])
def test_numbers_that_keep_all_rows_stay(centre):
    rows = (np.diff(np.eye(3), axis=0), np.zeros(2), np.full(2, np.inf))
    repaired = repair(lattice_of(centre, rows), np.rint(centre), np.ones(3))
    np.testing.assert_array_equal(repaired.numbers, np.rint(centre))
