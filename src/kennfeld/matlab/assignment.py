"""Assignments to variables and to parts of them: fields, indices and cells, with growth."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.evaluator import Evaluator, chain_of
from kennfeld.matlab.indexing import Index, part, replaced, without
from kennfeld.matlab.operators import as_class, result_class
from kennfeld.matlab.simulink_objects import defaults
from kennfeld.matlab.values import (
    EMPTY,
    Array,
    Cell,
    NoValueError,
    Struct,
    Value,
    class_of,
    data_of,
    numbers,
    object_array,
    plain,
)

__all__ = ["assign"]

_COPY = 3  # elements that the copy of a field or a cell stands for
_NO_CELLS = Cell(np.empty((0, 0), dtype=object))


def assign(evaluator: Evaluator, target: m.Expression, value: Value) -> str:
    """Give a variable, or a part of it, a value; returns the name of the variable."""
    base, steps = chain_of(target)
    assert isinstance(base, m.Name)
    name = base.name
    if not steps:
        evaluator.variables[name] = value
        evaluator.owned.pop(name, None)
        return name
    if name in evaluator.undefined:
        raise NoValueError(f"{name} is undefined: {evaluator.undefined[name]}")
    known = evaluator.variables.get(name)
    owned = known is not None and evaluator.owned.get(name) == id(known)
    made = _changed(evaluator, known, steps, value, owned)
    evaluator.variables[name] = made
    if isinstance(made, np.ndarray) and len(steps) == 1:
        evaluator.owned[name] = id(made)
    return name


def _changed(
    evaluator: Evaluator, known: Value | None, steps: Sequence[m.Expression], value: Value, owned: bool
) -> Value:
    """A value after an assignment to the part that the steps lead to."""
    if not steps:
        return value
    step, rest = steps[0], steps[1:]
    if isinstance(step, m.Field | m.DynamicField):
        return _with_field(evaluator, known, evaluator.field_name(step), rest, value)
    holder = known if known is not None else _empty_for(step, rest, value)
    assert isinstance(step, m.Call | m.CellIndex)
    indices = evaluator.indices(step.arguments, holder)
    if isinstance(step, m.CellIndex):
        return _with_cell(evaluator, holder, indices, rest, value)
    if rest:
        return _with_element(evaluator, holder, indices, rest, value)
    return _with_part(evaluator, holder, indices, value, owned)


def _empty_for(step: m.Expression, rest: Sequence[m.Expression], value: Value) -> Value:
    """What a part is assigned to where there is nothing yet."""
    if isinstance(step, m.CellIndex):
        return _NO_CELLS
    if rest and isinstance(rest[0], m.CellIndex):
        return _NO_CELLS
    if rest:
        return Struct(object_array([], (0, 0)))
    if isinstance(value, Cell):
        return _NO_CELLS
    if isinstance(value, Struct):
        return Struct(object_array([], (0, 0)), value.names, value.kind)
    return np.zeros((0, 0), dtype=value.dtype) if isinstance(value, np.ndarray) else EMPTY


def _with_field(
    evaluator: Evaluator, known: Value | None, name: str, rest: Sequence[m.Expression], value: Value
) -> Value:
    if known is None or (isinstance(known, np.ndarray) and not known.size):
        known = Struct.of({})
    if not isinstance(known, Struct):
        raise NoValueError(f"a {class_of(known)} has no field {name}")
    if known.elements.size != 1:
        raise NoValueError(f"{known.elements.size} structs stand where one is needed")
    evaluator.budget.make(_COPY * len(known.names))
    inner = _changed(evaluator, known.fields.get(name), rest, value, owned=False)
    return Struct.of({**known.fields, name: inner}, known.kind)


def _with_cell(
    evaluator: Evaluator, holder: Value, indices: Sequence[Index], rest: Sequence[m.Expression], value: Value
) -> Value:
    if isinstance(holder, np.ndarray) and not holder.size:
        holder = _NO_CELLS
    if not isinstance(holder, Cell):
        raise NoValueError(f"a {class_of(holder)} has no cells")
    if rest:
        value = _changed(evaluator, _element(evaluator, holder, indices), rest, value, owned=False)
    evaluator.budget.make(_COPY * holder.values.size)
    return Cell(_put(evaluator, holder.values, indices, object_array([value], (1, 1)), EMPTY))


def _element(evaluator: Evaluator, holder: Cell | Struct, indices: Sequence[Index]) -> Any:
    """The one element at an index; None beyond the end."""
    data = data_of(holder)
    try:
        found = part(data, indices, evaluator.budget)
    except NoValueError:
        if not _are_places(indices):
            raise
        return None
    if found.size != 1:
        raise NoValueError(f"{found.size} elements stand where one is needed")
    return found.flat[0]


def _are_places(indices: Sequence[Index]) -> bool:
    return all(
        isinstance(index, np.ndarray) and index.dtype.kind in "fiu" and bool((index >= 1).all()) for index in indices
    )


def _with_element(
    evaluator: Evaluator, holder: Value, indices: Sequence[Index], rest: Sequence[m.Expression], value: Value
) -> Value:
    """`a(2).b = value`, or `a(2){1} = value`."""
    if isinstance(holder, np.ndarray) and not holder.size:
        holder = Struct(object_array([], (0, 0)))
    if isinstance(holder, Cell):
        return _with_cell(evaluator, holder, indices, rest[1:], value)
    if not isinstance(holder, Struct):
        raise NoValueError(f"a {class_of(holder)} has no fields")
    fields = _element(evaluator, holder, indices)
    element = Struct.of(defaults(holder.kind) if fields is None else fields, holder.kind)
    changed = _changed(evaluator, element, rest, value, owned=False)
    assert isinstance(changed, Struct)
    return _with_structs(evaluator, holder, indices, changed)


def _with_structs(evaluator: Evaluator, holder: Struct, indices: Sequence[Index], value: Struct) -> Struct:
    """Structs put among others; all of them get all fields."""
    names = tuple(dict.fromkeys((*holder.names, *value.names)))
    evaluator.budget.make(len(names))
    empty = dict.fromkeys(names, EMPTY) | {n: v for n, v in defaults(holder.kind).items() if n in names}

    def complete(data: Array) -> Array:
        return object_array([{**empty, **one} for one in data.ravel(order="F")], data.shape)

    elements = holder.elements if set(names) == set(holder.names) else complete(holder.elements)
    put = _put(evaluator, elements, indices, complete(value.elements), empty)
    return Struct(put, names, holder.kind or value.kind)


def _with_part(evaluator: Evaluator, holder: Value, indices: Sequence[Index], value: Value, owned: bool) -> Value:
    is_nothing = isinstance(value, np.ndarray) and value.shape == (0, 0) and value.dtype == np.float64
    if is_nothing and data_of(holder).size:
        return _like(holder, without(data_of(holder), indices))
    if isinstance(holder, Struct) and isinstance(value, Struct):
        return _with_structs(evaluator, holder, indices, value)
    if isinstance(holder, np.ndarray) and not holder.size and isinstance(value, Cell | Struct):
        holder = _empty_for(m.Call(m.Name(""), ()), (), value)
        return _with_part(evaluator, holder, indices, value, owned)
    if isinstance(holder, Cell):
        values = value.values if isinstance(value, Cell) else object_array([value], (1, 1))
        return Cell(_put(evaluator, holder.values, indices, values, EMPTY))
    if not isinstance(holder, np.ndarray):
        raise NoValueError(f"a {class_of(value)} cannot be put into a {class_of(holder)}")
    return _with_numbers(evaluator, holder, indices, plain(value), owned)


def _with_numbers(evaluator: Evaluator, holder: Array, indices: Sequence[Index], values: Array, owned: bool) -> Array:
    if holder.dtype.kind == "O" or values.dtype.kind == "O":
        if holder.size and holder.dtype.kind != "O":
            raise NoValueError("a string cannot be put into an array of numbers")
        strings = values if values.dtype.kind == "O" else object_array(["".join(values.ravel().tolist())], (1, 1))
        return _put(evaluator, holder.astype(object), indices, strings, "")
    if holder.dtype.kind == values.dtype.kind == "U":
        return _put(evaluator, holder, indices, values, "\0", owned)
    if holder.dtype != values.dtype:
        name = class_of(holder) if holder.size and holder.dtype.kind in "iub" else result_class(holder, values)
        owned = owned and holder.dtype == as_class(np.zeros((1, 1)), name if name != "logical" else "double").dtype
        if name == "logical":
            values = numbers(values) != 0
        else:
            holder, values = as_class(numbers(holder), name), as_class(numbers(values), name)
    return _put(evaluator, holder, indices, values, False if holder.dtype == np.bool_ else 0, owned)


def _put(
    evaluator: Evaluator, data: Array, indices: Sequence[Index], values: Array, fill: Any, owned: bool = False
) -> Array:
    if not indices:
        raise NoValueError("an index is missing")
    return replaced(data, indices, values, fill, evaluator.budget, owned)


def _like(holder: Value, data: Array) -> Value:
    if isinstance(holder, Cell):
        return Cell(data)
    return Struct(data, holder.names, holder.kind) if isinstance(holder, Struct) else data
