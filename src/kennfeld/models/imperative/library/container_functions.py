"""Library functions that compare values of any type."""

from collections.abc import Iterator

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import MatlabCell, MatlabStruct
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes


@function("cell2mat")
def join_cells(args: SymbolicArguments) -> s.SymbolicValue:
    """Return a row or column of cells as an array."""
    value = args.values[0]
    if isinstance(value, MatlabCell) and 1 in value.values.shape:
        return np.concatenate(list(s.leaf_arrays(value)), axis=0 if value.values.shape[1] == 1 else 1)
    raise args.refuse("its argument is not supported")


def _fixed(args: SymbolicArguments, holds: bool) -> s.SymbolicValue:
    return s.as_logical(s.constants(args.builder, float(holds)))


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
    if isinstance(left, MatlabStruct) and isinstance(right, MatlabStruct):
        for name in filter(right.fields.__contains__, left.fields):
            yield from _equality_conditions(builder, s.field_of(left, name), s.field_of(right, name))
    elif isinstance(left, MatlabCell) and isinstance(right, MatlabCell):
        for pair in zip(left.contents, right.contents, strict=False):
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
    if isinstance(value, MatlabStruct):
        s.check_single(value)
        return frozenset(value.fields)
    return ("cell", value.values.shape) if isinstance(value, MatlabCell) else s.as_array(value).shape


@function("ismember", least=2, most=2)
def is_member(args: SymbolicArguments) -> s.SymbolicValue:
    """Return whether elements are in an array, or a text is among cells of texts."""
    value, among = args.values[0], args.values[1]
    if isinstance(among, MatlabCell) and isinstance(value, str):
        return _fixed(args, any(isinstance(cell, str) and cell == value for cell in among.contents))
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
