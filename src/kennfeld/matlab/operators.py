r"""The operators of MATLAB on arrays, and the concatenation `[a b; c d]`.

Operands expand implicitly; integers saturate; `*`, `/`, `\` and `^` are matrix operations.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import size_text
from kennfeld.matlab import values as v
from kennfeld.matlab.errors import Budget

_COMPARED: dict[str, Callable[[v.Array, v.Array], v.Array]] = {
    "==": np.equal,
    "~=": np.not_equal,
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
}
_LOGIC: dict[str, Callable[[v.Array, v.Array], v.Array]] = {"&": np.logical_and, "|": np.logical_or}
_ELEMENTS: dict[str, Callable[[v.Array, v.Array], v.Array]] = {
    "+": np.add,
    "-": np.subtract,
    ".*": np.multiply,
    "./": np.divide,
    ".\\": lambda left, right: np.divide(right, left),
    ".^": lambda left, right: _power(left, right),
}


def apply_binary(operator: str, left: v.Value, right: v.Value, budget: Budget) -> v.Array:
    """Compute `left operator right`.

    Raises:
        MatlabValueError: The operation is not defined for the operands, or the result is complex.
    """
    first, second = v.array_value(left), v.array_value(right)
    if first.dtype.kind == "O" or second.dtype.kind == "O":
        return _applyto_strings(operator, first, second)
    name = "double" if operator in _COMPARED or operator in _LOGIC else result_class(first, second)
    with np.errstate(all="ignore"):
        result = _apply_operator(operator, v.numbers(first), v.numbers(second), budget)
    return result if result.dtype == np.bool_ else cast_to_class(result, name)


def _apply_operator(operator: str, left: Float, right: Float, budget: Budget) -> v.Array:
    if operator in ("*", "/", "\\", "^"):
        simple = left.size == 1 if operator == "\\" else right.size == 1
        if operator in ("*", "^"):
            simple = (left.size == 1 and right.size == 1) if operator == "^" else simple or left.size == 1
        if not simple:
            return _apply_to_matrices(operator, left, right, budget)
        operator = "." + operator
    if operator in _LOGIC:
        return _apply_expanded(_LOGIC[operator], to_logical(left), to_logical(right), budget)
    return _apply_expanded((_COMPARED | _ELEMENTS)[operator], left, right, budget)


def _apply_expanded(
    operation: Callable[[v.Array, v.Array], v.Array], left: v.Array, right: v.Array, budget: Budget
) -> v.Array:
    left, right = pad_dimensions(left, right)
    try:
        budget.allocate(math.prod(np.broadcast_shapes(left.shape, right.shape)))
    except ValueError:
        sizes = (size_text(array.shape) for array in (left, right))
        raise v.MatlabValueError("the sizes {} and {} are not compatible".format(*sizes)) from None
    return operation(left, right)


def _power(left: Float, right: Float) -> Float:
    if np.any((left < 0) & (right != np.floor(right)) & np.isfinite(right)):
        raise v.MatlabValueError("a fractional power of a negative number is complex")
    return np.power(left, right)


def _apply_to_matrices(operator: str, left: Float, right: Float, budget: Budget) -> Float:
    if left.ndim > 2 or right.ndim > 2:
        raise v.MatlabValueError(f"{operator} requires two-dimensional matrices; use .{operator} for their elements")
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
        raise v.MatlabValueError(
            "^ requires numbers, or a square matrix and an integer exponent; use .^ for the elements"
        )
    exponent = float(right.flat[0])
    if abs(exponent) > 1000:
        raise v.MatlabValueError(f"the exponent {exponent:g} of a matrix is too large")
    budget.allocate(left.shape[0] ** 3 / 10)
    return _run_solver(lambda: np.linalg.matrix_power(left, int(exponent)))


def _check_shapes(fits: bool, operator: str, left: v.Array, right: v.Array) -> None:
    if not fits:
        sizes = f"{size_text(left.shape)} and {size_text(right.shape)}"
        remedy = f"; use .{operator} for their elements" if left.shape == right.shape else ""
        raise v.MatlabValueError(f"matrices of size {sizes} are not compatible with {operator}{remedy}")


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
        raise v.MatlabValueError(f"the linear system cannot be solved ({str(error).lower()})") from None


def _applyto_strings(operator: str, left: v.Array, right: v.Array) -> v.Array:
    """Join strings by +, or compare them."""
    words = [to_strings(array) for array in (left, right)]
    if operator == "+":
        return np.asarray(np.add(*words), dtype=object)
    if operator in ("==", "~="):
        return np.asarray(_COMPARED[operator](*words), dtype=np.bool_)
    raise v.MatlabValueError(f"{operator} is not defined for strings")


def pad_dimensions(*arrays: v.Array, least: int = 0) -> list[v.Array]:
    """Append dimensions of length 1 until all arrays have as many, and at least `least`."""
    count = max(least, *(array.ndim for array in arrays))
    return [array.reshape(array.shape + (1,) * (count - array.ndim)) for array in arrays]


def result_class(*operands: v.Value) -> str:
    """Return the class of a result: an integer class wins over single, single over double."""
    names = dict.fromkeys(v.class_name(v.array_value(operand)) for operand in operands)
    whole = [name for name in names if name in v.INTEGERS]
    if len(whole) > 1:
        raise v.MatlabValueError(f"{whole[0]} and {whole[1]} cannot be combined")
    return whole[0] if whole else "single" if "single" in names else "double"


def cast_to_class(values: Float, name: str) -> v.Array:
    """Convert numbers to a class; integers are rounded and saturate."""
    if name == "double":
        return values
    if name == "logical":
        return np.asarray(values != 0)
    if name == "single":
        return values.astype(np.float32)
    limits = np.iinfo(name)
    rounded = np.where(np.isnan(values), 0.0, round_half_away(values))
    inside = np.clip(rounded, float(limits.min), float(limits.max))
    high = inside >= float(limits.max)
    return np.where(high, np.array(limits.max, dtype=name), np.where(high, 0.0, inside).astype(name))


def round_half_away(values: Float) -> Float:
    """Round to the nearest integer, halves away from zero."""
    return np.asarray(np.trunc(values + np.copysign(0.5, values)))


def apply_unary(operator: str, operand: v.Value) -> v.Array:
    """Compute `-x`, `+x` or `~x`."""
    array = v.array_value(operand)
    values = v.numbers(array)
    if operator == "~":
        return ~to_logical(values)
    return cast_to_class(-values if operator == "-" else values, result_class(array))


def transpose(array: v.Array) -> v.Array:
    """Exchange rows and columns."""
    if array.ndim > 2:
        raise v.MatlabValueError("an array of more than two dimensions cannot be transposed")
    return array.T


def is_true(value: v.Value) -> bool:
    """Return True if a condition holds: it is not empty and contains no zero."""
    truths = to_logical(v.numbers(value))
    return bool(truths.size) and bool(truths.all())


def to_logical(values: Float) -> v.Array:
    """Return where numbers are not 0."""
    if np.isnan(values).any():
        raise v.MatlabValueError("NaN is neither true nor false")
    return np.asarray(values != 0)


def colon_range(first: v.Value, step: v.Value | None, last: v.Value, budget: Budget) -> v.Array:
    """Return `first:step:last`; no element exceeds `last`."""
    begin, end = _range_bound(first), _range_bound(last)
    width = 1.0 if step is None else _range_bound(step)
    parts = [first, last] if step is None else [first, step, last]
    name = result_class(*(v.array_value(part) for part in parts))
    if any(math.isnan(number) for number in (begin, width, end)):
        return cast_to_class(v.row([math.nan]), name)
    if width == 0 or not (end - begin) * width >= 0:
        return cast_to_class(np.zeros((1, 0)), name)
    if not math.isfinite(begin) or not math.isfinite((end - begin) / width):
        raise v.MatlabValueError("the range is infinite")
    ratio = (end - begin) / width
    count = math.floor(ratio + 3e-16 * max(abs(ratio), abs(begin / width), 1.0)) + 1
    budget.allocate(count)
    values = begin + width * np.arange(count, dtype=np.float64)
    values[-1] = min(values[-1], end) if width > 0 else max(values[-1], end)
    return cast_to_class(v.row(values), name)


def _range_bound(value: v.Value) -> float:
    values = v.numbers(value)
    if not values.size:
        raise v.MatlabValueError("the bounds of a range must not be empty")
    return float(values.flat[0])


def concatenate_rows(rows: Sequence[Sequence[v.Value]], budget: Budget) -> v.Value:
    """Return the matrix made of rows of values."""
    return concatenate_along([concatenate_along(row, 1, budget) for row in rows], 0, budget)


def concatenate_along(values: Sequence[v.Value], axis: int, budget: Budget) -> v.Value:
    """Concatenate values along a dimension, in their common class."""
    if len(values) == 1:
        return values[0]
    if not values:
        return v.EMPTY
    if any(isinstance(value, v.MatlabCell) for value in values):
        parts = [
            value.values if isinstance(value, v.MatlabCell) else v.object_array([value], (1, 1)) for value in values
        ]
        full = [part for value, part in zip(values, parts, strict=True) if not _is_nothing(value)]
        return v.MatlabCell(_concatenate(full, axis, budget)) if full else v.MatlabCell(parts[0])
    are_numbers = any(isinstance(value, np.ndarray) and value.size for value in values)
    if any(isinstance(value, v.MatlabStruct) for value in values) and not are_numbers:
        return _concatenate_structs([value for value in values if not _is_nothing(value)], axis, budget)
    return _concatenate_arrays([v.array_value(value) for value in values], axis, budget)


def make_cells(rows: Sequence[Sequence[v.Value]], budget: Budget) -> v.MatlabCell:
    """Return the cell array made of rows of values."""
    parts = [v.object_array(list(row), (1, len(row))) for row in rows]
    return v.MatlabCell(_concatenate(parts, 0, budget)) if parts else v.MatlabCell(np.empty((0, 0), dtype=object))


def _is_nothing(value: v.Value) -> bool:
    return v.elements_of(value).shape == (0, 0)


def _concatenate_arrays(arrays: Sequence[v.Array], axis: int, budget: Budget) -> v.Array:
    kinds = {array.dtype.kind for array in arrays}
    if "O" in kinds:
        return _concatenate([to_strings(array) for array in arrays], axis, budget)
    if kinds == {"b"} or kinds == {"U"}:
        return _concatenate(arrays, axis, budget)
    if "U" in kinds:
        return _concatenate([_to_characters(array) for array in arrays], axis, budget)
    whole = next((v.class_name(array) for array in arrays if array.dtype.kind in "iu"), "")
    name = whole or result_class(*arrays)
    return cast_to_class(_concatenate([v.numbers(array) for array in arrays], axis, budget), name)


def to_strings(array: v.Array) -> v.Array:
    """Return an array as strings: a row of characters as one, numbers each as its text."""
    if array.dtype.kind == "O":
        return array
    if array.dtype.kind == "U":
        return v.object_array(["".join(array.ravel(order="F").tolist())], (1, 1))
    return v.object_array([f"{number:.5g}" for number in array.ravel(order="F").tolist()], array.shape)


def _to_characters(array: v.Array) -> v.Array:
    if array.dtype.kind == "U":
        return array
    codes = v.numbers(array)
    if not ((codes >= 0) & (codes < 0x110000)).all():
        raise v.MatlabValueError("a number next to text is not a character code")
    return np.array([chr(int(code)) for code in codes.ravel(order="F")], dtype="U1").reshape(codes.shape, order="F")


def _concatenate(arrays: Sequence[v.Array], axis: int, budget: Budget) -> v.Array:
    parts = [array for array in arrays if array.size] or [max(arrays, key=lambda array: array.shape)]
    budget.allocate(sum(array.size for array in parts))
    try:
        return v.trim_dimensions(np.concatenate(pad_dimensions(*parts, least=axis + 1), axis=axis))
    except ValueError:
        sizes = ", ".join(size_text(array.shape) for array in parts[:4])
        where = "vertically" if axis == 0 else "horizontally"
        raise v.MatlabValueError(f"arrays of size {sizes} cannot be concatenated {where}") from None


def _concatenate_structs(values: Sequence[v.Value], axis: int, budget: Budget) -> v.Value:
    if not all(isinstance(value, v.MatlabStruct) for value in values):
        raise v.MatlabValueError("a struct can be concatenated with structs only")
    structs = [value for value in values if isinstance(value, v.MatlabStruct)]
    names = structs[0].names
    if any(set(struct.names) != set(names) or struct.kind != structs[0].kind for struct in structs):
        raise v.MatlabValueError("structs with different fields cannot be concatenated")
    return v.MatlabStruct(_concatenate([struct.elements for struct in structs], axis, budget), names, structs[0].kind)
