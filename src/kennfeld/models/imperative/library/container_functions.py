"""Library functions of structs, cells and function handles, and queries of the type of a value."""

from collections.abc import Iterator

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes
from kennfeld.models.imperative.symbolic_values import (
    EMPTY,
    FunctionHandleValue,
    LogicalNodes,
    String,
    SymbolicCell,
    SymbolicStruct,
    SymbolicValue,
    as_array,
    as_logical,
    constants,
    field_of,
    force,
    leaf_arrays,
)

_MAX_ARGUMENTS = 200


@function("struct", least=0, most=_MAX_ARGUMENTS)
def struct(args: SymbolicArguments) -> SymbolicValue:
    if len(args) % 2:
        raise args.refuse("a field has no value")
    fields: dict[str, SymbolicValue] = {}
    for at in range(0, len(args), 2):
        value = args.held[at + 1]
        if isinstance(value, SymbolicCell):
            if value.shape != (1, 1):
                raise args.refuse("arrays of structs are not supported")
            value = value.cells[0]
        fields[args.text(at)] = value
    return SymbolicStruct(fields)


@function("isfield", least=2, most=2)
def has_field(args: SymbolicArguments) -> SymbolicValue:
    held, names = args.held[0], args.held[1]
    if not isinstance(held, SymbolicStruct):
        return as_logical(constants(args.calls.builder, 0.0))
    if isinstance(names, SymbolicCell):
        result = np.array([cell in held.fields if isinstance(cell, str) else False for cell in names.cells], dtype=bool)
        return constants(args.calls.builder, result.reshape(names.shape, order="F"))
    return as_logical(constants(args.calls.builder, float(isinstance(names, str) and names in held.fields)))


@function("fieldnames")
def field_names(args: SymbolicArguments) -> SymbolicValue:
    held = args.held[0]
    if not isinstance(held, SymbolicStruct):
        raise args.refuse("its argument is not a struct")
    return SymbolicCell(tuple(held.fields), (len(held.fields), 1))


@function("getfield", least=2, most=2)
def get_field(args: SymbolicArguments) -> SymbolicValue:
    return field_of(args.held[0], args.text(1))


@function("setfield", least=3, most=3)
def set_field(args: SymbolicArguments) -> SymbolicValue:
    held = args.held[0]
    if not isinstance(held, SymbolicStruct):
        raise args.refuse("its argument is not a struct")
    return SymbolicStruct({**held.fields, args.text(1): args.held[2]})


@function("struct2cell", "cell2mat")
def convert_container(args: SymbolicArguments) -> SymbolicValue:
    """Return the fields of a struct as cells, or a row or column of cells as an array."""
    held = args.held[0]
    if args.name == "struct2cell" and isinstance(held, SymbolicStruct):
        return SymbolicCell(tuple(field_of(held, name) for name in held.fields), (len(held.fields), 1))
    if isinstance(held, SymbolicCell) and 1 in held.shape:
        return np.concatenate(list(leaf_arrays(held)), axis=0 if held.shape[1] == 1 else 1)
    raise args.refuse("its argument is not supported")


