"""Indexing and indexed assignment; an index that depends on signals selects among all elements."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.node_arrays import Nodes, elementwise
from kennfeld.models.imperative.path_facts import round_half_away
from kennfeld.models.imperative.symbolic_values import (
    EMPTY,
    LogicalNodes,
    String,
    SymbolicCell,
    SymbolicStruct,
    SymbolicValue,
    as_array,
    as_logical,
    constants,
    describe,
    field_of,
    integers,
    of_class,
    word_of,
)

if TYPE_CHECKING:
    from kennfeld.models.imperative.expression_evaluator import ExpressionEvaluator


MASK_REMEDY = "Write it as a loop over all elements with if."
Place = tuple[Nodes | None, list[int]]  # nodes of places that depend on signals; else fixed places, from 0

Change = Callable[[SymbolicValue | None], SymbolicValue]


def fixed_element(array: Nodes, at: Sequence[int]) -> int:
    """Return the element at zero-based indices; raises `ProgramError` if out of range."""
    try:
        if min(at) < 0:
            raise IndexError
        result = array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
    except IndexError:
        places = ",".join(str(item + 1) for item in at)
        raise ProgramError(f"index ({places}) exceeds an array of size {format_size(array)}") from None
    return int(result)


def index_value(
    calls: "ExpressionEvaluator", held: SymbolicValue, trees: Sequence[m.Expression], message: str
) -> SymbolicValue:
    """Evaluate `held(trees)`."""
    if isinstance(held, SymbolicCell):
        whole = np.arange(len(held.cells), dtype=np.int64).reshape(held.shape, order="F")
        chosen = _elements(calls, whole, calls.arguments(whole, trees), message, fixed=True)
        return SymbolicCell(tuple(held.cells[int(at)] for at in chosen.ravel(order="F")), chosen.shape)
    if isinstance(held, String) and all(is_one(calls, tree) for tree in trees):
        return held
    if isinstance(held, str):
        text = np.array([[ord(item) for item in held]], dtype=np.int64)
        chosen = _elements(calls, text, calls.arguments(text, trees), message, fixed=True)
        return "".join(chr(int(item)) for item in chosen.ravel(order="F"))
    if isinstance(held, SymbolicStruct) and all(is_one(calls, tree) for tree in trees):
        return held
    array = as_array(held, message)
    if not trees:
        return array
    places = calls.arguments(array, trees)
    if _is_mask(calls, array, places):
        return array
    result = _elements(calls, array, places, message)
    return of_class(array, result)


def _is_mask(calls: "ExpressionEvaluator", array: Nodes, places: list[SymbolicValue]) -> bool:
    """Return True if elements are selected by the mask of the statement, so that all elements may stand for them."""
    mask = calls.mask
    if mask is None or len(places) != 1 or array.shape != mask.shape:
        return False
    return isinstance(places[0], LogicalNodes) and np.array_equal(places[0], mask)


def is_one(calls: "ExpressionEvaluator", tree: m.Expression) -> bool:
    """Return True if an index of one element selects that element."""
    return isinstance(tree, m.Colon | m.End) or calls.number(tree) == 1


def _elements(
    calls: "ExpressionEvaluator", array: Nodes, places: list[SymbolicValue], message: str, fixed: bool = False
) -> Nodes:
    whole = np.asarray(array)
    if len(places) == 1:
        return _linear(calls, whole, places[0], message, fixed)
    whole = fold_dimensions(whole, len(places))
    for axis, held in enumerate(places):
        chosen, at = resolve_index(calls, held, whole.shape[axis], message)
        check_within(at, whole.shape[axis], whole, message)
        if chosen is None:
            whole = np.take(whole, at, axis=axis)
        elif fixed:
            raise ProgramError(f"the index of {message} depends on signals")
        else:
            parts = np.moveaxis(whole, axis, 0)
            calls.context.room(float(parts.size) * chosen.size)
            picked = [_select_at(calls, parts, int(node)) for node in chosen.ravel(order="F")]
            whole = np.moveaxis(np.stack(picked), 0, axis)
    while whole.ndim > 2 and whole.shape[-1] == 1:
        whole = whole[..., 0]
    return whole


def fold_dimensions(array: Nodes, count: int) -> Nodes:
    """Return the array reshaped to the number of its indices."""
    shape = (*array.shape, *(1,) * (count - array.ndim))
    return array.reshape((*shape[: count - 1], int(np.prod(shape[count - 1 :]))), order="F")


def _linear(calls: "ExpressionEvaluator", array: Nodes, held: SymbolicValue, message: str, fixed: bool) -> Nodes:
    """Select elements by linear indices, in column-major order."""
    flat = array.ravel(order="F")
    if isinstance(held, str):
        return flat.reshape(-1, 1)
    chosen, at = resolve_index(calls, held, flat.size, message)
    check_within(at, flat.size, array, message)
    shape = _shape(array, as_array(held), len(at))
    if chosen is None:
        return flat[at].reshape(shape, order="F")
    if fixed:
        raise ProgramError(f"the index of {message} depends on signals")
    calls.context.room(float(flat.size) * chosen.size)
    result = np.array([_select_at(calls, flat, int(node)) for node in chosen.ravel(order="F")], dtype=np.int64)
    return result.reshape(shape, order="F")


def _shape(array: Nodes, place: Nodes, count: int) -> tuple[int, ...]:
    """Return the shape of linearly indexed elements: that of the indices; for vectors, along the array's direction."""
    if isinstance(place, LogicalNodes) and place.shape != array.shape and 1 not in place.shape:
        return (count, 1)
    if isinstance(place, LogicalNodes) or (1 in place.shape and 1 in array.shape and array.ndim == 2):
        if array.shape[0] == 1 and array.size != 1:
            return (1, count)
        if array.shape[1] == 1 and array.size != 1:
            return (count, 1)
    if isinstance(place, LogicalNodes):
        return (1, count) if place.shape[0] == 1 else (count, 1)
    return place.shape


