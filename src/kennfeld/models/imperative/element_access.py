"""Indexing and indexed assignment; an index that depends on signals selects among all elements."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.matlab.errors import Budget
from kennfeld.matlab.indexing import assign_elements, fold_shape, linear_shape
from kennfeld.matlab.values import (
    Array,
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    object_array,
    scalar,
    trim_dimensions,
)
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, elementwise, format_sizes
from kennfeld.models.imperative.path_facts import round_half_away
from kennfeld.program import tree as m

MASK_REMEDY = "Write it as a loop over all elements with if."
Place = tuple[Nodes | None, list[int]]  # nodes of places that depend on signals; else fixed places, from 0


def fixed_element(array: Array, at: Sequence[int]) -> Any:
    """Return the element at zero-based indices; raises `ProgramError` if out of range."""
    try:
        if min(at) < 0:
            raise IndexError
        return array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
    except IndexError:
        places = ",".join(str(item + 1) for item in at)
        raise ProgramError(f"index ({places}) exceeds an array of size {format_sizes(array)}") from None


def cell_indices(
    evaluator: SymbolicEvaluator, whole: Array, trees: Sequence[m.Expression], kind: str = "a cell"
) -> list[int]:
    """Evaluate the indices, from 0, of an element of a cell array; raises `ProgramError` unless they are constant."""
    indices = map(s.as_array, evaluator.index_values(whole, trees))
    numbers = [evaluator.context.numbers(index, f"the index of {kind}") for index in indices]
    at = [int(number.item()) - 1 for number in numbers if number is not None and np.isfinite(number).sum() == 1]
    if len(at) < len(trees):
        raise ProgramError(f"the index of {kind} is not a constant scalar")
    return at


def index_value(
    evaluator: SymbolicEvaluator, value: s.SymbolicValue, trees: Sequence[m.Expression], message: str
) -> s.SymbolicValue:
    """Evaluate `value(trees)`."""
    if isinstance(value, MatlabCell):
        places = evaluator.index_values(value.values, trees)
        return MatlabCell(_elements(evaluator, value.values, places, message, fixed=True))
    if isinstance(value, s.String) and all(is_one(evaluator, tree) for tree in trees):
        return value
    if isinstance(value, str):
        text = np.array([[ord(item) for item in value]], dtype=np.int64)
        chosen = _elements(evaluator, text, evaluator.index_values(text, trees), message, fixed=True)
        return "".join(chr(int(item)) for item in chosen.ravel(order="F"))
    if isinstance(value, MatlabStruct):
        if value.elements.size == 1 and all(is_one(evaluator, tree) for tree in trees):
            return value
        places = evaluator.index_values(value.elements, trees)
        chosen = _elements(evaluator, value.elements, places, message, fixed=True)
        return MatlabStruct(chosen, value.names, value.kind)
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
    evaluator: SymbolicEvaluator, array: Array, places: list[s.SymbolicValue], message: str, fixed: bool = False
) -> Array:
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
    return array.reshape(fold_shape(array.shape, count), order="F")


def _linear(evaluator: SymbolicEvaluator, array: Nodes, value: s.SymbolicValue, message: str, fixed: bool) -> Nodes:
    """Select elements by linear indices, in column-major order."""
    flat = array.ravel(order="F")
    if isinstance(value, str):
        return flat.reshape(-1, 1)
    chosen, at = resolve_index(evaluator, value, flat.size, message)
    check_within(at, flat.size, array, message)
    indices = s.as_array(value)
    is_mask = isinstance(indices, s.LogicalNodes)
    shape = linear_shape(array, np.zeros(indices.shape, dtype=bool if is_mask else float), len(at))
    if chosen is None:
        return flat[at].reshape(shape, order="F")
    if fixed:
        raise ProgramError(f"the index of {message} depends on signals")
    evaluator.context.room(float(flat.size) * chosen.size)
    result = np.array([_select_at(evaluator, flat, int(node)) for node in chosen.ravel(order="F")], dtype=np.int64)
    return result.reshape(shape, order="F")


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


def field_name(evaluator: SymbolicEvaluator, step: m.Field | m.DynamicField) -> str:
    """Return the name of a field, evaluated if it is dynamic."""
    name = step.name if isinstance(step, m.Field) else evaluator.value(step.name)
    if not isinstance(name, str):
        raise ProgramError("the name of a field is not a text")
    return name


def assign_part(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, steps: Sequence[m.Expression], value: s.SymbolicValue
) -> s.SymbolicValue:
    """Return a value (None if new) with `value` assigned to the part that the accesses `steps` select."""
    if not steps:
        return value
    step, rest = steps[0], steps[1:]
    match step:
        case m.Field() | m.DynamicField():
            name = field_name(evaluator, step)
            is_known = isinstance(current, MatlabStruct) and name in current.fields
            inner = s.field_of(current, name) if is_known and current is not None else None
            return _with_field(current, name, assign_part(evaluator, inner, rest, value))
        case m.CellIndex(_, arguments) if not rest:
            return _with_cell(evaluator, current, arguments, value)
        case m.Call(_, arguments):
            if rest:
                inner = _known_element(evaluator, current, arguments)
                value = assign_part(evaluator, inner, rest, value)
            return _with_elements(evaluator, current, arguments, value)
    raise ProgramError("assignment to a part of a cell is not supported")


def _with_field(current: s.SymbolicValue | None, name: str, value: s.SymbolicValue) -> MatlabStruct:
    if current is None or (isinstance(current, np.ndarray) and current.size == 0):
        return MatlabStruct.of({name: value})
    if not isinstance(current, MatlabStruct):
        raise ProgramError(f"assignment to the field {name} of {s.describe(current)}")
    s.check_single(current)
    return MatlabStruct.of({**current.fields, name: value})


def _with_cell(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, trees: Sequence[m.Expression], value: s.SymbolicValue
) -> MatlabCell:
    cells = current.values if isinstance(current, MatlabCell) else np.empty((0, 0), dtype=object)
    at = cell_indices(evaluator, cells, trees)
    if at != [cells.size]:  # not one more, behind the last
        fixed_element(cells, at)
    try:
        return MatlabCell(
            assign_elements(
                cells, [scalar(place + 1) for place in at], object_array([value], (1, 1)), s.EMPTY, Budget()
            )
        )
    except MatlabValueError as error:
        raise ProgramError(f"assignment to a cell array of size {format_sizes(cells)}: {error}") from None


def _with_elements(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, trees: Sequence[m.Expression], value: s.SymbolicValue
) -> s.SymbolicValue:
    if isinstance(current, MatlabStruct) or isinstance(value, MatlabStruct):
        return _with_struct(evaluator, current, trees, value)
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


def _known_element(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, trees: Sequence[m.Expression]
) -> s.SymbolicValue | None:
    """Return the element of which a part is assigned; None if the assignment makes it."""
    if current is None or (isinstance(current, np.ndarray) and current.size == 0):
        return None
    if isinstance(current, MatlabStruct):
        at = cell_indices(evaluator, current.elements, trees, "an array of structs")
        shape = (current.elements.size,) if len(at) == 1 else fold_shape(current.elements.shape, len(at))
        if any(place >= size for place, size in zip(at, shape, strict=True)):
            return None
    return index_value(evaluator, current, trees, "it")


def _with_struct(
    evaluator: SymbolicEvaluator, current: s.SymbolicValue | None, trees: Sequence[m.Expression], value: s.SymbolicValue
) -> MatlabStruct:
    """Return an array of structs with another element; all have the fields of each, which are empty at first."""
    if current is None or (isinstance(current, np.ndarray) and current.size == 0):
        current = MatlabStruct(np.empty((0, 0), dtype=object))
    if not isinstance(current, MatlabStruct) or not isinstance(value, MatlabStruct) or value.elements.size != 1:
        raise ProgramError(f"{s.describe(value)} is assigned to an element of {s.describe(current)}")
    at = cell_indices(evaluator, current.elements, trees, "an array of structs")
    names = dict.fromkeys((*current.fields, *value.fields))
    try:
        elements = assign_elements(
            current.elements, [scalar(place + 1) for place in at], object_array([value.fields], (1, 1)), {}, Budget()
        )
    except MatlabValueError as error:
        raise ProgramError(f"assignment to an array of structs: {error}") from None
    filled = [{name: fields.get(name, s.EMPTY) for name in names} for fields in elements.ravel(order="F")]
    whole = object_array(filled, (elements.size, 1)).reshape(elements.shape, order="F")
    return MatlabStruct(whole, tuple(names), current.kind)


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