@function("deal", least=1, most=_MAX_ARGUMENTS)
def deal(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    return tuple(args.held) if len(args) > 1 else (args.held[0],) * max(args.wanted, 1)


@function("feval", least=1, most=_MAX_ARGUMENTS)
def call(args: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """Call a function by its name or handle."""
    of, rest = args.held[0], list(args.held[1:])
    if isinstance(of, FunctionHandleValue):
        return args.calls.applied(of, rest, args.wanted)
    return args.calls.named(args.text(0), rest, args.wanted)


@function("arrayfun", least=2, most=6)
def map_elements(args: SymbolicArguments) -> SymbolicValue:
    """Apply a function to each element; it must return one number."""
    of = args.held[0]
    if not isinstance(of, FunctionHandleValue) or any(isinstance(value, str) for value in args.held):
        raise args.refuse("only a function and arrays are supported")
    arrays = [args.array(at) for at in range(1, len(args))]
    result: list[int] = []
    for places in zip(*(array.ravel(order="F") for array in arrays), strict=True):
        args.calls.context.step()
        results = args.calls.applied(of, [node.reshape(1, 1) for node in places], 1)
        result.append(int(as_array(results[0]).item()))
    return np.array(result, dtype=np.int64).reshape(arrays[0].shape, order="F")


def _fixed(args: SymbolicArguments, found: bool) -> SymbolicValue:
    return as_logical(constants(args.calls.builder, float(found)))


@function("isnan")
def is_nan(args: SymbolicArguments) -> SymbolicValue:
    x = args.array(0)
    return as_logical(elementwise(args.calls.builder, "ne", x, x))


@function("isinf")
def is_infinite(args: SymbolicArguments) -> SymbolicValue:
    builder = args.calls.builder
    return as_logical(
        elementwise(builder, "eq", elementwise(builder, "abs", args.array(0)), constants(builder, np.inf))
    )


@function("isfinite")
def is_finite(args: SymbolicArguments) -> SymbolicValue:
    builder = args.calls.builder
    return as_logical(
        elementwise(builder, "lt", elementwise(builder, "abs", args.array(0)), constants(builder, np.inf))
    )


@function("strcmp", "strcmpi", "strncmp", "strncmpi", least=2, most=3)
def compare_texts(args: SymbolicArguments) -> SymbolicValue:
    """Compare two texts, or their first characters."""
    one, other = args.held[0], args.held[1]
    if isinstance(one, SymbolicCell) or isinstance(other, SymbolicCell):
        raise args.refuse("cells of texts are not supported")
    if not (isinstance(one, str) and isinstance(other, str)):
        return _fixed(args, False)
    if args.name.endswith("i"):
        one, other = one.casefold(), other.casefold()
    if args.name.startswith("strn"):
        count = args.whole(2)
        return _fixed(args, len(one) >= count and len(other) >= count and one[:count] == other[:count])
    return _fixed(args, one == other)


@function("isa", least=2, most=2)
def is_a(args: SymbolicArguments) -> SymbolicValue:
    """Return whether a value is of a class; all numbers are in double precision."""
    held, kind = args.held[0], args.text(1)
    number = isinstance(held, np.ndarray) and not isinstance(held, LogicalNodes)
    kinds = {"struct": SymbolicStruct, "cell": SymbolicCell, "string": String, "char": str, "logical": LogicalNodes}
    if kind in kinds:
        return _fixed(args, isinstance(held, kinds[kind]) and not (kind == "char" and isinstance(held, String)))
    return _fixed(args, number and kind in ("double", "float", "numeric"))


@function("class")
def class_of(args: SymbolicArguments) -> SymbolicValue:
    """Return the class of a value; all numbers are in double precision."""
    held = args.held[0]
    kinds = {SymbolicStruct: "struct", SymbolicCell: "cell", String: "string", str: "char", LogicalNodes: "logical"}
    return next((name for kind, name in kinds.items() if isinstance(held, kind)), "double")


@function("isequal", least=2, most=2)
def equal(args: SymbolicArguments) -> SymbolicValue:
    """Return whether two values have the same form and elements."""
    builder = args.calls.builder
    return as_logical(
        np.array([[reduce_nodes(builder, "and", list(_equality_conditions(builder, *args.held)))]], dtype=np.int64)
    )


def _equality_conditions(builder: GraphBuilder, one: SymbolicValue, other: SymbolicValue) -> Iterator[int]:
    """Return the conditions under which two values are equal; a false one if their forms differ."""
    one, other = force(one), force(other)
    if isinstance(one, str) != isinstance(other, str) and not isinstance(one, String) and not isinstance(other, String):
        one, other = (_codes(builder, held) if isinstance(held, str) else held for held in (one, other))
    yield builder.const(float(_form(one) == _form(other)))
    if isinstance(one, SymbolicStruct) and isinstance(other, SymbolicStruct):
        for name in one.fields.keys() & other.fields.keys():
            yield from _equality_conditions(builder, field_of(one, name), field_of(other, name))
    elif isinstance(one, SymbolicCell) and isinstance(other, SymbolicCell):
        for first, second in zip(one.cells, other.cells, strict=False):
            yield from _equality_conditions(builder, force(first), force(second))
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and one.shape == other.shape:
        yield from (int(node) for node in elementwise(builder, "eq", one, other).ravel())


def _codes(builder: GraphBuilder, text: str) -> Nodes:
    """Return the characters of a text as numbers."""
    return constants(builder, [[float(ord(character)) for character in text]]) if text else EMPTY


def _form(held: SymbolicValue) -> object:
    """Return what equal values have in common for certain."""
    if isinstance(held, str):
        return str(held)
    if isinstance(held, SymbolicStruct):
        return frozenset(held.fields)
    return ("cell", held.shape) if isinstance(held, SymbolicCell) else as_array(held).shape


@function("ismember", least=2, most=2)
def is_member(args: SymbolicArguments) -> SymbolicValue:
    """Return whether elements are in an array, or a text is among cells of texts."""
    held, among = args.held[0], args.held[1]
    if isinstance(among, SymbolicCell) and isinstance(held, str):
        return _fixed(args, held in among.cells)
    if isinstance(held, String) or isinstance(among, String):
        if not (isinstance(held, str) and isinstance(among, str)):
            raise args.refuse("a string is compared with a value of another type")
        return _fixed(args, held == among)
    builder = args.calls.builder
    one, other = (_codes(builder, part) if isinstance(part, str) else as_array(part) for part in (held, among))
    result = np.full(one.shape, builder.const(0.0), dtype=np.int64)
    args.calls.context.room(float(result.size) * other.size)
    for node in other.ravel(order="F"):
        same = elementwise(builder, "eq", one, node.reshape(1, 1))
        result = elementwise(builder, "or", result, same)
    return as_logical(result)
