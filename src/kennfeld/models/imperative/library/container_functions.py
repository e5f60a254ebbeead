"""Library functions of structs, cells and function handles, and queries of the type of a value."""

import math
from collections.abc import Iterator

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes

_MAX_ARGUMENTS = 200


@function("struct", least=0, most=_MAX_ARGUMENTS)
def struct(args: SymbolicArguments) -> s.SymbolicValue:
    if len(args) % 2:
        raise args.refuse("a field has no value")
    fields: dict[str, s.SymbolicValue] = {}
    for at in range(0, len(args), 2):
        value = args.values[at + 1]
        if isinstance(value, s.SymbolicCell):
            if value.shape != (1, 1):
                raise args.refuse("arrays of structs are not supported")
            value = value.cells[0]
        fields[args.text(at)] = value
    return s.SymbolicStruct(fields)


@function("getfield", least=2, most=2)
def get_field(args: SymbolicArguments) -> s.SymbolicValue:
    return s.field_of(args.values[0], args.text(1))


@function("setfield", least=3, most=3)
def set_field(args: SymbolicArguments) -> s.SymbolicValue:
    value = args.values[0]
    if not isinstance(value, s.SymbolicStruct):
        raise args.refuse("its argument is not a struct")
    return s.SymbolicStruct({**value.fields, args.text(1): args.values[2]})


@function("struct2cell", "cell2mat")
def convert_container(args: SymbolicArguments) -> s.SymbolicValue:
    """Return the fields of a struct as cells, or a row or column of cells as an array."""
    value = args.values[0]
    if args.name == "struct2cell" and isinstance(value, s.SymbolicStruct):
        return s.SymbolicCell(tuple(s.field_of(value, name) for name in value.fields), (len(value.fields), 1))
    if isinstance(value, s.SymbolicCell) and 1 in value.shape:
        return np.concatenate(list(s.leaf_arrays(value)), axis=0 if value.shape[1] == 1 else 1)
    raise args.refuse("its argument is not supported")


@function("deal", least=1, most=_MAX_ARGUMENTS)
def deal(args: SymbolicArguments) -> tuple[s.SymbolicValue, ...]:
    return tuple(args.values) if len(args) > 1 else (args.values[0],) * max(args.wanted, 1)


@function("feval", least=1, most=_MAX_ARGUMENTS)
def call(args: SymbolicArguments) -> s.SymbolicValue | tuple[s.SymbolicValue, ...]:
    """Call a function by its name or handle."""
    of, rest = args.values[0], list(args.values[1:])
    if isinstance(of, s.FunctionHandleValue):
        return args.evaluator.call_handle(of, rest, args.wanted)
    return args.evaluator.call_named(args.text(0), rest, args.wanted)


@function("arrayfun", least=2, most=6)
def map_elements(args: SymbolicArguments) -> s.SymbolicValue:
    """Apply a function to each element; it must return one number."""
    of = args.values[0]
    if not isinstance(of, s.FunctionHandleValue) or any(isinstance(value, str) for value in args.values):
        raise args.refuse("only a function and arrays are supported")
    arrays = [args.array(at) for at in range(1, len(args))]
    result: list[int] = []
    for places in zip(*(array.ravel(order="F") for array in arrays), strict=True):
        args.context.step()
        results = args.evaluator.call_handle(of, [node.reshape(1, 1) for node in places], 1)
        result.append(int(s.as_array(results[0]).item()))
    return np.array(result, dtype=np.int64).reshape(arrays[0].shape, order="F")


def _fixed(args: SymbolicArguments, holds: bool) -> s.SymbolicValue:
    return s.as_logical(s.constants(args.builder, float(holds)))


@function("isnan", "isinf", "isfinite")
def classify_numbers(args: SymbolicArguments) -> s.SymbolicValue:
    x, apply = args.array(0), args.apply
    if args.name == "isnan":
        return s.as_logical(apply("ne", x, x))
    return s.as_logical(apply("eq" if args.name == "isinf" else "lt", apply("abs", x), math.inf))


@function("isequal", least=2, most=2)
def equal(args: SymbolicArguments) -> s.SymbolicValue:
    """Return whether two values have the same form and elements."""
    conditions = _equality_conditions(args.builder, *args.values)
    return s.as_logical(np.array([[reduce_nodes(args.builder, "and", conditions)]], dtype=np.int64))


def _equality_conditions(builder: GraphBuilder, left: s.SymbolicValue, right: s.SymbolicValue) -> Iterator[int]:
    """Yield the conditions under which two values are equal; a false one if their forms differ."""
    left, right = s.force(left), s.force(right)
    has_string = isinstance(left, s.String) or isinstance(right, s.String)
    if isinstance(left, str) != isinstance(right, str) and not has_string:
        left, right = (_codes(builder, side) if isinstance(side, str) else side for side in (left, right))
    yield builder.const(float(_form(left) == _form(right)))
    if isinstance(left, s.SymbolicStruct) and isinstance(right, s.SymbolicStruct):
        for name in left.fields.keys() & right.fields.keys():
            yield from _equality_conditions(builder, s.field_of(left, name), s.field_of(right, name))
    elif isinstance(left, s.SymbolicCell) and isinstance(right, s.SymbolicCell):
        for pair in zip(left.cells, right.cells, strict=False):
            yield from _equality_conditions(builder, *pair)
    elif isinstance(left, np.ndarray) and isinstance(right, np.ndarray) and left.shape == right.shape:
        yield from map(int, elementwise(builder, "eq", left, right).ravel())


def _codes(builder: GraphBuilder, text: str) -> Nodes:
    """Return the characters of a text as numbers."""
    return s.constants(builder, [[float(ord(character)) for character in text]]) if text else s.EMPTY


def _form(value: s.SymbolicValue) -> object:
    """Return what equal values have in common for certain."""
    if isinstance(value, str):
        return str(value)
    if isinstance(value, s.SymbolicStruct):
        return frozenset(value.fields)
    return ("cell", value.shape) if isinstance(value, s.SymbolicCell) else s.as_array(value).shape


@function("ismember", least=2, most=2)
def is_member(args: SymbolicArguments) -> s.SymbolicValue:
    """Return whether elements are in an array, or a text is among cells of texts."""
    value, among = args.values[0], args.values[1]
    if isinstance(among, s.SymbolicCell) and isinstance(value, str):
        return _fixed(args, value in among.cells)
    if isinstance(value, s.String) or isinstance(among, s.String):
        if not (isinstance(value, str) and isinstance(among, str)):
            raise args.refuse("a string is compared with a value of another type")
        return _fixed(args, value == among)
    elements, members = (
        _codes(args.builder, part) if isinstance(part, str) else s.as_array(part) for part in (value, among)
    )
    args.context.room(float(elements.size) * members.size)
    result = np.full(elements.shape, args.builder.const(0.0), dtype=np.int64)
    for node in members.ravel(order="F"):
        result = args.apply("or", result, args.apply("eq", elements, node.reshape(1, 1)))
    return s.as_logical(result)
