from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.base.errors import Location
from kennfeld.domain.storage import StorageGrid, StorageRounding, storage_findings


@given(st.integers(-(10**6), 10**6), st.decimals("0.0001", "1000", places=4))
def test_a_multiple_of_a_decimal_step_is_the_double_nearest_to_it(count, step):
    value = StorageGrid.of_step(float(step)).values(np.array([float(count)]))[0]
    assert value == float(Fraction(step) * count)


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan, np.inf, "2"])
def test_a_step_that_is_not_positive_is_refused_with_its_owner(step):
    with pytest.raises(kf.ArgumentError, match=r"step=.* of MapTorque must be a finite number > 0"):
        StorageGrid.of_step(step, "MapTorque")


@given(st.floats(-500, 500), st.floats(0, 300), st.sampled_from([0.75, -0.75, 0.1, 1 / 3]), st.floats(-20, 20))
def test_a_range_of_whole_numbers_has_exactly_the_values_within_bounds(lower, width, factor, shift):
    grid = StorageGrid(factor, shift, 1.0, 0.0, 255.0)
    low, high = grid.range_within(np.array(lower), np.array(lower + width))
    values = grid.values(np.arange(256.0))
    slack = 1e-8 * grid.step
    inside = np.flatnonzero((values >= lower - slack) & (values <= lower + width + slack))
    expected = (inside[0], inside[-1]) if inside.size else None
    assert ((low, high) == expected) if expected else low > high


def test_bounds_are_narrowed_to_the_range_of_the_storage_and_stay_open_where_it_has_no_end():
    table = kf.Curve("C", [0, 1, 2], [1.0, 2.0, 3.0], lower=[-np.inf, 0.3, 200.0], upper=[np.inf, 2.2, 300.0])
    lower, upper = StorageRounding(grids={"C": StorageGrid(-0.5, 100.0, least=0, largest=255)}).bounds(table)
    np.testing.assert_array_equal(lower, [-27.5, 0.3, 200.0])
    np.testing.assert_array_equal(upper, [100.0, 2.2, 300.0])
    lower, upper = StorageRounding(grids={"C": StorageGrid.of_step(0.5)}).bounds(table)
    np.testing.assert_array_equal(upper, [np.inf, 2.2, 300.0])


def test_bounds_without_a_storable_value_and_locked_values_between_steps_are_named():
    tight = kf.Scalar("K", 0.4, lower=0.3, upper=0.45)
    locked = kf.Curve("C", [0, 1], [0.5, 0.7], locked=[False, True])
    free = kf.Scalar("F", 1.0)
    grids = {"K": StorageGrid.of_step(0.5), "C": StorageGrid.of_step(0.5)}
    rounding = StorageRounding(grids=grids, unrounded={"F": "it is stored as FLOAT32_IEEE, which needs no rounding"})
    parameters = kf.ParameterSet([tight, locked, free])
    findings = list(storage_findings(parameters, rounding, ["K", "C", "F"], Location))
    assert [finding.severity for finding in findings] == ["error", "warning", "remark"]
    assert str(findings[0]) == (
        "K: the bounds 0.3 to 0.45 of K contain no value that can be stored: its step is 0.5. "
        "Widen the bounds, or choose a finer step."
    )
    assert "1 locked value of C is between two steps of 0.5, such as 0.7" in str(findings[1])
    assert "F is not rounded: it is stored as FLOAT32_IEEE" in str(findings[2])


@pytest.mark.parametrize("settings", [{"method": "up"}, {"max_shift": 0.5}, {"max_shift": np.nan}])
def test_an_unknown_method_or_a_shift_below_a_step_is_refused(settings):
    with pytest.raises(kf.ArgumentError, match=next(iter(settings)).replace("method", "rounding")):
        StorageRounding(**settings)
