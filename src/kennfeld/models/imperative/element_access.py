"""Indexing and indexed assignment; an index that depends on signals selects among all elements."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.matlab.errors import Budget
from kennfeld.matlab.indexing import assign_elements
from kennfeld.matlab.values import MatlabValueError, trim_dimensions
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, elementwise, format_sizes
from kennfeld.models.imperative.path_facts import round_half_away
from kennfeld.program import tree as m

MASK_REMEDY = "Write it as a loop over all elements with if."
Place = tuple[Nodes | None, list[int]]  # nodes of places that depend on signals; else fixed places, from 0

Change = Callable[[s.SymbolicValue | None], s.SymbolicValue]


def fixed_element(array: Nodes, at: Sequence[int]) -> int:
    """Return the element at zero-based indices; raises `ProgramError` if out of range."""
    try:
        if min(at) < 0:
            raise IndexError
        result = array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
    except IndexError:
        places = ",".join(str(item + 1) for item in at)
        raise ProgramError(f"index ({places}) exceeds an array of size {format_sizes(array)}") from None
    return int(result)


def cell_indices(evaluator: SymbolicEvaluator, whole: Nodes, trees: Sequence[m.Expression]) -> list[int]:
    """Evaluate the indices, from 0, of an element of a cell array; raises `ProgramError` unless they are constant."""
    indices = map(s.as_array, evaluator.index_values(whole, trees))
    numbers = [evaluator.context.numbers(index, "the index of a cell") for index in indices]
    at = [int(number.item()) - 1 for number in numbers if number is not None and number.size == 1]
    if len(at) < len(trees):
        raise ProgramError("the index of a cell is not a constant scalar")
    return at


def index_value(
    evaluator: SymbolicEvaluator, value: s.SymbolicValue, trees: Sequence[m.Expression], message: str
) -> s.SymbolicValue:
    """Evaluate `value(trees)`."""
    if isinstance(value, s.SymbolicCell):
        whole = np.arange(len(value.cells), dtype=np.int64).reshape(value.shape, order="F")
        chosen = _elements(evaluator, whole, evaluator.index_values(whole, trees), message, fixed=True)
        return s.SymbolicCell(tuple(value.cells[int(at)] for at in chosen.ravel(order="F")), chosen.shape)
    if isinstance(value, s.String) and all(is_one(evaluator, tree) for tree in trees):
        return value
    if isinstance(value, str):
        text = np.array([[ord(item) for item in value]], dtype=np.int64)
        chosen = _elements(evaluator, text, evaluator.index_values(text, trees), message, fixed=True)
        return "".join(chr(int(item)) for item in chosen.ravel(order="F"))
    if isinstance(value, s.SymbolicStruct) and all(is_one(evaluator, tree) for tree in trees):
        return value
    array = s.as_array(value, message)
    if not trees:
        return array
    places = evaluator.index_values(array, trees)
    if _is_mask(evaluator, array, places):
        return array
    return s.of_class(array, _elements(evaluator, array, places, message))


def _is_mask(evaluator: SymbolicEvaluator, array: Nodes, places: list[s.SymbolicValue]) -> bool:
    """Return True if elements are selected by the mask of the statement, so that all elements may stand for them."""
    mask = evaluator.mask
    if mask is None or len(places) != 1 or array.shape != mask.shape:
        return False
    return isinstance(places[0], s.LogicalNodes) and np.array_equal(places[0], mask)


def is_one(evaluator: SymbolicEvaluator, tree: m.Expression) -> bool:
    """Return True if an index of one element selects that element."""
    return isinstance(tree, m.Colon | m.End) or evaluator.number(tree) == 1


def _elements(
    evaluator: SymbolicEvaluator, array: Nodes, places: list[s.SymbolicValue], message: str, fixed: bool = False
) -> Nodes:
    whole = np.asarray(array)
    if len(places) == 1:
        return _linear(evaluator, whole, places[0], message, fixed)
    whole = fold_dimensions(whole, len(places))
    for axis, value in enumerate(places):
        chosen, at = resolve_index(evaluator, value, whole.shape[axis], message)
        check_within(at, whole.shape[axis], whole, message)
        if chosen is None:
            whole = np.take(whole, at, axis=axis)
        elif fixed:
            raise ProgramError(f"the index of {message} depends on signals")
        else:
            parts = np.moveaxis(whole, axis, 0)
            evaluator.context.room(float(parts.size) * chosen.size)
            picked = [_select_at(evaluator, parts, int(node)) for node in chosen.ravel(order="F")]
            whole = np.moveaxis(np.stack(picked), 0, axis)
    return trim_dimensions(whole)


def fold_dimensions(array: Nodes, count: int) -> Nodes:
    """Return the array reshaped to the number of its indices."""
    shape = (*array.shape, *(1,) * (count - array.ndim))
    return array.reshape((*shape[: count - 1], int(np.prod(shape[count - 1 :]))), order="F")


def _linear(evaluator: SymbolicEvaluator, array: Nodes, value: s.SymbolicValue, message: str, fixed: bool) -> Nodes:
    """Select elements by linear indices, in column-major order."""
    flat = array.ravel(order="F")
    if isinstance(value, str):
        return flat.reshape(-1, 1)
    chosen, at = resolve_index(evaluator, value, flat.size, message)
    check_within(at, flat.size, array, message)
    shape = _shape(array, s.as_array(value), len(at))
    if chosen is None:
        return flat[at].reshape(shape, order="F")
    if fixed:
        raise ProgramError(f"the index of {message} depends on signals")
    evaluator.context.room(float(flat.size) * chosen.size)
    result = np.array([_select_at(evaluator, flat, int(node)) for node in chosen.ravel(order="F")], dtype=np.int64)
    return result.reshape(shape, order="F")


def _shape(array: Nodes, place: Nodes, count: int) -> tuple[int, ...]:
    """Return the shape of linearly indexed elements: that of the indices; for vectors, along the array's direction."""
    if isinstance(place, s.LogicalNodes) and place.shape != array.shape and 1 not in place.shape:
        return (count, 1)
    if isinstance(place, s.LogicalNodes) or (1 in place.shape and 1 in array.shape and array.ndim == 2):
        if array.shape[0] == 1 and array.size != 1:
            return (1, count)
        if array.shape[1] == 1 and array.size != 1:
            return (count, 1)
    if isinstance(place, s.LogicalNodes):
        return (1, count) if place.shape[0] == 1 else (count, 1)
    return place.shape


