"""Functions of structs and cell arrays, and functions that apply a function to each element."""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.base.formatting import nearest
from kennfeld.matlab import values as v
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, function
from kennfeld.matlab.operators import concatenate_rows

__all__: list[str] = []


def _struct_argument(call: NumericArguments) -> v.MatlabStruct:
    value = call[0]
    if not isinstance(value, v.MatlabStruct):
        raise v.MatlabValueError(f"must be a struct, got a {v.class_name(value)}")
    return value


@function("struct", 0, MANY)
def _struct(call: NumericArguments) -> v.Value:
    if len(call) == 1 and isinstance(call[0], np.ndarray) and not call[0].size:
        return v.MatlabStruct(v.object_array([], (0, 0)))  # struct([]) is an array of no structs
    if len(call) % 2:
        raise v.MatlabValueError("a field has no value")
    names = [call.text(at) for at in range(0, len(call), 2)]
    values = call.values[1::2]
    wrong = next((name for name in names if not name.isidentifier()), None)
    if wrong is not None:
        raise v.MatlabValueError(f"invalid field name {wrong!r}")
    sizes = {value.values.shape for value in values if isinstance(value, v.MatlabCell) and value.values.size != 1}
    if len(sizes) > 1:
        raise v.MatlabValueError("cell arrays of different sizes cannot form an array of structs")
    shape = next(iter(sizes), (1, 1))
    columns = [_column(value, math.prod(shape)) for value in values]
    rows = [dict(zip(names, each, strict=True)) for each in zip(*columns, strict=True)] if columns else [{}]
    return v.MatlabStruct(v.object_array(rows, shape), tuple(dict.fromkeys(names)))


def _column(value: v.Value, count: int) -> list[v.Value]:
    if not isinstance(value, v.MatlabCell):
        return [value] * count
    return value.contents * (count if value.values.size == 1 else 1)


@function("fieldnames", 1)
def _fieldnames(call: NumericArguments) -> v.Value:
    names = _struct_argument(call).names
    return v.MatlabCell(v.object_array([v.characters(name) for name in names], (len(names), 1)))


@function("isfield isprop", 2)
def _isfield(call: NumericArguments) -> v.Value:
    if not isinstance(call[0], v.MatlabStruct):
        return v.logical(False)
    names = call[0].names
    if isinstance(call[1], v.MatlabCell):
        cells = call[1].values
        return np.array([v.text(cell) in names for cell in cells.ravel()], dtype=bool).reshape(cells.shape)
    return v.logical(call.is_text(1) and call.text(1) in names)


@function("getfield", 2)
def _getfield(call: NumericArguments) -> v.Value:
    struct, name = _struct_argument(call), call.text(1)
    if name not in struct.names:
        raise v.MatlabValueError(f"unknown field {name}. {nearest(name, struct.names)}".strip())
    value: v.Value = struct.fields[name]
    return value


@function("setfield", 3)
def _setfield(call: NumericArguments) -> v.Value:
    struct = _struct_argument(call)
    return v.MatlabStruct.of({**struct.fields, call.text(1): call[2]}, struct.kind)


@function("rmfield", 2)
def _rmfield(call: NumericArguments) -> v.Value:
    struct = _struct_argument(call)
    removed = set(map(v.text, call[1].values.ravel())) if isinstance(call[1], v.MatlabCell) else {call.text(1)}
    missing = next((name for name in removed if name not in struct.names), None)
    if missing is not None:
        raise v.MatlabValueError(f"unknown field {missing}")
    names = tuple(name for name in struct.names if name not in removed)
    elements = [{name: element[name] for name in names} for element in struct.elements.ravel(order="F")]
    return v.MatlabStruct(v.object_array(elements, struct.elements.shape), names, struct.kind)


@function("orderfields", 1)
def _orderfields(call: NumericArguments) -> v.Value:
    struct = _struct_argument(call)
    return v.MatlabStruct(struct.elements, tuple(sorted(struct.names)), struct.kind)


@function("struct2cell", 1)
def _struct2cell(call: NumericArguments) -> v.Value:
    struct = _struct_argument(call)
    return v.MatlabCell(v.object_array([struct.fields[name] for name in struct.names], (len(struct.names), 1)))


