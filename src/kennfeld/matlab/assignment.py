"""Assignments to variables and their parts: fields, indices and cells, with growth."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.evaluator import NumericEvaluator
from kennfeld.matlab.indexing import Index, assign_elements, delete_elements, index_array
from kennfeld.matlab.operators import cast_to_class, result_class
from kennfeld.matlab.simulink_objects import default_properties
from kennfeld.matlab.traversal import access_chain
from kennfeld.matlab.values import (
    EMPTY,
    Array,
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    Value,
    array_value,
    class_name,
    elements_of,
    numbers,
    object_array,
    with_class_of,
)

_COPY = 3  # elements charged for the copy of a field or a cell
_NO_CELLS = MatlabCell(np.empty((0, 0), dtype=object))


def assign(evaluator: NumericEvaluator, target: m.Expression, value: Value) -> str:
    """Assign a value to a variable or a part of it; return the name of the variable."""
    base, steps = access_chain(target)
    assert isinstance(base, m.Name)
    name = base.name
    if not steps:
        evaluator.variables[name] = value
        evaluator.owned.pop(name, None)
        return name
    if name in evaluator.undefined:
        raise MatlabValueError(f"{name} is undefined: {evaluator.undefined[name]}")
    known = evaluator.variables.get(name)
    owned = known is not None and evaluator.owned.get(name) == id(known)
    result = _assign_part(evaluator, known, steps, value, owned)
    evaluator.variables[name] = result
    if isinstance(result, np.ndarray) and len(steps) == 1:
        evaluator.owned[name] = id(result)
    return name


def _assign_part(
    evaluator: NumericEvaluator, known: Value | None, steps: Sequence[m.Expression], value: Value, owned: bool
) -> Value:
    """Return a value with `value` assigned to the part that the accesses `steps` select."""
    if not steps:
        return value
    step, rest = steps[0], steps[1:]
    if isinstance(step, m.Field | m.DynamicField):
        return _assign_field(evaluator, known, evaluator.field_name(step), rest, value)
    holder = known if known is not None else _empty_for(step, rest, value)
    assert isinstance(step, m.Call | m.CellIndex)
    indices = evaluator.indices(step.arguments, holder)
    if isinstance(step, m.CellIndex):
        return _assign_cell(evaluator, holder, indices, rest, value)
    if rest:
        return _assign_in_element(evaluator, holder, indices, rest, value)
    return _assign_elements(evaluator, holder, indices, value, owned)


def _empty_for(step: m.Expression, rest: Sequence[m.Expression], value: Value) -> Value:
    """Return the empty value that an assignment to a part of a new variable begins with."""
    if isinstance(step, m.CellIndex):
        return _NO_CELLS
    if rest and isinstance(rest[0], m.CellIndex):
        return _NO_CELLS
    if rest:
        return MatlabStruct(object_array([], (0, 0)))
    if isinstance(value, MatlabCell):
        return _NO_CELLS
    if isinstance(value, MatlabStruct):
        return MatlabStruct(object_array([], (0, 0)), value.names, value.kind)
    return np.zeros((0, 0), dtype=value.dtype) if isinstance(value, np.ndarray) else EMPTY


def _assign_field(
    evaluator: NumericEvaluator, known: Value | None, name: str, rest: Sequence[m.Expression], value: Value
) -> Value:
    if known is None or (isinstance(known, np.ndarray) and not known.size):
        known = MatlabStruct.of({})
    if not isinstance(known, MatlabStruct):
        raise MatlabValueError(f"a {class_name(known)} has no field {name}")
    if known.elements.size != 1:
        raise MatlabValueError(f"expected one struct, got {known.elements.size}")
    evaluator.budget.allocate(_COPY * len(known.names))
    inner = _assign_part(evaluator, known.fields.get(name), rest, value, owned=False)
    return MatlabStruct.of({**known.fields, name: inner}, known.kind)


def _assign_cell(
    evaluator: NumericEvaluator, holder: Value, indices: Sequence[Index], rest: Sequence[m.Expression], value: Value
) -> Value:
    if isinstance(holder, np.ndarray) and not holder.size:
        holder = _NO_CELLS
    if not isinstance(holder, MatlabCell):
        raise MatlabValueError(f"a {class_name(holder)} cannot be indexed with braces")
    if rest:
        value = _assign_part(evaluator, _element(evaluator, holder, indices), rest, value, owned=False)
    evaluator.budget.allocate(_COPY * holder.values.size)
    return MatlabCell(_put(evaluator, holder.values, indices, object_array([value], (1, 1)), EMPTY))


def _element(evaluator: NumericEvaluator, holder: MatlabCell | MatlabStruct, indices: Sequence[Index]) -> Any:
    """Return the element at an index; None beyond the end."""
    data = elements_of(holder)
    try:
        elements = index_array(data, indices, evaluator.budget)
    except MatlabValueError:
        if not _are_places(indices):
            raise
        return None
    if elements.size != 1:
        raise MatlabValueError(f"expected one element, got {elements.size}")
    return elements.flat[0]


def _are_places(indices: Sequence[Index]) -> bool:
    return all(
        isinstance(index, np.ndarray) and index.dtype.kind in "fiu" and bool((index >= 1).all()) for index in indices
    )


def _assign_in_element(
    evaluator: NumericEvaluator, holder: Value, indices: Sequence[Index], rest: Sequence[m.Expression], value: Value
) -> Value:
    """`a(2).b = value`, or `a(2){1} = value`."""
    if isinstance(holder, np.ndarray) and not holder.size:
        holder = MatlabStruct(object_array([], (0, 0)))
    if isinstance(holder, MatlabCell):
        return _assign_cell(evaluator, holder, indices, rest[1:], value)
    if not isinstance(holder, MatlabStruct):
        raise MatlabValueError(f"a {class_name(holder)} has no fields")
    fields = _element(evaluator, holder, indices)
    element = MatlabStruct.of(default_properties(holder.kind) if fields is None else fields, holder.kind)
    changed = _assign_part(evaluator, element, rest, value, owned=False)
    assert isinstance(changed, MatlabStruct)
    return _assign_structs(evaluator, holder, indices, changed)


def _assign_structs(
    evaluator: NumericEvaluator, holder: MatlabStruct, indices: Sequence[Index], value: MatlabStruct
) -> MatlabStruct:
    """Assign structs to elements of a struct array; all elements get all fields."""
    names = tuple(dict.fromkeys((*holder.names, *value.names)))
    evaluator.budget.allocate(len(names))
    empty = dict.fromkeys(names, EMPTY) | {n: v for n, v in default_properties(holder.kind).items() if n in names}

    def complete(data: Array) -> Array:
        return object_array([{**empty, **fields} for fields in data.ravel(order="F")], data.shape)

    elements = holder.elements if set(names) == set(holder.names) else complete(holder.elements)
    put = _put(evaluator, elements, indices, complete(value.elements), empty)
    return MatlabStruct(put, names, holder.kind or value.kind)


def _assign_elements(
    evaluator: NumericEvaluator, holder: Value, indices: Sequence[Index], value: Value, owned: bool
) -> Value:
    is_nothing = isinstance(value, np.ndarray) and value.shape == (0, 0) and value.dtype == np.float64
    if is_nothing and elements_of(holder).size:
        return with_class_of(holder, delete_elements(elements_of(holder), indices))
    if isinstance(holder, MatlabStruct) and isinstance(value, MatlabStruct):
        return _assign_structs(evaluator, holder, indices, value)
    if isinstance(holder, np.ndarray) and not holder.size and isinstance(value, MatlabCell | MatlabStruct):
        holder = _empty_for(m.Call(m.Name(""), ()), (), value)
        return _assign_elements(evaluator, holder, indices, value, owned)
    if isinstance(holder, MatlabCell):
        values = value.values if isinstance(value, MatlabCell) else object_array([value], (1, 1))
        return MatlabCell(_put(evaluator, holder.values, indices, values, EMPTY))
    if not isinstance(holder, np.ndarray):
        raise MatlabValueError(f"a {class_name(value)} cannot be assigned to an element of a {class_name(holder)}")
    return _assign_numbers(evaluator, holder, indices, array_value(value), owned)


def _assign_numbers(
    evaluator: NumericEvaluator, holder: Array, indices: Sequence[Index], values: Array, owned: bool
) -> Array:
    if holder.dtype.kind == "O" or values.dtype.kind == "O":
        if holder.size and holder.dtype.kind != "O":
            raise MatlabValueError("a string cannot be assigned to an element of a numeric array")
        strings = values if values.dtype.kind == "O" else object_array(["".join(values.ravel().tolist())], (1, 1))
        return _put(evaluator, holder.astype(object), indices, strings, "")
    if holder.dtype.kind == values.dtype.kind == "U":
        return _put(evaluator, holder, indices, values, "\0", owned)
    if holder.dtype != values.dtype:
        name = class_name(holder) if holder.size and holder.dtype.kind in "iub" else result_class(holder, values)
        owned = owned and holder.dtype == cast_to_class(np.zeros((1, 1)), name if name != "logical" else "double").dtype
        if name == "logical":
            values = numbers(values) != 0
        else:
            holder, values = cast_to_class(numbers(holder), name), cast_to_class(numbers(values), name)
    return _put(evaluator, holder, indices, values, False if holder.dtype == np.bool_ else 0, owned)


def _put(
    evaluator: NumericEvaluator, data: Array, indices: Sequence[Index], values: Array, fill: Any, owned: bool = False
) -> Array:
    if not indices:
        raise MatlabValueError("an index is missing")
    return assign_elements(data, indices, values, fill, evaluator.budget, owned)