def resolve_index(evaluator: SymbolicEvaluator, value: s.SymbolicValue, size: int, message: str) -> Place:
    """Return zero-based indices, or their nodes if they depend on signals."""
    if isinstance(value, str):
        if value == ":":
            return None, list(range(size))
        raise ProgramError(f"the index of {message} is a text")
    nodes = s.as_array(value, f"the index of {message}")
    numbers = evaluator.context.numbers(nodes, f"an index of {message}")
    if isinstance(nodes, s.LogicalNodes):
        if numbers is None:
            raise ProgramError(f"a mask on {message} depends on signals", MASK_REMEDY)
        return None, [int(at) for at in np.flatnonzero(numbers.ravel(order="F"))]
    if numbers is None:
        return nodes, [0] * nodes.size
    flat = numbers.ravel(order="F")
    if evaluator.context.single_elements:
        if flat.size != 1:
            raise ProgramError("it selects several elements of an array")
        if not float(flat[0]).is_integer():
            raise EvaluationError(f"an index must be an integer, got {flat[0]:g}")
    if not np.all(np.isfinite(flat)):
        raise ProgramError(f"the index {flat[~np.isfinite(flat)][0]:g} of {message} is not an integer")
    return None, [int(round_half_away(at)) - 1 for at in flat]


def check_within(at: list[int], size: int, array: Nodes, message: str) -> None:
    """Raise `ProgramError` if zero-based indices exceed a size."""
    wrong = next((item for item in at if not 0 <= item < size), None)
    if wrong is not None and size + len(at) > 0:
        raise ProgramError(f"index {wrong + 1} of {message} exceeds its size {format_sizes(array)}")


def _select_at(evaluator: SymbolicEvaluator, parts: Nodes, node: int) -> Nodes:
    """Select the part at a signal-dependent index; NaN out of range, where MATLAB raises an error."""
    apply, rounded = Elementwise(evaluator.builder), evaluator.builder.call("round", node)
    at = np.full(parts.shape[1:], rounded, dtype=np.int64)
    result = np.full(parts.shape[1:], evaluator.builder.const(math.nan), dtype=np.int64)
    for number in range(parts.shape[0], 0, -1):
        result = apply("select", apply("eq", at, float(number)), parts[number - 1], result)
    return result


