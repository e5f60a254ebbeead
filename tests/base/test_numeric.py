import sys
from decimal import Decimal
from fractions import Fraction
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.base.errors import ArgumentError
from kennfeld.base.numeric import array, median, number, truths


@pytest.mark.parametrize(
    "given",
    [2, 2.0, np.int8(2), np.float32(2), np.uint64(2), np.array(2), np.array(2.0, ">f8"), Fraction(2), Decimal(2)],
)
def test_a_number_of_any_type_becomes_a_float(given):
    weight = number(given, "weight", "dataset bench", least=0)
    assert type(weight) is float
    assert weight == 2.0


def test_a_truth_value_counts_as_a_number():
    assert number(True, "weight", "dataset bench") == number(np.True_, "weight", "dataset bench") == 1.0


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("2", "'2'"),
        (Decimal("sNaN"), r"Decimal\('sNaN'\)"),
        (10**400, "1000"),
        (None, "None"),
        (1j, "1j"),
        ([2.0], r"\[2.0\]"),
        (np.array([2.0]), r"array\(\[2.\]\)"),
        (np.array("2"), "array"),
        (np.array(Decimal(2)), "array"),
        (np.float32("nan"), "nan"),
        (np.inf, "inf"),
        (np.int64(-1), "-1"),
    ],
)
def test_other_types_and_numbers_out_of_range_are_refused(given, shown):
    with pytest.raises(ArgumentError, match=f"weight={shown}.* of dataset bench must be a finite number >= 0"):
        number(given, "weight", "dataset bench", least=0)


def test_a_side_of_a_range_may_be_infinite():
    assert number(-np.inf, "lower", "limit of y", infinite=True) == -np.inf
    with pytest.raises(ArgumentError, match="lower=nan of limit of y must be a number"):
        number(np.nan, "lower", "limit of y", infinite=True)


def test_a_limit_itself_may_be_left_out():
    with pytest.raises(ArgumentError, match="scale=0 of y must be a finite number > 0"):
        number(0, "scale", "y", above=0)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([1, 2], [1, 2]),
        ([True, False], [1, 0]),
        ([1, None], [1, np.nan]),
        ([Fraction(1, 2), np.float32(1), Decimal("0.25")], [0.5, 1, 0.25]),
        (np.array([1, 2], dtype=">i2"), [1, 2]),
        (np.array([1, None, True], dtype=object), [1, np.nan, 1]),
        ([], []),
        (3, 3.0),
    ],
)
def test_numbers_become_doubles(given, expected):
    gain = array(given, "Gain")
    assert gain.dtype == np.float64
    assert gain.dtype.isnative
    np.testing.assert_array_equal(gain, expected)


def test_doubles_are_not_copied():
    values = np.arange(3.0)
    assert array(values, "Gain") is values


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["1", "2"], "Gain must be numbers, got '1' at position 1"),
        ([1, "high"], "Gain must be numbers, got 'high' at position 2"),
        ([[1, 2], [3, "a"]], "Gain must be numbers, got 'a' at position 2, 2"),
        ([1j], "Gain must be numbers, got complex numbers"),
        (np.array(["2026-01-01"], dtype="M8[s]"), "Gain must be numbers, got dates"),
        (np.array([1], dtype="m8[s]"), "Gain must be numbers, got time differences"),
        ([[1, 2], [3]], "Gain must be numbers in rows of equal length"),
        ("high", "Gain must be numbers, got 'high'"),
    ],
)
def test_arrays_of_other_types_are_refused(given, message):
    with pytest.raises(ArgumentError) as error:
        array(given, "Gain")
    assert str(error.value) == message


def test_columns_of_tables_with_types_of_their_own_are_read():
    pandas = pytest.importorskip("pandas")
    for kind in ("Int64", "Float32", "boolean"):
        gain = array(pandas.Series([1, None, 0], dtype=kind), "Gain")
        np.testing.assert_array_equal(gain, [1, np.nan, 0])
    np.testing.assert_array_equal(array(pandas.Series([1, 2]).astype("category"), "Gain"), [1, 2])
    with pytest.raises(ArgumentError, match="Gain must be numbers, got 'high' at position 2"):
        array(pandas.Series([1, "high"], dtype="category"), "Gain")
    with pytest.raises(ArgumentError, match="Gain must be numbers, got 'low' at position 1"):
        array(pandas.Series(["low", "high"]), "Gain")


@pytest.mark.parametrize("kind", [np.float64, np.int16, object])
def test_masked_values_are_missing(kind):
    masked = np.ma.array([[1, 999], [3, 4]], mask=[[0, 1], [0, 0]], dtype=kind)
    np.testing.assert_array_equal(array(masked, "Gain"), [[1, np.nan], [3, 4]])


def test_numbers_are_taken_while_another_thread_loads_masked_arrays(monkeypatch):
    """`sys.modules` has a module before its names are there."""
    monkeypatch.setitem(sys.modules, "numpy.ma", ModuleType("numpy.ma"))
    assert array([1, 2], "x").tolist() == [1.0, 2.0]


def test_a_masked_array_without_a_mask_is_all_there():
    np.testing.assert_array_equal(array(np.ma.array([1, 2]), "Gain"), [1, 2])


def test_columns_of_arrow_are_read():
    pyarrow = pytest.importorskip("pyarrow")
    np.testing.assert_array_equal(array(pyarrow.array([1, 2]), "Gain"), [1, 2])
    np.testing.assert_array_equal(array(pyarrow.chunked_array([[1.0], [2.0]]), "Gain"), [1, 2])


def test_truth_values_may_be_numbers():
    assert truths([True, 0, 2.0, np.int8(1)], "locked of Gain").tolist() == [True, False, True, True]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["no", "yes"], "locked of Gain must be numbers, got 'no' at position 1"),
        ([1, np.nan], "locked of Gain must be true or false, but a value is missing"),
        (np.ma.array([True, True], mask=[0, 1]), "locked of Gain must be true or false, but a value is missing"),
    ],
)
def test_values_other_than_true_and_false_are_refused(given, message):
    with pytest.raises(ArgumentError) as error:
        truths(given, "locked of Gain")
    assert str(error.value) == message


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=12), st.booleans())
def test_the_median_is_that_of_numpy(numbers, overwrite):
    values = np.array(numbers)
    assert median(values.copy(), overwrite=overwrite) == np.median(values)
    median(values)
    assert values.tolist() == numbers
