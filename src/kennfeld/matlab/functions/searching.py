"""Functions that find, sort and compare elements."""

from collections.abc import Callable

import numpy as np

from kennfeld.matlab.functions.registry import MANY, Arguments, function
from kennfeld.matlab.values import (
    Array,
    Cell,
    Handle,
    NoValueError,
    Opaque,
    Struct,
    Value,
    characters,
    class_of,
    logical,
    numbers,
    object_array,
    text,
)

__all__ = ["is_equal", "matches"]


@function("find", 1, 3)
def _find(given: Arguments) -> "Value | tuple[Value, ...]":
    values = given.numbers(0)
    found = np.flatnonzero(values.ravel(order="F"))
    if len(given) > 1:
        count = given.whole(1)
        if count < 1:
            raise NoValueError(f"{count} is no number of elements")
        from_end = len(given) > 2 and given.text(2) == "last"
        found = found[max(found.size - count, 0) :] if from_end else found[:count]
    is_row = values.ndim == 2 and values.shape[0] == 1 and values.shape[1] != 1
    shape = (1, -1) if is_row else (-1, 1)
    if values.shape == (0, 0) or (values.size == 1 and not found.size):
        shape = (0, 0)
    if given.outputs < 2:
        return (found + 1.0).reshape(shape)
    rows, columns = np.unravel_index(found, (values.shape[0], values.size // max(values.shape[0], 1)), order="F")
    taken = values.ravel(order="F")[found]
    return (rows + 1.0).reshape(shape), (columns + 1.0).reshape(shape), taken.reshape(shape)


@function("sort", 1, 3)
def _sort(given: Arguments) -> "Value | tuple[Value, ...]":
    is_down = given.is_text(len(given) - 1) and len(given) > 1 and given.text(len(given) - 1).casefold() == "descend"
    if isinstance(given[0], Cell):
        words = [text(one) for one in given[0].values.ravel(order="F")]
        ranks = sorted(range(len(words)), key=lambda at: words[at], reverse=is_down)
        sorted_ = object_array([characters(words[at]) for at in ranks], given[0].values.shape)
        return Cell(sorted_), np.array(ranks, dtype=np.float64).reshape(given[0].values.shape, order="F") + 1
    array = given.array(0)
    values = array if array.dtype.kind == "U" else numbers(array)
    axis = given.dimension(1, array) if len(given) > 1 and not given.is_text(1) else given.dimension(9, array)
    order: Array = np.argsort(-values if is_down and values.dtype.kind != "U" else values, axis=axis, kind="stable")
    if is_down and values.dtype.kind == "f":
        order = _missing_first(values, order, axis)
    if is_down and values.dtype.kind == "U":
        order = np.flip(order, axis)
    return np.take_along_axis(array, order, axis), order.astype(np.float64) + 1


def _missing_first(values: Array, order: Array, axis: int) -> Array:
    """NaN counts as larger than any number."""
    missing = np.isnan(np.take_along_axis(values, order, axis))
    return np.take_along_axis(order, np.argsort(~missing, axis=axis, kind="stable"), axis)


@function("unique", 1, 3)
def _unique(given: Arguments) -> "Value | tuple[Value, ...]":
    is_stable = any(word == "stable" for word in given.words(1))
    if isinstance(given[0], Cell):
        words = [text(one) for one in given[0].values.ravel(order="F")]
        kept = list(dict.fromkeys(words)) if is_stable else sorted(set(words))
        return Cell(object_array([characters(word) for word in kept], (len(kept), 1)))
    array = given.array(0)
    if any(word == "rows" for word in given.words(1)):
        return np.unique(array, axis=0)
    flat = array.ravel(order="F")
    found, first, back = np.unique(flat, return_index=True, return_inverse=True, equal_nan=False)
    if is_stable:
        order = np.argsort(first, kind="stable")
        found, first = found[order], first[order]
        back = np.argsort(order, kind="stable")[back]
    shape = (1, -1) if array.ndim == 2 and array.shape[0] == 1 and array.size else (-1, 1)
    return found.reshape(shape), (first + 1.0).reshape(-1, 1), (back + 1.0).reshape(-1, 1)


def _words(value: Value) -> set[str]:
    if isinstance(value, Cell):
        return {text(one) for one in value.values.ravel()}
    return {text(value)}


@function("ismember", 2)
def _ismember(given: Arguments) -> "Value | tuple[Value, ...]":
    if isinstance(given[1], Cell):
        known = _words(given[1])
        if isinstance(given[0], Cell):
            parts = given[0].values
            return np.array([text(one) in known for one in parts.ravel()], dtype=bool).reshape(parts.shape)
        return logical(text(given[0]) in known)
    array, among = given.array(0), given.array(1).ravel(order="F")
    if array.dtype.kind != "U" or among.dtype.kind != "U":
        array, among = numbers(array), numbers(among.reshape(1, -1)).ravel()
    values, first = np.unique(among, return_index=True)
    at = np.searchsorted(values, array)
    inside = np.isin(array, among)
    place = first[np.minimum(at, max(values.size - 1, 0))] + 1.0 if values.size else np.zeros(array.shape)
    return inside, np.where(inside, place, 0.0)


def _set_operation(given: Arguments, name: str) -> Value:
    if isinstance(given[0], Cell) or isinstance(given[1], Cell):
        one, other = _words(given[0]), _words(given[1])
        kept = sorted(one | other if name == "union" else one & other if name == "intersect" else one - other)
        return Cell(object_array([characters(word) for word in kept], (1, len(kept))))
    one_, other_ = given.array(0), given.array(1)
    operations: dict[str, Callable[..., Array]] = {
        "union": np.union1d,
        "intersect": np.intersect1d,
        "setdiff": np.setdiff1d,
    }
    found = operations[name](one_.ravel(order="F"), other_.ravel(order="F"))
    is_column = one_.shape[1] == 1 and one_.shape[0] > 1 and (name == "setdiff" or other_.shape[1] == 1)
    return found.reshape((-1, 1) if is_column else (1, -1))


@function("union", 2)
def _union(given: Arguments) -> Value:
    return _set_operation(given, "union")


@function("intersect", 2)
def _intersect(given: Arguments) -> Value:
    return _set_operation(given, "intersect")


@function("setdiff", 2)
def _setdiff(given: Arguments) -> Value:
    return _set_operation(given, "setdiff")


@function("issorted", 1)
def _issorted(given: Arguments) -> Value:
    values = given.numbers(0).ravel(order="F")
    return logical(bool((np.diff(values) >= 0).all()))


@function("isequal", 2, MANY)
def _isequal(given: Arguments) -> Value:
    return logical(all(is_equal(given[0], other) for other in given.values[1:]))


def is_equal(one: Value, other: Value) -> bool:
    """Whether two values have the same size and elements; NaN equals nothing."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.dtype.kind == "O" or other.dtype.kind == "O":
            return _as_texts(one) == _as_texts(other) is not None
        return one.shape == other.shape and bool((numbers(one) == numbers(other)).all())
    if class_of(one) != class_of(other) or isinstance(one, Handle | Opaque):
        return False
    if isinstance(one, Cell) and isinstance(other, Cell):
        pairs = zip(one.values.ravel(), other.values.ravel(), strict=False)
        return one.values.shape == other.values.shape and all(is_equal(a, b) for a, b in pairs)
    if isinstance(one, Struct) and isinstance(other, Struct):
        if one.elements.shape != other.elements.shape or set(one.names) != set(other.names):
            return False
        both = zip(one.elements.ravel(), other.elements.ravel(), strict=True)
        return all(is_equal(a[name], b[name]) for a, b in both for name in one.names)
    return False


def _as_texts(array: Array) -> list[str] | None:
    if array.dtype.kind == "U":
        return ["".join(array.ravel(order="F").tolist())]
    return [str(one) for one in array.ravel(order="F")] if array.dtype.kind == "O" else None


@function("histc", 2)
def _histc(given: Arguments) -> Value:
    values, edges = given.numbers(0).ravel(), given.numbers(1)
    flat = edges.ravel(order="F")
    if flat.size > 1 and (np.diff(flat) < 0).any():
        raise NoValueError("the edges have to increase")
    counts = np.histogram(values, flat)[0].astype(np.float64) if flat.size > 1 else np.zeros(0)
    last = float((values == flat[-1]).sum()) if flat.size else 0.0
    if counts.size:
        counts[-1] -= last
    return np.append(counts, last).reshape(edges.shape)


def matches(subject: Value, case: Value) -> bool:
    """Whether a `case` is the one of a `switch`: the same number or text, or one of the cells."""
    if isinstance(case, Cell):
        return any(matches(subject, one) for one in case.values.ravel(order="F"))
    if not isinstance(subject, np.ndarray) or not isinstance(case, np.ndarray):
        return False
    if subject.dtype.kind in "UO" or case.dtype.kind in "UO":
        return _as_texts(subject) == _as_texts(case) is not None
    return bool(case.size) and bool(subject.size) and bool((numbers(subject) == numbers(case)).all())
