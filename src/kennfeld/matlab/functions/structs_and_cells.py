"""Functions of structs and cell arrays, and those that call a function for each element."""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.formatting import nearest
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, function
from kennfeld.matlab.operators import concatenate_rows
from kennfeld.matlab.values import (
    EMPTY,
    Array,
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    Value,
    characters,
    class_name,
    elements_of,
    logical,
    object_array,
    scalar,
    text,
    with_class_of,
)

__all__: list[str] = []


def _struct_at(given: NumericArguments, at: int) -> MatlabStruct:
    value = given[at]
    if not isinstance(value, MatlabStruct):
        raise MatlabValueError(f"a struct is needed, not a {class_name(value)}")
    return value


@function("struct", 0, MANY)
def _struct(given: NumericArguments) -> Value:
    if len(given) % 2:
        raise MatlabValueError("struct needs a value for each name")
    names = [given.text(at) for at in range(0, len(given), 2)]
    values = given.values[1::2]
    wrong = next((name for name in names if not name.isidentifier()), None)
    if wrong is not None:
        raise MatlabValueError(f"{wrong!r} is no name of a field")
    sizes = {value.values.shape for value in values if isinstance(value, MatlabCell) and value.values.size != 1}
    if len(sizes) > 1:
        raise MatlabValueError("cell arrays of different sizes make no array of structs")
    shape = next(iter(sizes), (1, 1))
    columns = [_column(value, math.prod(shape)) for value in values]
    rows = [dict(zip(names, each, strict=True)) for each in zip(*columns, strict=True)] if columns else [{}]
    return MatlabStruct(object_array(rows, shape), tuple(dict.fromkeys(names)))


def _column(value: Value, count: int) -> list[Value]:
    if not isinstance(value, MatlabCell):
        return [value] * count
    return [value.values.flat[0]] * count if value.values.size == 1 else list(value.values.ravel(order="F"))


@function("fieldnames", 1)
def _fieldnames(given: NumericArguments) -> Value:
    names = _struct_at(given, 0).names
    return MatlabCell(object_array([characters(name) for name in names], (len(names), 1)))


@function("numfields", 1)
def _numfields(given: NumericArguments) -> Value:
    return scalar(len(_struct_at(given, 0).names))


@function("isfield isprop", 2)
def _isfield(given: NumericArguments) -> Value:
    if not isinstance(given[0], MatlabStruct):
        return logical(False)
    names = given[0].names
    if isinstance(given[1], MatlabCell):
        cells = given[1].values
        return np.array([text(one) in names for one in cells.ravel()], dtype=bool).reshape(cells.shape)
    return logical(given.is_text(1) and given.text(1) in names)


@function("getfield", 2)
def _getfield(given: NumericArguments) -> Value:
    struct, name = _struct_at(given, 0), given.text(1)
    if name not in struct.names:
        raise MatlabValueError(f"there is no field {name}. {nearest(name, struct.names)}".strip())
    return struct.fields[name]


@function("setfield", 3)
def _setfield(given: NumericArguments) -> Value:
    struct = _struct_at(given, 0)
    return MatlabStruct.of({**struct.fields, given.text(1): given[2]}, struct.kind)


@function("rmfield", 2)
def _rmfield(given: NumericArguments) -> Value:
    struct = _struct_at(given, 0)
    gone = {text(one) for one in given[1].values.ravel()} if isinstance(given[1], MatlabCell) else {given.text(1)}
    missing = next((name for name in gone if name not in struct.names), None)
    if missing is not None:
        raise MatlabValueError(f"there is no field {missing}")
    names = tuple(name for name in struct.names if name not in gone)
    kept = [{name: one[name] for name in names} for one in struct.elements.ravel(order="F")]
    return MatlabStruct(object_array(kept, struct.elements.shape), names, struct.kind)


@function("orderfields", 1)
def _orderfields(given: NumericArguments) -> Value:
    struct = _struct_at(given, 0)
    return MatlabStruct(struct.elements, tuple(sorted(struct.names)), struct.kind)


@function("struct2cell", 1)
def _struct2cell(given: NumericArguments) -> Value:
    struct = _struct_at(given, 0)
    return MatlabCell(object_array([struct.fields[name] for name in struct.names], (len(struct.names), 1)))