def resolve_index(calls: "ExpressionEvaluator", held: SymbolicValue, size: int, message: str) -> Place:
    """Return zero-based indices, or their nodes if they depend on signals."""
    if isinstance(held, str):
        if held == ":":
            return None, list(range(size))
        raise ProgramError(f"the index of {message} is a text")
    nodes = as_array(held, f"the index of {message}")
    numbers = calls.context.numbers(nodes, f"an index of {message}")
    if isinstance(nodes, LogicalNodes):
        if numbers is None:
            raise ProgramError(f"a mask on {message} depends on signals", MASK_REMEDY)
        return None, [int(at) for at in np.flatnonzero(numbers.ravel(order="F"))]
    if numbers is None:
        return nodes, [0] * nodes.size
    flat = numbers.ravel(order="F")
    if not np.all(np.isfinite(flat)):
        raise ProgramError(f"the index {flat[~np.isfinite(flat)][0]:g} of {message} is not an integer")
    return None, [int(round_half_away(at)) - 1 for at in flat]


def check_within(at: list[int], size: int, array: Nodes, message: str) -> None:
    """Raise `ProgramError` if zero-based indices exceed a size."""
    wrong = next((item for item in at if not 0 <= item < size), None)
    if wrong is not None and size + len(at) > 0:
        raise ProgramError(f"index {wrong + 1} of {message} exceeds its size {format_size(array)}")


def _select_at(calls: "ExpressionEvaluator", parts: Nodes, node: int) -> Nodes:
    """Select the part at a signal-dependent index; NaN out of range, where MATLAB raises an error."""
    builder = calls.builder
    at = np.full(parts.shape[1:], builder.call("round", node), dtype=np.int64)
    result = np.full(parts.shape[1:], builder.const(float("nan")), dtype=np.int64)
    for number in range(parts.shape[0], 0, -1):
        result = elementwise(
            builder,
            "select",
            elementwise(builder, "eq", at, constants(builder, number).reshape(())),
            parts[number - 1],
            result,
        )
    return result


def format_size(array: Nodes) -> str:
    """Return the size of an array for a message."""
    return "x".join(map(str, array.shape))


def assign_part(
    calls: "ExpressionEvaluator", old: SymbolicValue | None, target: m.Expression, value: SymbolicValue
) -> SymbolicValue:
    """Return a variable (None if new) after an assignment to a part of it."""
    match target:
        case m.Name():
            return value
        case m.Field(of, name):
            return _change_part(calls, old, of, lambda held: _with_field(held, name, value))
        case m.DynamicField(of, tree):
            key = calls.value(tree)
            if not isinstance(key, str):
                raise ProgramError("the name of a field is not a text")
            return _change_part(calls, old, of, lambda held: _with_field(held, key, value))
        case m.Call(of, arguments):
            return _change_part(calls, old, of, lambda held: _with_elements(calls, held, arguments, value))
        case m.CellIndex(of, arguments):
            return _change_part(calls, old, of, lambda held: _with_cell(calls, held, arguments, value))
    raise ProgramError("the target of an assignment is not a variable")


def _change_part(
    calls: "ExpressionEvaluator", old: SymbolicValue | None, of: m.Expression, change: Change
) -> SymbolicValue:
    """Change a part of a variable and return the variable."""
    if isinstance(of, m.Name):
        return change(old)
    return assign_part(calls, old, of, change(_part(calls, old, of)))


