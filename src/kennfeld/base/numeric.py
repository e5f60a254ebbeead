"""Conversion of numbers that callers pass to float64, where an object takes them.

Other types would be used in later computations: float32 rounds, integers overflow or wrap, and compiled code reads
doubles only.
"""

import numbers
from decimal import Decimal
from importlib import import_module
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError

_NUMERIC = "biuf"  # kinds of numpy: bool, whole numbers, floating point
_OTHER = {"M": "dates", "m": "time differences", "c": "complex numbers"}


def number(
    value: object, name: str, owner: str, *, least: float = -np.inf, above: float = -np.inf, infinite: bool = False
) -> float:
    """Convert a number of any numeric type to a float, and check its range.

    Args:
        value: a number, also one of numpy, or an array that holds a single one.
        name: the argument, for the message.
        owner: the owner of the argument, for the message.
        least: the smallest allowed value.
        above: exclusive lower bound.
        infinite: allow infinity.

    Raises:
        ArgumentError: the value is not a number, or outside the range.

    >>> number(np.int8(2), "weight", "dataset bench", least=0)
    2.0
    """
    result = _float(value)
    finite = result is not None and (np.isfinite(result) or infinite)
    # -inf is not above -inf, though it is allowed without a bound
    if result is None or not (finite and result >= least and (result > above or above == -np.inf)):
        bound = f" >= {least:g}" if np.isfinite(least) else f" > {above:g}" if np.isfinite(above) else ""
        text = repr(value) if result is None else f"{result:g}"
        raise ArgumentError(f"{name}={text} of {owner} must be a {'' if infinite else 'finite '}number{bound}")
    return result


def array(source: Any, label: str) -> Float:
    """Convert numbers of any numeric type to a float64 array of the same shape.

    Missing elements become NaN: None, pandas' NA, and masked elements of a masked array.

    Args:
        source: a list, an array, or a column of a table.
        label: the name of the numbers, for the message.

    Raises:
        ArgumentError: an element is not a number, but a text, a date or a complex number, for example.

    >>> array([1, None, True], "values of Gain")
    array([ 1., nan,  1.])
    """
    if type(source) is float:
        return np.array(source)
    if hasattr(source, "to_numpy") and hasattr(source, "dtype") and not isinstance(source.dtype, np.dtype):
        try:
            source = source.to_numpy(dtype=object)  # pandas' own types keep missing values apart from the others
        except TypeError:
            source = source.to_numpy()  # polars knows missing values of all types
    masked = _mask(source)
    try:
        values = np.asarray(source)
    except ValueError:
        raise ArgumentError(f"{label} must be numbers in rows of equal length") from None
    if values.dtype.kind in _NUMERIC:
        plain = np.asarray(values, dtype=np.float64)
        return plain if masked is None else np.where(masked, np.nan, plain)
    if values.dtype.kind in _OTHER:
        raise ArgumentError(f"{label} must be numbers, got {_OTHER[values.dtype.kind]}")
    # from the source: beside a text, NumPy makes texts of the numbers, too
    objects = np.array(source, dtype=object)
    if masked is not None:
        objects[masked] = None
    return _of_objects(objects, label)


def _mask(source: Any) -> Bool | None:
    """Return the mask of a masked array; None for any other source, and if nothing is masked."""
    if type(source) is np.ndarray:
        return None
    # `sys.modules` would name a module that another thread is still loading
    if not any(base.__module__.startswith("numpy.ma") for base in type(source).__mro__):
        return None
    masked_arrays = import_module("numpy.ma")
    mask = masked_arrays.getmask(source)
    return None if mask is masked_arrays.nomask else np.asarray(mask)


def truths(source: Any, label: str) -> Bool:
    """Convert truth values, or numbers in their place, to an array of bool of the same shape.

    Args:
        source: a list, an array, or a column of a table; 0 is false, any other number true.
        label: the name of the values, for the message.

    Raises:
        ArgumentError: an element is a text, for example, or missing.

    >>> truths([1, False], "locked of Gain")
    array([ True, False])
    """
    if isinstance(source, np.ndarray) and source.dtype == np.bool_ and not np.ma.isMaskedArray(source):
        return source.copy()
    values = array(source, label)
    if np.isnan(values).any():
        raise ArgumentError(f"{label} must be true or false, but a value is missing")
    return np.asarray(values != 0)


def median(values: Float, *, overwrite: bool = False) -> float:
    """Return the median of finite numbers, Float[n], n > 0, as `np.median` does, which loads masked arrays for it.

    Args:
        values: the numbers.
        overwrite: the order of the numbers may change.

    >>> median(np.array([3.0, 1.0, 2.0])), median(np.array([4.0, 1.0, 2.0, 3.0]))
    (2.0, 2.5)
    """
    middle = values.size // 2
    pair = (middle, middle) if values.size % 2 else (middle - 1, middle)
    ordered = values if overwrite else values.copy()
    ordered.partition(pair)
    return float(ordered[pair[0]] + ordered[pair[1]]) / 2


def _of_objects(values: Any, label: str) -> Float:
    """Return the numbers of an array of objects, which have no common numeric type."""
    numbers_ = np.empty(values.shape)
    for index, element in np.ndenumerate(values):
        value = np.nan if _is_missing(element) else _float(element)
        if value is None:
            position = f" at position {', '.join(str(i + 1) for i in index)}" if index else ""
            raise ArgumentError(f"{label} must be numbers, got {element!r}{position}")
        numbers_[index] = value
    return numbers_


def _float(value: object) -> float | None:
    if isinstance(value, float):
        return float(value)
    if isinstance(value, numbers.Real | Decimal | np.bool_):
        try:
            return float(value)
        except (OverflowError, ValueError):  # whole numbers and fractions beyond float64; Decimal's signalling NaN
            return None
    if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in _NUMERIC:
        return float(value)
    return None


def _is_missing(element: object) -> bool:
    return element is None or type(element).__name__ in ("NAType", "NaTType")


def nested_or_none(values: Any) -> Any:
    """Return an array as lists for JSON: None for numbers that are not finite."""
    numbers = values.tolist() if isinstance(values, np.ndarray) else values
    return [nested_or_none(each) for each in numbers] if isinstance(numbers, list) else finite_or_none(numbers)


def finite_or_none(value: Any) -> Any:
    """Return a value for JSON: None for a float that is not finite."""
    if not isinstance(value, float):
        return value
    return float(value) if np.isfinite(value) else None
