"""Assignments to variables and their parts: fields, indices and cells, with growth."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.matlab import values as v
from kennfeld.matlab.errors import failed_assignment
from kennfeld.matlab.evaluator import NumericEvaluator
from kennfeld.matlab.indexing import Index, assign_elements, delete_elements, index_array
from kennfeld.matlab.operators import cast_to_class, result_class, to_strings
from kennfeld.matlab.simulink_objects import default_properties
from kennfeld.program import tree as m
from kennfeld.program.traversal import access_chain

_COPY = 3  # elements charged for the copy of a field or a cell
_NO_CELLS = v.MatlabCell(np.empty((0, 0), dtype=object))


def assign(evaluator: NumericEvaluator, target: m.Expression, value: v.Value) -> str:
    """Assign a value to a variable or a part of it; return the name of the variable."""
    base, steps = access_chain(target)
    assert isinstance(base, m.Name)
    name = base.name
    if not steps:
        evaluator.variables[name] = value
        evaluator.owned.pop(name, None)
        return name
    if name in evaluator.undefined:
        raise v.MatlabValueError(f"{name} is undefined: {failed_assignment(evaluator.undefined[name])}")
    known = evaluator.variables.get(name)
    owned = known is not None and evaluator.owned.get(name) == id(known)
    result = _assign_part(evaluator, known, steps, value, owned)
    evaluator.variables[name] = result
    if isinstance(result, np.ndarray) and len(steps) == 1:
        evaluator.owned[name] = id(result)
    return name


def without_field(value: v.Value | None, path: Sequence[str]) -> v.MatlabStruct | None:
    """Return a struct without the field at a path; None if it is not a single struct."""
    if not isinstance(value, v.MatlabStruct) or value.elements.size != 1:
        return None
    name, *rest = path
    fields = {key: inner for key, inner in value.fields.items() if key != name}
    if rest and name in value.fields:
        if not isinstance(value.fields[name], v.MatlabStruct):
            return value  # a number has no fields, and stays
        inner = without_field(value.fields[name], rest)
        fields = {**value.fields, name: inner} if inner is not None else fields
    return v.MatlabStruct.of(fields, value.kind)


def _assign_part(
    evaluator: NumericEvaluator, known: v.Value | None, steps: Sequence[m.Expression], value: v.Value, owned: bool
) -> v.Value:
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


def _empty_for(step: m.Expression, rest: Sequence[m.Expression], value: v.Value) -> v.Value:
    """Return the empty value that an assignment to a part of a new variable begins with."""
    if isinstance(step, m.CellIndex):
        return _NO_CELLS
    if rest and isinstance(rest[0], m.CellIndex):
        return _NO_CELLS
    if rest:
        return v.MatlabStruct(v.object_array([], (0, 0)))
    if isinstance(value, v.MatlabCell):
        return _NO_CELLS
    if isinstance(value, v.MatlabStruct):
        return v.MatlabStruct(v.object_array([], (0, 0)), value.names, value.kind)
    return np.zeros((0, 0), dtype=value.dtype) if isinstance(value, np.ndarray) else v.EMPTY


def _assign_field(
    evaluator: NumericEvaluator, known: v.Value | None, name: str, rest: Sequence[m.Expression], value: v.Value
) -> v.Value:
    if known is None or (isinstance(known, np.ndarray) and not known.size):
        known = v.MatlabStruct.of({})
    if not isinstance(known, v.MatlabStruct):
        raise v.MatlabValueError(f"a {v.class_name(known)} has no field {name}")
    if known.elements.size != 1:
        raise v.MatlabValueError(f"expected one struct, got {known.elements.size}")
    if known.kind and name not in known.names:
        # the properties of an object, unlike the fields of a struct, are found in any case
        name = next((other for other in known.names if other.casefold() == name.casefold()), name)
    evaluator.budget.allocate(_COPY * len(known.names))
    inner = _assign_part(evaluator, known.fields.get(name), rest, value, owned=False)
    return v.MatlabStruct.of({**known.fields, name: inner}, known.kind)


def _assign_cell(
    evaluator: NumericEvaluator, holder: v.Value, indices: Sequence[Index], rest: Sequence[m.Expression], value: v.Value
) -> v.Value:
    if isinstance(holder, np.ndarray) and not holder.size:
        holder = _NO_CELLS
    if not isinstance(holder, v.MatlabCell):
        raise v.MatlabValueError(f"a {v.class_name(holder)} cannot be indexed with braces")
    if rest:
        value = _assign_part(evaluator, _element(evaluator, holder, indices), rest, value, owned=False)
    evaluator.budget.allocate(_COPY * holder.values.size)
    return v.MatlabCell(
        assign_elements(holder.values, indices, v.object_array([value], (1, 1)), v.EMPTY, evaluator.budget)
    )


def _element(evaluator: NumericEvaluator, holder: v.MatlabCell | v.MatlabStruct, indices: Sequence[Index]) -> Any:
    """Return the element at an index; None beyond the end."""
    data = v.elements_of(holder)
    try:
        elements = index_array(data, indices, evaluator.budget)
    except v.MatlabValueError:
        if not _are_places(indices):
            raise
        return None
    if elements.size != 1:
        raise v.MatlabValueError(f"expected one element, got {elements.size}")
    return elements.flat[0]


def _are_places(indices: Sequence[Index]) -> bool:
    return all(
        isinstance(index, np.ndarray) and index.dtype.kind in "fiu" and bool((index >= 1).all()) for index in indices
    )


def _assign_in_element(
    evaluator: NumericEvaluator, holder: v.Value, indices: Sequence[Index], rest: Sequence[m.Expression], value: v.Value
) -> v.Value:
    """`a(2).b = value`, or `a(2){1} = value`."""
    if isinstance(holder, np.ndarray) and not holder.size:
        holder = v.MatlabStruct(v.object_array([], (0, 0)))
    if isinstance(holder, v.MatlabCell):
        return _assign_cell(evaluator, holder, indices, rest[1:], value)
    if not isinstance(holder, v.MatlabStruct):
        raise v.MatlabValueError(f"a {v.class_name(holder)} has no fields")
    fields = _element(evaluator, holder, indices)
    element = v.MatlabStruct.of(default_properties(holder.kind) if fields is None else fields, holder.kind)
    changed = _assign_part(evaluator, element, rest, value, owned=False)
    assert isinstance(changed, v.MatlabStruct)
    return _assign_structs(evaluator, holder, indices, changed)


def _assign_structs(
    evaluator: NumericEvaluator, holder: v.MatlabStruct, indices: Sequence[Index], value: v.MatlabStruct
) -> v.MatlabStruct:
    """Assign structs to elements of a struct array; all elements get all fields."""
    names = tuple(dict.fromkeys((*holder.names, *value.names)))
    evaluator.budget.allocate(len(names))
    empty = dict.fromkeys(names, v.EMPTY) | {
        name: value for name, value in default_properties(holder.kind).items() if name in names
    }

    def complete(data: v.Array) -> v.Array:
        return v.object_array([{**empty, **fields} for fields in data.ravel(order="F")], data.shape)

    elements = holder.elements if set(names) == set(holder.names) else complete(holder.elements)
    put = assign_elements(elements, indices, complete(value.elements), empty, evaluator.budget)
    return v.MatlabStruct(put, names, holder.kind or value.kind)


def _assign_elements(
    evaluator: NumericEvaluator, holder: v.Value, indices: Sequence[Index], value: v.Value, owned: bool
) -> v.Value:
    is_nothing = isinstance(value, np.ndarray) and value.shape == (0, 0) and value.dtype == np.float64
    if is_nothing and v.elements_of(holder).size:
        return v.with_class_of(holder, delete_elements(v.elements_of(holder), indices))
    if isinstance(holder, v.MatlabStruct) and isinstance(value, v.MatlabStruct):
        return _assign_structs(evaluator, holder, indices, value)
    if isinstance(holder, np.ndarray) and not holder.size and isinstance(value, v.MatlabCell | v.MatlabStruct):
        holder = _empty_for(m.Call(m.Name(""), ()), (), value)
        return _assign_elements(evaluator, holder, indices, value, owned)
    if isinstance(holder, v.MatlabCell):
        values = value.values if isinstance(value, v.MatlabCell) else v.object_array([value], (1, 1))
        return v.MatlabCell(assign_elements(holder.values, indices, values, v.EMPTY, evaluator.budget))
    if not isinstance(holder, np.ndarray):
        raise v.MatlabValueError(
            f"a {v.class_name(value)} cannot be assigned to an element of a {v.class_name(holder)}"
        )
    return _assign_numbers(evaluator, holder, indices, v.array_value(value), owned)


def _assign_numbers(
    evaluator: NumericEvaluator, holder: v.Array, indices: Sequence[Index], values: v.Array, owned: bool
) -> v.Array:
    if holder.dtype.kind == "O" or values.dtype.kind == "O":
        if holder.size and holder.dtype.kind != "O":
            raise v.MatlabValueError("a string cannot be assigned to an element of a numeric array")
        return assign_elements(holder.astype(object), indices, to_strings(values), "", evaluator.budget)
    if holder.dtype.kind == values.dtype.kind == "U":
        return assign_elements(holder, indices, values, "\0", evaluator.budget, owned)
    if holder.dtype != values.dtype:
        name = v.class_name(holder) if holder.size and holder.dtype.kind in "iub" else result_class(holder, values)
        owned = owned and v.class_name(holder) == name
        holder, values = cast_to_class(v.numbers(holder), name), cast_to_class(v.numbers(values), name)
    return assign_elements(holder, indices, values, False if holder.dtype == np.bool_ else 0, evaluator.budget, owned)