def _part(calls: "ExpressionEvaluator", old: SymbolicValue | None, tree: m.Expression) -> SymbolicValue | None:
    """Return the part of a variable that an assignment changes; None if it is new."""
    match tree:
        case m.Name():
            return old
        case m.Field(of, name):
            around = _part(calls, old, of)
            return field_of(around, name) if isinstance(around, SymbolicStruct) and name in around.fields else None
        case m.Call(of, arguments):
            around = _part(calls, old, of)
            return None if around is None else index_value(calls, around, arguments, "it")
    raise ProgramError("assignment to a part of a cell is not supported")


def _with_field(held: SymbolicValue | None, name: str, value: SymbolicValue) -> SymbolicStruct:
    if held is None or (isinstance(held, np.ndarray) and held.size == 0):
        return SymbolicStruct({name: value})
    if not isinstance(held, SymbolicStruct):
        raise ProgramError(f"assignment to the field {name} of {describe(held)}")
    return SymbolicStruct({**held.fields, name: value})


def _with_cell(
    calls: "ExpressionEvaluator", held: SymbolicValue | None, trees: Sequence[m.Expression], value: SymbolicValue
) -> SymbolicCell:
    cells = held if isinstance(held, SymbolicCell) else SymbolicCell((), (0, 0))
    whole = np.arange(len(cells.cells), dtype=np.int64).reshape(cells.shape, order="F")
    places = [calls.context.numbers(as_array(item), "the index of a cell") for item in calls.arguments(whole, trees)]
    at = [int(item.item()) - 1 for item in places if item is not None and item.size == 1]
    if len(at) != len(trees):
        raise ProgramError("the index of a cell is not a constant scalar")
    is_row = len(cells.shape) == 2 and min(cells.shape) < 2
    if at == [len(cells.cells)] and is_row:  # one more, behind the last
        rows, columns = cells.shape
        shape = (rows + 1, 1) if columns == 1 and rows > 1 else (1, len(cells.cells) + 1)
        return SymbolicCell((*cells.cells, value), shape)
    result = list(cells.cells)
    result[fixed_element(whole, at)] = value
    return SymbolicCell(tuple(result), cells.shape)


def _with_elements(
    calls: "ExpressionEvaluator", held: SymbolicValue | None, trees: Sequence[m.Expression], value: SymbolicValue
) -> SymbolicValue:
    if isinstance(held, SymbolicStruct) or isinstance(value, SymbolicStruct):
        if all(is_one(calls, tree) for tree in trees):
            return value
        raise ProgramError("arrays of structs are not supported")
    old = EMPTY if held is None else as_array(held, "the target of an assignment")
    new = as_array(value, "the assigned value")
    if isinstance(held, LogicalNodes) and not isinstance(new, LogicalNodes):
        new = as_logical(elementwise(calls.builder, "ne", new, constants(calls.builder, 0.0)))
    places = calls.arguments(old, trees)
    if new.size == 0:
        raise ProgramError("deleting elements is not supported")
    result = _written(calls, np.asarray(old), places, np.asarray(new))
    logical = isinstance(new, LogicalNodes) and (held is None or (isinstance(held, LogicalNodes) and held.size > 0))
    return as_logical(result) if logical else integers(result, word_of(new if old.size == 0 else old))


def _written(calls: "ExpressionEvaluator", old: Nodes, places: list[SymbolicValue], new: Nodes) -> Nodes:
    if len(places) == 1 and isinstance(places[0], LogicalNodes) and places[0].shape == old.shape:
        mask = places[0]
        if calls.context.numbers(mask, "a mask") is None:
            return _masked(calls, old, mask, new)
    sizes = [old.size] if len(places) == 1 else list(fold_dimensions(old, len(places)).shape)
    result = [resolve_index(calls, place, size, "it") for place, size in zip(places, sizes, strict=True)]
    if len(places) > 1 and old.size == 0:
        result = [_whole(place, at, new, axis) for axis, (place, at) in enumerate(zip(places, result, strict=True))]
    if all(chosen is None for chosen, _ in result):
        return _assign_fixed(calls, old, [at for _, at in result], new)
    for (_, at), size in zip(result, sizes, strict=True):
        check_within(at, size, old, "the target of an assignment")
    return _assign_one_by_one(calls, old, result, new)


def _assign_one_by_one(calls: "ExpressionEvaluator", old: Nodes, places: list[Place], new: Nodes) -> Nodes:
    """Assign elements at indices of which some depend on signals, one after the other."""
    sizes = [chosen.size if chosen is not None else len(at) for chosen, at in places]
    _check_count(new, int(np.prod(sizes)))
    calls.context.room(float(old.size) * float(np.prod(sizes)))
    values = np.broadcast_to(new.reshape(()), sizes) if new.size == 1 else new.reshape(sizes, order="F")
    for which in np.ndindex(*sizes):
        places_of_one = [_single(place, at) for place, at in zip(places, which, strict=True)]
        old = _assign_selected(calls, old, places_of_one, int(values[which]))
    return old