@function("cell2struct", 2, 3)
def _cell2struct(given: NumericArguments) -> Value:
    cell, names = given[0], given[1]
    if not isinstance(cell, MatlabCell) or not isinstance(names, MatlabCell) or cell.values.size != names.values.size:
        raise MatlabValueError("cell2struct needs a cell array and a name for each of its cells")
    keys = [text(one) for one in names.values.ravel(order="F")]
    return MatlabStruct.of(dict(zip(keys, cell.values.ravel(order="F"), strict=True)))


@function("num2cell", 1)
def _num2cell(given: NumericArguments) -> Value:
    data = given.data(0)
    given.budget.make(10 * data.size)
    parts = [with_class_of(given[0], one.reshape(1, 1)) for one in data.ravel(order="F")]
    return MatlabCell(object_array(parts, data.shape))


@function("cell2mat", 1)
def _cell2mat(given: NumericArguments) -> Value:
    cell = given[0]
    if not isinstance(cell, MatlabCell) or cell.values.ndim > 2:
        raise MatlabValueError("cell2mat needs a cell array of two dimensions")
    return concatenate_rows([list(line) for line in cell.values], given.budget) if cell.values.size else EMPTY


@function("deal", 1, MANY)
def _deal(given: NumericArguments) -> tuple[Value, ...]:
    count = max(given.outputs, 1)
    if len(given) not in (1, count):
        raise MatlabValueError(f"{len(given)} values cannot be dealt to {count}")
    return tuple(given.values) if len(given) == count else (given[0],) * count


def _options(given: NumericArguments) -> tuple[list[Value], bool]:
    """The arrays to go through, and whether their results are plain numbers."""
    values = list(given.values[1:])
    for at in range(len(values) - 1):
        if given.is_text(at + 1) and given.text(at + 1).casefold() == "uniformoutput":
            return values[:at], bool(given.number(at + 2))
    return values, True


def _mapped(
    given: NumericArguments, columns: Sequence[Sequence[Value]], shape: tuple[int, ...], uniform: bool
) -> "tuple[Value, ...]":
    count = max(given.outputs, 1)
    found = [given.apply(given[0], list(each), count) for each in zip(*columns, strict=True)]
    results = [[one[k] for one in found] for k in range(count)]
    if not uniform:
        return tuple(MatlabCell(object_array(one, shape)) for one in results)
    return tuple(_uniform(one, shape) for one in results)


def _uniform(values: Sequence[Value], shape: tuple[int, ...]) -> Array:
    arrays = [value for value in values if isinstance(value, np.ndarray) and value.size == 1]
    if len(arrays) != len(values):
        raise MatlabValueError("the function does not give one number each time; set UniformOutput to false")
    made = [array.flat[0] for array in arrays]
    return np.array(made, dtype=arrays[0].dtype if arrays else np.float64).reshape(shape, order="F")


@function("cellfun", 2, MANY)
def _cellfun(given: NumericArguments) -> tuple[Value, ...]:
    values, uniform = _options(given)
    cells = [value.values for value in values if isinstance(value, MatlabCell)]
    if len(cells) != len(values) or not cells or len({cell.shape for cell in cells}) > 1:
        raise MatlabValueError("cellfun needs cell arrays of one size")
    return _mapped(given, [list(cell.ravel(order="F")) for cell in cells], cells[0].shape, uniform)


@function("arrayfun", 2, MANY)
def _arrayfun(given: NumericArguments) -> tuple[Value, ...]:
    values, uniform = _options(given)
    shapes = {elements_of(value).shape for value in values}
    if len(shapes) != 1:
        raise MatlabValueError("arrayfun needs arrays of one size")
    columns = [[with_class_of(value, one.reshape(1, 1)) for one in _singles(value)] for value in values]
    return _mapped(given, columns, shapes.pop(), uniform)


def _singles(value: Value) -> list[Array]:
    data = elements_of(value).ravel(order="F")
    return [data[at : at + 1] for at in range(data.size)]


@function("structfun", 2, MANY)
def _structfun(given: NumericArguments) -> Value:
    values, uniform = _options(given)
    if len(values) != 1 or not isinstance(values[0], MatlabStruct):
        raise MatlabValueError("structfun needs a struct")
    found = {name: given.apply(given[0], [inner], 1)[0] for name, inner in values[0].fields.items()}
    return _uniform(list(found.values()), (len(found), 1)) if uniform else MatlabStruct.of(found)
