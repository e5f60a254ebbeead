"""Functions of structs and of functions that a variable holds.

Functions that tell what a value is.
"""

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

_MOST = 200


@function("struct", least=0, most=_MOST)
def struct(given: SymbolicArguments) -> SymbolicValue:
    """A struct of names and values."""
    if len(given) % 2:
        raise given.refuse("a field has no value")
    fields: dict[str, SymbolicValue] = {}
    for at in range(0, len(given), 2):
        value = given.held[at + 1]
        if isinstance(value, SymbolicCell):
            if value.shape != (1, 1):
                raise given.refuse("arrays of structs are not supported")
            value = value.cells[0]
        fields[given.text(at)] = value
    return SymbolicStruct(fields)


@function("isfield", least=2, most=2)
def has_field(given: SymbolicArguments) -> SymbolicValue:
    """Whether a struct has a field."""
    held, names = given.held[0], given.held[1]
    if not isinstance(held, SymbolicStruct):
        return as_logical(constants(given.calls.builder, 0.0))
    if isinstance(names, SymbolicCell):
        found = np.array([one in held.fields if isinstance(one, str) else False for one in names.cells], dtype=bool)
        return constants(given.calls.builder, found.reshape(names.shape, order="F"))
    return as_logical(constants(given.calls.builder, float(isinstance(names, str) and names in held.fields)))


@function("fieldnames")
def names(given: SymbolicArguments) -> SymbolicValue:
    """The names of the fields of a struct."""
    held = given.held[0]
    if not isinstance(held, SymbolicStruct):
        raise given.refuse("its argument is no struct")
    return SymbolicCell(tuple(held.fields), (len(held.fields), 1))


@function("getfield", least=2, most=2)
def field(given: SymbolicArguments) -> SymbolicValue:
    """A field by its name."""
    return field_of(given.held[0], given.text(1))


@function("setfield", least=3, most=3)
def with_field(given: SymbolicArguments) -> SymbolicValue:
    """A struct with a field changed."""
    held = given.held[0]
    if not isinstance(held, SymbolicStruct):
        raise given.refuse("its argument is no struct")
    return SymbolicStruct({**held.fields, given.text(1): given.held[2]})


@function("struct2cell", "cell2mat")
def arranged(given: SymbolicArguments) -> SymbolicValue:
    """The fields of a struct as cells; a row or column of cells as an array."""
    held = given.held[0]
    if given.name == "struct2cell" and isinstance(held, SymbolicStruct):
        return SymbolicCell(tuple(field_of(held, name) for name in held.fields), (len(held.fields), 1))
    if isinstance(held, SymbolicCell) and 1 in held.shape:
        return np.concatenate(list(leaf_arrays(held)), axis=0 if held.shape[1] == 1 else 1)
    raise given.refuse("its argument is not supported")