def assign_part(
    evaluator: SymbolicEvaluator, old: s.SymbolicValue | None, target: m.Expression, value: s.SymbolicValue
) -> s.SymbolicValue:
    """Return a variable (None if new) after an assignment to a part of it."""
    match target:
        case m.Name():
            return value
        case m.Field(of, name):
            return _change_part(evaluator, old, of, lambda current: _with_field(current, name, value))
        case m.DynamicField(of, tree):
            key = evaluator.value(tree)
            if not isinstance(key, str):
                raise ProgramError("the name of a field is not a text")
            return _change_part(evaluator, old, of, lambda current: _with_field(current, key, value))
        case m.Call(of, arguments) | m.CellIndex(of, arguments):
            change = _with_cell if isinstance(target, m.CellIndex) else _with_elements
            return _change_part(evaluator, old, of, lambda current: change(evaluator, current, arguments, value))
    raise ProgramError("the target of an assignment is not a variable")


def _change_part(
    evaluator: SymbolicEvaluator, old: s.SymbolicValue | None, of: m.Expression, change: Change
) -> s.SymbolicValue:
    """Change a part of a variable and return the variable."""
    if isinstance(of, m.Name):
        return change(old)
    return assign_part(evaluator, old, of, change(_part(evaluator, old, of)))


def _part(evaluator: SymbolicEvaluator, old: s.SymbolicValue | None, tree: m.Expression) -> s.SymbolicValue | None:
    """Return the part of a variable that an assignment changes; None if it is new."""
    match tree:
        case m.Name():
            return old
        case m.Field(of, name):
            around = _part(evaluator, old, of)
            return s.field_of(around, name) if isinstance(around, s.SymbolicStruct) and name in around.fields else None
        case m.Call(of, arguments):
            around = _part(evaluator, old, of)
            return None if around is None else index_value(evaluator, around, arguments, "it")
    raise ProgramError("assignment to a part of a cell is not supported")


def _with_field(current: s.SymbolicValue | None, name: str, value: s.SymbolicValue) -> s.SymbolicStruct:
    if current is None or (isinstance(current, np.ndarray) and current.size == 0):
        return s.SymbolicStruct({name: value})
    if not isinstance(current, s.SymbolicStruct):
        raise ProgramError(f"assignment to the field {name} of {s.describe(current)}")
    return s.SymbolicStruct({**current.fields, name: value})


def _with_cell(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, trees: Sequence[m.Expression], value: s.SymbolicValue
) -> s.SymbolicCell:
    cells = current if isinstance(current, s.SymbolicCell) else s.SymbolicCell((), (0, 0))
    whole = np.arange(len(cells.cells), dtype=np.int64).reshape(cells.shape, order="F")
    at = cell_indices(evaluator, whole, trees)
    is_row = len(cells.shape) == 2 and min(cells.shape) < 2
    if at == [len(cells.cells)] and is_row:  # one more, behind the last
        rows, columns = cells.shape
        shape = (rows + 1, 1) if columns == 1 and rows > 1 else (1, len(cells.cells) + 1)
        return s.SymbolicCell((*cells.cells, value), shape)
    result = list(cells.cells)
    result[fixed_element(whole, at)] = value
    return s.SymbolicCell(tuple(result), cells.shape)


def _with_elements(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, trees: Sequence[m.Expression], value: s.SymbolicValue
) -> s.SymbolicValue:
    if isinstance(current, s.SymbolicStruct) or isinstance(value, s.SymbolicStruct):
        if all(is_one(evaluator, tree) for tree in trees):
            return value
        raise ProgramError("arrays of structs are not supported")
    old = s.EMPTY if current is None else s.as_array(current, "the target of an assignment")
    new = s.as_array(value, "the assigned value")
    if isinstance(current, s.LogicalNodes) and not isinstance(new, s.LogicalNodes):
        new = s.as_logical(elementwise(evaluator.builder, "ne", new, 0.0))
    places = evaluator.index_values(old, trees)
    if new.size == 0:
        raise ProgramError("deleting elements is not supported")
    result = _written(evaluator, np.asarray(old), places, np.asarray(new))
    keeps_logical = current is None or (isinstance(current, s.LogicalNodes) and current.size > 0)
    logical = isinstance(new, s.LogicalNodes) and keeps_logical
    return s.as_logical(result) if logical else s.integers(result, s.word_of(new if old.size == 0 else old))


