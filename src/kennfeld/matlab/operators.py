r"""The operators of MATLAB on arrays, and the concatenation `[a b; c d]`.

Operands expand implicitly; integers saturate; `*`, `/`, `\` and `^` are matrix operations.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.values import (
    EMPTY,
    INTEGERS,
    Array,
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    Value,
    array_value,
    class_name,
    elements_of,
    format_shape,
    numbers,
    object_array,
    row,
    trim_dimensions,
)

_COMPARED: dict[str, Callable[[Array, Array], Array]] = {
    "==": np.equal,
    "~=": np.not_equal,
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
}
_LOGIC: dict[str, Callable[[Array, Array], Array]] = {"&": np.logical_and, "|": np.logical_or}
_ELEMENTS: dict[str, Callable[[Array, Array], Array]] = {
    "+": np.add,
    "-": np.subtract,
    ".*": np.multiply,
    "./": np.divide,
    ".\\": lambda left, right: np.divide(right, left),
    ".^": lambda left, right: _power(left, right),
}


def apply_binary(operator: str, left: Value, right: Value, budget: Budget) -> Array:
    """Compute `left operator right`.

    Raises:
        MatlabValueError: The operation is not defined for the operands, or the result is complex.
    """
    first, second = array_value(left), array_value(right)
    if first.dtype.kind == "O" or second.dtype.kind == "O":
        return _apply_to_strings(operator, first, second)
    name = "double" if operator in _COMPARED or operator in _LOGIC else result_class(first, second)
    with np.errstate(all="ignore"):
        result = _apply_operator(operator, numbers(first), numbers(second), budget)
    return result if result.dtype == np.bool_ else cast_to_class(result, name)


def _apply_operator(operator: str, left: Float, right: Float, budget: Budget) -> Array:
    if operator in ("*", "/", "\\", "^"):
        simple = left.size == 1 if operator == "\\" else right.size == 1
        if operator in ("*", "^"):
            simple = (left.size == 1 and right.size == 1) if operator == "^" else simple or left.size == 1
        if not simple:
            return _apply_to_matrices(operator, left, right, budget)
        operator = "." + operator
    if operator in _LOGIC:
        if np.isnan(left).any() or np.isnan(right).any():
            raise MatlabValueError("NaN is neither true nor false")
        return _apply_expanded(_LOGIC[operator], left != 0, right != 0, budget)
    return _apply_expanded((_COMPARED | _ELEMENTS)[operator], left, right, budget)


def _apply_expanded(operation: Callable[[Array, Array], Array], left: Array, right: Array, budget: Budget) -> Array:
    left, right = pad_dimensions(left, right)
    try:
        budget.allocate(math.prod(np.broadcast_shapes(left.shape, right.shape)))
    except ValueError:
        sizes = (format_shape(array.shape) for array in (left, right))
        raise MatlabValueError("the sizes {} and {} are not compatible".format(*sizes)) from None
    return operation(left, right)


def _power(left: Float, right: Float) -> Float:
    if np.any((left < 0) & (right != np.floor(right)) & np.isfinite(right)):
        raise MatlabValueError("a fractional power of a negative number is complex")
    return np.power(left, right)


def _apply_to_matrices(operator: str, left: Float, right: Float, budget: Budget) -> Float:
    if left.ndim > 2 or right.ndim > 2:
        raise MatlabValueError(f"{operator} requires two-dimensional matrices; use .{operator} for their elements")
    if operator == "*":
        _check_shapes(left.shape[1] == right.shape[0], operator, left, right)
        budget.allocate(left.shape[0] * right.shape[1] + left.size * right.shape[1] / 100)
        return np.asarray(left @ right)
    if operator == "/":
        _check_shapes(left.shape[1] == right.shape[1], operator, left, right)
        return _solve(right.T, left.T, budget).T
    if operator == "\\":
        _check_shapes(left.shape[0] == right.shape[0], operator, left, right)
        return _solve(left, right, budget)
    if left.shape[0] != left.shape[1] or right.size != 1 or right.flat[0] != np.floor(right.flat[0]):
        raise MatlabValueError(
            "^ requires numbers, or a square matrix and an integer exponent; use .^ for the elements"
        )
    exponent = float(right.flat[0])
    if abs(exponent) > 1000:
        raise MatlabValueError(f"the exponent {exponent:g} of a matrix is too large")
    budget.allocate(left.shape[0] ** 3 / 10)
    return _run_solver(lambda: np.linalg.matrix_power(left, int(exponent)))


def _check_shapes(fits: bool, operator: str, left: Array, right: Array) -> None:
    if not fits:
        sizes = f"{format_shape(left.shape)} and {format_shape(right.shape)}"
        remedy = f"; use .{operator} for their elements" if left.shape == right.shape else ""
        raise MatlabValueError(f"matrices of size {sizes} are not compatible with {operator}{remedy}")


def _solve(left: Float, right: Float, budget: Budget) -> Float:
    budget.allocate(max(left.shape) * left.size / 10)
    if left.shape[0] == left.shape[1]:
        return _run_solver(lambda: np.linalg.solve(left, right))
    if not (np.isfinite(left).all() and np.isfinite(right).all()):
        return np.full((left.shape[1], right.shape[1]), np.nan)
    return _run_solver(lambda: np.linalg.lstsq(left, right, rcond=None)[0])


def _run_solver(solve: Callable[[], Any]) -> Float:
    try:
        return np.asarray(solve(), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise MatlabValueError(f"the linear system cannot be solved ({str(error).lower()})") from None


def _apply_to_strings(operator: str, left: Array, right: Array) -> Array:
    """Join strings by +, or compare them."""
    words = [_to_string_array(array) for array in (left, right)]
    if operator == "+":
        joined = np.frompyfunc(lambda a, b: a + b, 2, 1)(*words)
        return np.asarray(joined, dtype=object)
    if operator in ("==", "~="):
        return np.asarray(_COMPARED[operator](*words), dtype=np.bool_)
    raise MatlabValueError(f"{operator} is not defined for strings")


def _to_string_array(array: Array) -> Array:
    if array.dtype.kind == "O":
        return array
    word = np.empty((1, 1), dtype=object)
    if array.dtype.kind == "U":
        word[0, 0] = "".join(array.ravel(order="F").tolist())
    else:
        word[0, 0] = f"{float(array.flat[0]):.5g}" if array.size == 1 else ""
    return word


def pad_dimensions(*arrays: Array, least: int = 0) -> list[Array]:
    """Append dimensions of length 1 until all arrays have as many, and at least `least`."""
    count = max(least, *(array.ndim for array in arrays))
    return [array.reshape(array.shape + (1,) * (count - array.ndim)) for array in arrays]


def result_class(*operands: Value) -> str:
    """Return the class of a result: an integer class wins over single, single over double."""
    names = {class_name(array_value(operand)) for operand in operands}
    whole = [name for name in names if name in INTEGERS]
    if len(whole) > 1:
        raise MatlabValueError(f"{whole[0]} and {whole[1]} cannot be combined")
    return whole[0] if whole else "single" if "single" in names else "double"


def cast_to_class(values: Float, name: str) -> Array:
    """Convert numbers to a class; integers are rounded and saturate."""
    if name == "double":
        return values
    if name == "single":
        return values.astype(np.float32)
    limits = np.iinfo(name)
    rounded = np.where(np.isnan(values), 0.0, np.trunc(values + np.copysign(0.5, values)))
    inside = np.clip(rounded, float(limits.min), float(limits.max))
    high = inside >= float(limits.max)
    return np.where(high, np.array(limits.max, dtype=name), np.where(high, 0.0, inside).astype(name))


def apply_unary(operator: str, operand: Value) -> Array:
    """Compute `-x`, `+x` or `~x`."""
    array = array_value(operand)
    if operator == "~":
        values = numbers(array)
        if np.isnan(values).any():
            raise MatlabValueError("NaN is neither true nor false")
        return np.asarray(values == 0)
    values = numbers(array)
    return cast_to_class(-values if operator == "-" else values, result_class(array))


def transpose(array: Array) -> Array:
    """Exchange rows and columns."""
    if array.ndim > 2:
        raise MatlabValueError("an array of more than two dimensions cannot be transposed")
    return array.T


def is_true(value: Value) -> bool:
    """Return True if a condition holds: it is not empty and contains no zero."""
    values = numbers(value)
    if np.isnan(values).any():
        raise MatlabValueError("NaN is neither true nor false")
    return bool(values.size) and bool((values != 0).all())


def colon_range(first: Value, step: Value | None, last: Value, budget: Budget) -> Array:
    """Return `first:step:last`; no element exceeds `last`."""
    begin, end = _range_bound(first), _range_bound(last)
    width = 1.0 if step is None else _range_bound(step)
    parts = [first, last] if step is None else [first, step, last]
    name = result_class(*(array_value(part) for part in parts))
    if any(math.isnan(number) for number in (begin, width, end)):
        return cast_to_class(row([math.nan]), name)
    if width == 0 or not (end - begin) * width >= 0:
        return cast_to_class(np.zeros((1, 0)), name)
    if not math.isfinite(begin) or not math.isfinite((end - begin) / width):
        raise MatlabValueError("the range is infinite")
    ratio = (end - begin) / width
    count = math.floor(ratio + 3e-16 * max(abs(ratio), abs(begin / width), 1.0)) + 1
    budget.allocate(count)
    values = begin + width * np.arange(count, dtype=np.float64)
    values[-1] = min(values[-1], end) if width > 0 else max(values[-1], end)
    return cast_to_class(row(values), name)


def _range_bound(value: Value) -> float:
    values = numbers(value)
    if not values.size:
        raise MatlabValueError("the bounds of a range must not be empty")
    return float(values.flat[0])


def concatenate_rows(rows: Sequence[Sequence[Value]], budget: Budget) -> Value:
    """Return the matrix made of rows of values."""
    return concatenate_along([concatenate_along(row, 1, budget) for row in rows], 0, budget)


def concatenate_along(values: Sequence[Value], axis: int, budget: Budget) -> Value:
    """Concatenate values along a dimension, in their common class."""
    if len(values) == 1:
        return values[0]
    if not values:
        return EMPTY
    if any(isinstance(value, MatlabCell) for value in values):
        parts = [value.values if isinstance(value, MatlabCell) else object_array([value], (1, 1)) for value in values]
        full = [part for value, part in zip(values, parts, strict=True) if not _is_nothing(value)]
        return MatlabCell(_concatenate(full, axis, budget)) if full else MatlabCell(parts[0])
    if any(isinstance(value, MatlabStruct) for value in values) and not _are_numbers(values):
        return _concatenate_structs([value for value in values if not _is_nothing(value)], axis, budget)
    return _concatenate_arrays([array_value(value) for value in values], axis, budget)


def make_cells(rows: Sequence[Sequence[Value]], budget: Budget) -> MatlabCell:
    """Return the cell array made of rows of values."""
    parts = [object_array(list(row), (1, len(row))) for row in rows]
    return MatlabCell(_concatenate(parts, 0, budget)) if parts else MatlabCell(np.empty((0, 0), dtype=object))


def _are_numbers(values: Sequence[Value]) -> bool:
    """Return True if one of the values is a non-empty plain array."""
    return any(isinstance(value, np.ndarray) and value.size for value in values)


def _is_nothing(value: Value) -> bool:
    return elements_of(value).shape == (0, 0)


def _concatenate_arrays(arrays: Sequence[Array], axis: int, budget: Budget) -> Array:
    kinds = {array.dtype.kind for array in arrays}
    if "O" in kinds:
        return _concatenate([_to_strings(array) for array in arrays], axis, budget)
    if kinds == {"b"} or kinds == {"U"}:
        return _concatenate(arrays, axis, budget)
    if "U" in kinds:
        return _concatenate([_to_characters(array) for array in arrays], axis, budget)
    whole = next((class_name(array) for array in arrays if array.dtype.kind in "iu"), "")
    name = whole or result_class(*arrays)
    joined = _concatenate([numbers(array) for array in arrays], axis, budget)
    return cast_to_class(joined, name)


def _to_strings(array: Array) -> Array:
    if array.dtype.kind == "O":
        return array
    if array.dtype.kind == "U":
        return object_array(["".join(array.ravel(order="F").tolist())], (1, 1))
    return object_array([f"{number:.5g}" for number in array.ravel(order="F").tolist()], array.shape)


def _to_characters(array: Array) -> Array:
    if array.dtype.kind == "U":
        return array
    codes = numbers(array)
    if not ((codes >= 0) & (codes < 0x110000)).all():
        raise MatlabValueError("a number next to text is not a character code")
    return np.array([chr(int(code)) for code in codes.ravel(order="F")], dtype="U1").reshape(codes.shape, order="F")


def _concatenate(arrays: Sequence[Array], axis: int, budget: Budget) -> Array:
    parts = [array for array in arrays if array.size] or [max(arrays, key=lambda array: array.shape)]
    budget.allocate(sum(array.size for array in parts))
    try:
        return trim_dimensions(np.concatenate(pad_dimensions(*parts, least=axis + 1), axis=axis))
    except ValueError:
        sizes = ", ".join(format_shape(array.shape) for array in parts[:4])
        where = "vertically" if axis == 0 else "horizontally"
        raise MatlabValueError(f"arrays of size {sizes} cannot be concatenated {where}") from None


def _concatenate_structs(values: Sequence[Value], axis: int, budget: Budget) -> Value:
    if not all(isinstance(value, MatlabStruct) for value in values):
        raise MatlabValueError("a struct can be concatenated with structs only")
    structs = [value for value in values if isinstance(value, MatlabStruct)]
    names = structs[0].names
    if any(set(struct.names) != set(names) or struct.kind != structs[0].kind for struct in structs):
        raise MatlabValueError("structs with different fields cannot be concatenated")
    return MatlabStruct(_concatenate([struct.elements for struct in structs], axis, budget), names, structs[0].kind)
