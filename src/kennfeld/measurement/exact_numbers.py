"""Rests of numbers with more than 15 digits, which doubles lack: time stamps since 1970 with all nanoseconds."""

from collections.abc import Sequence
from decimal import Decimal as ExactDecimal
from decimal import InvalidOperation
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.measurement.cells import Decimal

_LARGE = 1e8  # smaller numbers with as many digits need no more than a double has
_DIGITS = 16  # characters of a number, up to which a double holds it
_INTEGERS = 2.0**53  # up to which doubles hold each one
_LARGEST = 2.0**63 - 2.0**11  # beyond it a double may round to an integer of more than 64 bits


def has_many_digits(cell: str) -> bool:
    """Return whether a double holds less than the large number in a cell.

    >>> has_many_digits("1767225600.123456"), has_many_digits("1767225600.1234567"), has_many_digits("0.12345678901234")
    (False, True, False)
    """
    text = cell.strip()
    if len(text) <= _DIGITS or sum(map(str.isdigit, text)) <= _DIGITS:
        return False
    try:
        return float(text.replace(",", ".")) > _LARGE
    except ValueError:
        return False


def rest_of_cells(cells: Sequence[object], values: Float, decimal: Decimal) -> Float | None:
    """Return what the values, Float[samples], lack of the numbers in these cells; None if nothing.

    >>> rest_of_cells(["1767225600000000001"], np.array([1767225600000000001.0]), ".")
    array([1.])
    """
    if not any(_is_long(cell) for cell in cells):
        return None
    rest = np.zeros(len(cells))
    for k, cell in enumerate(cells):
        if not np.isfinite(values[k]):
            continue
        if isinstance(cell, int):
            rest[k] = cell - int(values[k])
        elif isinstance(cell, str):
            try:
                # a `Decimal` has all digits of the float, so the difference is exact
                rest[k] = float(ExactDecimal(cell.strip().replace(",", ".")) - ExactDecimal(float(values[k])))
            except InvalidOperation:  # such as a number with separated thousands
                continue
    return rest if rest.any() else None


def _is_long(cell: object) -> bool:
    if isinstance(cell, int):
        return abs(cell) > _INTEGERS
    return isinstance(cell, str) and has_many_digits(cell)


def rest_of_integers(integers: Any) -> Float | None:
    """Return what doubles lack of integers, Int[samples]; None if nothing.

    >>> rest_of_integers(np.array([1767225600000000001]))
    array([1.])
    """
    integers = np.asarray(integers)
    integers = integers.astype(integers.dtype.newbyteorder("="))
    values = integers.astype(np.float64)
    if not values.size or np.abs(values).max() <= _INTEGERS or np.abs(values).max() >= _LARGEST:
        return None
    # the difference of unsigned integers wraps around, and is small
    rest: Float = (integers - values.astype(integers.dtype)).astype(np.int64).astype(np.float64)
    return rest