def _written(evaluator: SymbolicEvaluator, old: Nodes, places: list[s.SymbolicValue], new: Nodes) -> Nodes:
    if len(places) == 1 and isinstance(places[0], s.LogicalNodes) and places[0].shape == old.shape:
        mask = places[0]
        if evaluator.context.numbers(mask, "a mask") is None:
            if new.size != 1:
                raise ProgramError("several elements are assigned through a mask that depends on signals", MASK_REMEDY)
            value = np.broadcast_to(new.reshape(()), old.shape)
            return elementwise(evaluator.builder, "select", np.asarray(mask), value, old)
    sizes = [old.size] if len(places) == 1 else list(fold_dimensions(old, len(places)).shape)
    result = [resolve_index(evaluator, place, size, "it") for place, size in zip(places, sizes, strict=True)]
    if len(places) > 1 and old.size == 0:
        result = [_whole(place, at, new, axis) for axis, (place, at) in enumerate(zip(places, result, strict=True))]
    if all(chosen is None for chosen, _ in result):
        return _assign_fixed(evaluator, old, [at for _, at in result], new)
    for (_, at), size in zip(result, sizes, strict=True):
        check_within(at, size, old, "the target of an assignment")
    return _assign_one_by_one(evaluator, old, result, new)


def _assign_one_by_one(evaluator: SymbolicEvaluator, old: Nodes, places: list[Place], new: Nodes) -> Nodes:
    """Assign elements at indices of which some depend on signals, one after the other."""
    sizes = [chosen.size if chosen is not None else len(at) for chosen, at in places]
    _check_count(new, int(np.prod(sizes)))
    evaluator.context.room(float(old.size) * float(np.prod(sizes)))
    values = np.broadcast_to(new.reshape(()), sizes) if new.size == 1 else new.reshape(sizes, order="F")
    for which in np.ndindex(*sizes):
        places_of_one = [_single(place, at) for place, at in zip(places, which, strict=True)]
        old = _assign_selected(evaluator, old, places_of_one, int(values[which]))
    return old


def _check_count(new: Nodes, count: int) -> None:
    if new.size not in (1, count):
        raise ProgramError(f"{new.size} elements are assigned to {count} indices")


def _single(place: Place, at: int) -> Place:
    chosen, fixed = place
    return (None, [fixed[at]]) if chosen is None else (chosen.ravel(order="F")[at : at + 1], [0])


def _whole(place: s.SymbolicValue, result: Place, new: Nodes, axis: int) -> Place:
    """Resolve `:` in an assignment to a new variable by the size of the value."""
    if not isinstance(place, str):
        return result
    return None, list(range(new.shape[axis] if new.ndim > axis and new.size > 1 else 1))


def _assign_fixed(evaluator: SymbolicEvaluator, old: Nodes, places: list[list[int]], new: Nodes) -> Nodes:
    """Assign elements at fixed indices; the array grows to hold them, with new elements 0."""
    if any(item < 0 for at in places for item in at):
        raise ProgramError("assignment to an index below 1")
    _check_count(new, math.prod(map(len, places)))
    evaluator.context.room(math.prod(float(max(at, default=0)) for at in places))
    indices = [np.array([at], dtype=np.float64) + 1 for at in places]
    try:
        return assign_elements(old, indices, new, evaluator.builder.const(0.0), Budget())
    except MatlabValueError as error:
        raise ProgramError(f"assignment to an array of size {format_sizes(old)}: {error}") from None


def _assign_selected(evaluator: SymbolicEvaluator, old: Nodes, places: list[Place], new: int) -> Nodes:
    """Assign one element at a signal-dependent index: each element is replaced if the index is its own.

    Out of range, where MATLAB raises an error, nothing changes.
    """
    builder = evaluator.builder
    whole = old.ravel(order="F") if len(places) == 1 else fold_dimensions(old, len(places))
    evaluator.context.room(whole.size)
    result = whole.copy()
    for at in np.ndindex(*whole.shape):
        here = builder.const(1.0)
        for axis, (chosen, fixed) in enumerate(places):
            node = builder.const(float(fixed[0] + 1)) if chosen is None else builder.call("round", int(chosen.item()))
            same = builder.call("eq", node, builder.const(float(at[axis] + 1)))
            here = builder.call("and", here, same) if builder.value(here) != 1.0 else same
        result[at] = builder.call("select", here, new, int(whole[at]))
    return result.reshape(old.shape, order="F")
