"""Numbers that callers pass, brought to float64 where an object takes them.

What holds numbers of another type would work on in it: float32 rounds, whole numbers overflow or wrap, and compiled
code reads doubles alone.
"""

import numbers
from decimal import Decimal
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError

__all__ = ["array", "number", "truths"]

_NUMERIC = "biuf"  # kinds of numpy: bool, whole numbers, floating point
_OTHER = {"M": "dates", "m": "time differences", "c": "complex numbers"}


def number(
    given: object, name: str, owner: str, *, least: float = -np.inf, above: float = -np.inf, infinite: bool = False
) -> float:
    """Return a number of any numeric type as a float.

    Args:
        given: a number, also one of numpy, or an array that holds a single one.
        name: the argument, for the message.
        owner: what the argument belongs to, for the message.
        least: the smallest value that is allowed.
        above: the value must exceed this one.
        infinite: allow infinity.

    Raises:
        ArgumentError: the value is not a number, or outside the range.

    >>> number(np.int8(2), "weight", "dataset bench", least=0)
    2.0
    """
    value = _float(given)
    finite = value is not None and (np.isfinite(value) or infinite)
    if value is None or not (finite and value >= least and (value > above or above == -np.inf)):
        bound = f" >= {least:g}" if np.isfinite(least) else f" > {above:g}" if np.isfinite(above) else ""
        raise ArgumentError(f"{name}={_shown(given)} of {owner} must be a {'' if infinite else 'finite '}number{bound}")
    return value


def array(given: Any, label: str) -> Float:
    """Return numbers of any numeric type as a float64 array.

    What is missing is NaN: None, pandas' NA, and what a masked array masks.

    Args:
        given: a list, an array, or a column of a table.
        label: what the numbers are, for the message.

    Raises:
        ArgumentError: an element is not a number, but a text, a date or a complex number, for example.

    >>> array([1, None, True], "values of Gain")
    array([ 1., nan,  1.])
    """
    if hasattr(given, "to_numpy") and hasattr(given, "dtype") and not isinstance(given.dtype, np.dtype):
        given = given.to_numpy(dtype=object)  # pandas' own types keep missing values apart from the others
    masked = np.ma.getmask(given)
    try:
        values = np.asarray(given)
    except ValueError:
        raise ArgumentError(f"{label} must be numbers in rows of equal length") from None
    if values.dtype.kind in _NUMERIC:
        plain = np.asarray(values, dtype=np.float64)
        return plain if masked is np.ma.nomask else np.where(masked, np.nan, plain)
    if values.dtype.kind in _OTHER:
        raise ArgumentError(f"{label} must be numbers, got {_OTHER[values.dtype.kind]}")
    objects = np.array(given, dtype=object)
    objects[masked] = None
    return _of_objects(objects, label)


def truths(given: Any, label: str) -> Bool:
    """Return truth values, or numbers in their place, as an array of bool.

    Args:
        given: a list, an array, or a column of a table; 0 is false, any other number true.
        label: what the values are, for the message.

    Raises:
        ArgumentError: an element is a text, for example, or missing.

    >>> truths([1, False], "locked of Gain")
    array([ True, False])
    """
    values = array(given, label)
    if np.isnan(values).any():
        raise ArgumentError(f"{label} must be true or false, but a value is missing")
    return np.asarray(values != 0)


def _of_objects(values: Any, label: str) -> Float:
    """Numbers that numpy found no common type for."""
    made = np.empty(values.shape)
    for at, one in np.ndenumerate(values):
        value = np.nan if _is_missing(one) else _float(one)
        if value is None:
            where = f" at position {', '.join(str(i + 1) for i in at)}" if at else ""
            raise ArgumentError(f"{label} must be numbers, got {one!r}{where}")
        made[at] = value
    return made


def _float(given: object) -> float | None:
    if isinstance(given, numbers.Real | Decimal | np.bool_):
        try:
            return float(given)
        except (OverflowError, ValueError):  # whole numbers and fractions beyond float64; Decimal's signalling NaN
            return None
    if isinstance(given, np.ndarray) and given.ndim == 0 and given.dtype.kind in _NUMERIC:
        return float(given)
    return None


def _is_missing(one: object) -> bool:
    return one is None or type(one).__name__ in ("NAType", "NaTType")


def _shown(given: object) -> str:
    value = _float(given)
    return repr(given) if value is None else f"{value:g}"
