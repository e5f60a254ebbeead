import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.optimize.search.starts import sobol


def points(count, dimensions, seed=0):
    return np.array([sobol(i, dimensions, seed) for i in range(count)])


def test_the_sequence_is_that_of_scipy_except_for_the_shift():
    from scipy.stats import qmc

    ours = (points(64, 64) * 2**32).astype(np.uint64)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = (qmc.Sobol(64, scramble=False, bits=32).random(64) * 2**32).astype(np.uint64)
    shift = ours[0] ^ theirs[0]
    assert np.array_equal(ours, theirs ^ shift)


@pytest.mark.parametrize("seed", [0, 1, 12345])
def test_the_first_sixteen_points_fall_into_sixteen_different_bins_of_each_dimension(seed):
    bins = np.sort((points(16, 64, seed) * 16).astype(int), axis=0)
    assert np.array_equal(bins, np.tile(np.arange(16)[:, None], 64))


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**31), st.integers(0, 200), st.integers(0, 2**40))
def test_every_point_lies_in_the_cube_and_can_be_drawn_again(index, dimensions, seed):
    point = sobol(index, dimensions, seed)
    assert point.shape == (dimensions,)
    assert np.all((point >= 0) & (point < 1))
    assert np.array_equal(point, sobol(index, dimensions, seed))


def test_seeds_and_indices_give_other_points_also_beyond_the_table():
    for part in (slice(0, 64), slice(64, 100)):
        assert not np.any(sobol(3, 100, 1)[part] == sobol(3, 100, 2)[part])
        assert not np.any(sobol(3, 100, 1)[part] == sobol(4, 100, 1)[part])