def _check_count(new: Nodes, count: int) -> None:
    if new.size not in (1, count):
        raise ProgramError(f"{new.size} elements are assigned to {count} indices")


def _single(place: Place, at: int) -> Place:
    chosen, fixed = place
    return (None, [fixed[at]]) if chosen is None else (chosen.ravel(order="F")[at : at + 1], [0])


def _whole(place: SymbolicValue, found: Place, new: Nodes, axis: int) -> Place:
    """Resolve `:` in an assignment to a new variable by the size of the value."""
    if not isinstance(place, str):
        return found
    return None, list(range(new.shape[axis] if new.ndim > axis and new.size > 1 else 1))


def _masked(calls: "ExpressionEvaluator", old: Nodes, mask: Nodes, new: Nodes) -> Nodes:
    if new.size != 1:
        raise ProgramError("several elements are assigned through a mask that depends on signals", MASK_REMEDY)
    return elementwise(calls.builder, "select", np.asarray(mask), np.broadcast_to(new.reshape(()), old.shape), old)


def _assign_fixed(calls: "ExpressionEvaluator", old: Nodes, places: list[list[int]], new: Nodes) -> Nodes:
    """Assign elements at fixed indices; the array grows to hold them."""
    if any(item < 0 for at in places for item in at):
        raise ProgramError("assignment to an index below 1")
    result = _grow(calls, old, places)
    _check_count(new, int(np.prod([len(at) for at in places])))
    if len(places) == 1:
        flat = result.ravel(order="F")
        flat[places[0]] = new.ravel(order="F")
        return flat.reshape(result.shape, order="F")
    if new.size > 1 and [n for n in new.shape if n > 1] != [len(at) for at in places if len(at) > 1]:
        wanted = "x".join(str(len(at)) for at in places)
        raise ProgramError(f"an array of size {format_size(new)} is assigned to indices of size {wanted}")
    sides = fold_dimensions(result, len(places)).copy()
    block = new.reshape(()) if new.size == 1 else new.reshape([len(at) for at in places], order="F")
    sides[np.ix_(*places)] = block
    return sides.reshape(result.shape, order="F")


def _grow(calls: "ExpressionEvaluator", old: Nodes, places: list[list[int]]) -> Nodes:
    """Return a copy that is large enough, with new elements 0."""
    ends = [max(at, default=-1) + 1 for at in places]
    shape = _grown_vector_shape(old, ends[0]) if len(places) == 1 else _grown_shape(old, ends)
    if shape is None:
        return old.copy()
    calls.context.room(float(np.prod(shape)))
    result = np.full(shape, calls.builder.const(0.0), dtype=np.int64)
    if old.size:
        kept = old.reshape((*old.shape, *(1,) * (len(shape) - old.ndim)))
        result[tuple(slice(size) for size in kept.shape)] = kept
    return result


def _grown_vector_shape(old: Nodes, end: int) -> tuple[int, ...] | None:
    """Return the shape of a vector with this many elements; None if it has them."""
    if end <= old.size:
        return None
    if old.size > 1 and 1 not in old.shape:
        raise ProgramError(f"index {end} exceeds an array of size {format_size(old)}")
    return (end, 1) if old.ndim == 2 and old.shape[1] == 1 and old.size > 1 else (1, end)


def _grown_shape(old: Nodes, ends: list[int]) -> tuple[int, ...] | None:
    """Return the shape of an array of at least these sizes; None if it has them."""
    base = (*old.shape, *(1,) * (len(ends) - old.ndim))
    if len(ends) < old.ndim or all(end <= size for end, size in zip(ends, base, strict=True)):
        return None
    return tuple(max(pair) for pair in zip(ends, base, strict=True))


def _assign_selected(calls: "ExpressionEvaluator", old: Nodes, places: list[Place], new: int) -> Nodes:
    """Assign one element at a signal-dependent index: each element is replaced if the index is its own.

    Out of range, where MATLAB raises an error, nothing changes.
    """
    builder = calls.builder
    shape, whole = old.shape, old.ravel(order="F") if len(places) == 1 else fold_dimensions(old, len(places))
    calls.context.room(whole.size)
    result = whole.copy()
    for at in np.ndindex(*whole.shape):
        here = builder.const(1.0)
        for axis, (chosen, fixed) in enumerate(places):
            node = builder.const(float(fixed[0] + 1)) if chosen is None else builder.call("round", int(chosen.item()))
            same = builder.call("eq", node, builder.const(float(at[axis] + 1)))
            here = builder.call("and", here, same) if builder.value(here) != 1.0 else same
        result[at] = builder.call("select", here, new, int(whole[at]))
    return result.reshape(shape, order="F")