@function("deal", least=1, most=_MOST)
def deal(given: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """Each argument as a result, or one for all of them."""
    return tuple(given.held) if len(given) > 1 else (given.held[0],) * max(given.wanted, 1)


@function("feval", least=1, most=_MOST)
def call(given: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """A function called by its name, or by what holds it."""
    of, rest = given.held[0], list(given.held[1:])
    if isinstance(of, FunctionHandleValue):
        return given.calls.applied(of, rest, given.wanted)
    return given.calls.named(given.text(0), rest, given.wanted)


@function("arrayfun", least=2, most=6)
def over_elements(given: SymbolicArguments) -> SymbolicValue:
    """A function of each element, which gives one number."""
    of = given.held[0]
    if not isinstance(of, FunctionHandleValue) or any(isinstance(one, str) for one in given.held):
        raise given.refuse("only a function and arrays are supported")
    arrays = [given.array(at) for at in range(1, len(given))]
    made: list[int] = []
    for places in zip(*(array.ravel(order="F") for array in arrays), strict=True):
        given.calls.context.step()
        results = given.calls.applied(of, [node.reshape(1, 1) for node in places], 1)
        made.append(int(as_array(results[0]).item()))
    return np.array(made, dtype=np.int64).reshape(arrays[0].shape, order="F")


def _fixed(given: SymbolicArguments, found: bool) -> SymbolicValue:
    return as_logical(constants(given.calls.builder, float(found)))


@function("isnan")
def is_nan(given: SymbolicArguments) -> SymbolicValue:
    """Whether elements are not numbers."""
    x = given.array(0)
    return as_logical(elementwise(given.calls.builder, "ne", x, x))


@function("isinf")
def is_infinite(given: SymbolicArguments) -> SymbolicValue:
    """Whether elements are infinite."""
    builder = given.calls.builder
    return as_logical(
        elementwise(builder, "eq", elementwise(builder, "abs", given.array(0)), constants(builder, np.inf))
    )


@function("isfinite")
def is_finite(given: SymbolicArguments) -> SymbolicValue:
    """Whether elements are finite numbers."""
    builder = given.calls.builder
    return as_logical(
        elementwise(builder, "lt", elementwise(builder, "abs", given.array(0)), constants(builder, np.inf))
    )


@function("strcmp", "strcmpi", "strncmp", "strncmpi", least=2, most=3)
def same_text(given: SymbolicArguments) -> SymbolicValue:
    """Whether two texts are the same, or begin so."""
    one, other = given.held[0], given.held[1]
    if isinstance(one, SymbolicCell) or isinstance(other, SymbolicCell):
        raise given.refuse("cells of texts are not supported")
    if not (isinstance(one, str) and isinstance(other, str)):
        return _fixed(given, False)
    if given.name.endswith("i"):
        one, other = one.casefold(), other.casefold()
    if given.name.startswith("strn"):
        count = given.whole(2)
        return _fixed(given, len(one) >= count and len(other) >= count and one[:count] == other[:count])
    return _fixed(given, one == other)


@function("isa", least=2, most=2)
def is_a(given: SymbolicArguments) -> SymbolicValue:
    """Whether a value is of a class; all numbers are in double precision."""
    held, kind = given.held[0], given.text(1)
    number = isinstance(held, np.ndarray) and not isinstance(held, LogicalNodes)
    kinds = {"struct": SymbolicStruct, "cell": SymbolicCell, "string": String, "char": str, "logical": LogicalNodes}
    if kind in kinds:
        return _fixed(given, isinstance(held, kinds[kind]) and not (kind == "char" and isinstance(held, String)))
    return _fixed(given, number and kind in ("double", "float", "numeric"))


@function("class")
def class_of(given: SymbolicArguments) -> SymbolicValue:
    """The class of a value; all numbers are in double precision."""
    held = given.held[0]
    kinds = {SymbolicStruct: "struct", SymbolicCell: "cell", String: "string", str: "char", LogicalNodes: "logical"}
    return next((name for kind, name in kinds.items() if isinstance(held, kind)), "double")


@function("isequal", least=2, most=2)
def equal(given: SymbolicArguments) -> SymbolicValue:
    """Whether two values have the same form and elements."""
    builder = given.calls.builder
    return as_logical(np.array([[reduce_nodes(builder, "and", list(_pairs(builder, *given.held)))]], dtype=np.int64))


def _pairs(builder: GraphBuilder, one: SymbolicValue, other: SymbolicValue) -> Iterator[int]:
    """What must hold where two values are equal; never where their forms differ."""
    one, other = force(one), force(other)
    if isinstance(one, str) != isinstance(other, str) and not isinstance(one, String) and not isinstance(other, String):
        one, other = (_codes(builder, held) if isinstance(held, str) else held for held in (one, other))
    yield builder.const(float(_form(one) == _form(other)))
    if isinstance(one, SymbolicStruct) and isinstance(other, SymbolicStruct):
        for name in one.fields.keys() & other.fields.keys():
            yield from _pairs(builder, field_of(one, name), field_of(other, name))
    elif isinstance(one, SymbolicCell) and isinstance(other, SymbolicCell):
        for first, second in zip(one.cells, other.cells, strict=False):
            yield from _pairs(builder, force(first), force(second))
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and one.shape == other.shape:
        yield from (int(node) for node in elementwise(builder, "eq", one, other).ravel())


def _codes(builder: GraphBuilder, text: str) -> Nodes:
    """The characters of a text as numbers."""
    return constants(builder, [[float(ord(one)) for one in text]]) if text else EMPTY


def _form(held: SymbolicValue) -> object:
    """What two values that are equal have in common for certain."""
    if isinstance(held, str):
        return str(held)
    if isinstance(held, SymbolicStruct):
        return frozenset(held.fields)
    return ("cell", held.shape) if isinstance(held, SymbolicCell) else as_array(held).shape


@function("ismember", least=2, most=2)
def is_member(given: SymbolicArguments) -> SymbolicValue:
    """Whether elements are among those of an array, or a text among cells of texts."""
    held, among = given.held[0], given.held[1]
    if isinstance(among, SymbolicCell) and isinstance(held, str):
        return _fixed(given, held in among.cells)
    if isinstance(held, String) or isinstance(among, String):
        if not (isinstance(held, str) and isinstance(among, str)):
            raise given.refuse("a string stands beside what is none")
        return _fixed(given, held == among)
    builder = given.calls.builder
    one, other = (_codes(builder, part) if isinstance(part, str) else as_array(part) for part in (held, among))
    made = np.full(one.shape, builder.const(0.0), dtype=np.int64)
    given.calls.context.room(float(made.size) * other.size)
    for node in other.ravel(order="F"):
        same = elementwise(builder, "eq", one, node.reshape(1, 1))
        made = elementwise(builder, "or", made, same)
    return as_logical(made)