@function("cell2struct", 2, 3)
def _cell2struct(call: NumericArguments) -> v.Value:
    cell, names = call[0], call[1]
    if (
        not isinstance(cell, v.MatlabCell)
        or not isinstance(names, v.MatlabCell)
        or cell.values.size != names.values.size
    ):
        raise v.MatlabValueError("cell2struct requires a cell array and one field name per cell")
    keys = [v.text(name) for name in names.values.ravel(order="F")]
    return v.MatlabStruct.of(dict(zip(keys, cell.values.ravel(order="F"), strict=True)))


@function("num2cell", 1)
def _num2cell(call: NumericArguments) -> v.Value:
    call.budget.allocate(10 * call.data(0).size)
    return v.MatlabCell(v.object_array(_single_elements(call[0]), call.data(0).shape))


def _single_elements(value: v.Value) -> list[v.Value]:
    """Return the elements of a value as values of size 1 x 1."""
    data = v.elements_of(value).ravel(order="F")
    return [v.with_class_of(value, data[at : at + 1].reshape(1, 1)) for at in range(data.size)]


@function("cell2mat", 1)
def _cell2mat(call: NumericArguments) -> v.Value:
    cell = call[0]
    if not isinstance(cell, v.MatlabCell) or cell.values.ndim > 2:
        raise v.MatlabValueError("cell2mat requires a two-dimensional cell array")
    return concatenate_rows([list(line) for line in cell.values], call.budget) if cell.values.size else v.EMPTY


@function("deal", 1, MANY)
def _deal(call: NumericArguments) -> tuple[v.Value, ...]:
    count = max(call.outputs, 1)
    if len(call) not in (1, count):
        raise v.MatlabValueError(f"{len(call)} values cannot be assigned to {count} outputs")
    return tuple(call.values) if len(call) == count else (call[0],) * count


def _options(call: NumericArguments) -> tuple[list[v.Value], bool]:
    """Return the arrays to apply to, and the value of UniformOutput."""
    values = list(call.values[1:])
    for at in range(len(values) - 1):
        if call.is_text(at + 1) and call.text(at + 1).casefold() == "uniformoutput":
            return values[:at], bool(call.number(at + 2))
    return values, True


def _map_elements(
    call: NumericArguments, columns: Sequence[Sequence[v.Value]], shape: tuple[int, ...], uniform: bool
) -> "tuple[v.Value, ...]":
    count = max(call.outputs, 1)
    results = [call.apply(call[0], list(each), count) for each in zip(*columns, strict=True)]
    results = [[outputs[k] for outputs in results] for k in range(count)]
    if not uniform:
        return tuple(v.MatlabCell(v.object_array(outputs, shape)) for outputs in results)
    return tuple(_to_uniform(outputs, shape) for outputs in results)


def _to_uniform(values: Sequence[v.Value], shape: tuple[int, ...]) -> v.Array:
    arrays = [value for value in values if isinstance(value, np.ndarray) and value.size == 1]
    if len(arrays) != len(values):
        raise v.MatlabValueError(
            "the function must return one number per element; otherwise set UniformOutput to false"
        )
    numbers = [array.flat[0] for array in arrays]
    return np.array(numbers, dtype=arrays[0].dtype if arrays else np.float64).reshape(shape, order="F")


@function("cellfun", 2, MANY)
def _cellfun(call: NumericArguments) -> tuple[v.Value, ...]:
    values, uniform = _options(call)
    cells = [value.values for value in values if isinstance(value, v.MatlabCell)]
    if len(cells) != len(values) or not cells or len({cell.shape for cell in cells}) > 1:
        raise v.MatlabValueError("cellfun requires cell arrays of equal size")
    return _map_elements(call, [list(cell.ravel(order="F")) for cell in cells], cells[0].shape, uniform)


@function("arrayfun", 2, MANY)
def _arrayfun(call: NumericArguments) -> tuple[v.Value, ...]:
    values, uniform = _options(call)
    shapes = {v.elements_of(value).shape for value in values}
    if len(shapes) != 1:
        raise v.MatlabValueError("arrayfun requires arrays of equal size")
    return _map_elements(call, list(map(_single_elements, values)), shapes.pop(), uniform)


@function("structfun", 2, MANY)
def _structfun(call: NumericArguments) -> v.Value:
    values, uniform = _options(call)
    if len(values) != 1 or not isinstance(values[0], v.MatlabStruct):
        raise v.MatlabValueError("structfun requires a struct")
    results = {name: call.apply(call[0], [inner], 1)[0] for name, inner in values[0].fields.items()}
    return _to_uniform(list(results.values()), (len(results), 1)) if uniform else v.MatlabStruct.of(results)


function("numfields", 1)(lambda call: v.scalar(len(_struct_argument(call).names)))
