"""Functions that tell what a value is."""

from collections.abc import Iterator

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.functions.registry import Given, function
from kennfeld.models.simulink.code.values import (
    EMPTY,
    Cells,
    Held,
    String,
    Struct,
    Truths,
    array_of,
    constants,
    field_of,
    resolved,
    truths,
)
from kennfeld.models.simulink.expressions.arrays import each, fold
from kennfeld.models.simulink.expressions.signals import Nodes


def _fixed(given: Given, found: bool) -> Held:
    return truths(constants(given.calls.loom, float(found)))


@function("isnan")
def is_nan(given: Given) -> Held:
    """Whether elements are not numbers."""
    x = given.array(0)
    return truths(each(given.calls.loom, "ne", x, x))


@function("isinf")
def is_infinite(given: Given) -> Held:
    """Whether elements are infinite."""
    loom = given.calls.loom
    return truths(each(loom, "eq", each(loom, "abs", given.array(0)), constants(loom, np.inf)))


@function("isfinite")
def is_finite(given: Given) -> Held:
    """Whether elements are finite numbers."""
    loom = given.calls.loom
    return truths(each(loom, "lt", each(loom, "abs", given.array(0)), constants(loom, np.inf)))


@function("strcmp", "strcmpi", "strncmp", "strncmpi", least=2, most=3)
def same_text(given: Given) -> Held:
    """Whether two texts are the same, or begin so."""
    one, other = given.held[0], given.held[1]
    if isinstance(one, Cells) or isinstance(other, Cells):
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
def is_a(given: Given) -> Held:
    """Whether a value is of a class; all numbers are in double precision."""
    held, kind = given.held[0], given.text(1)
    number = isinstance(held, np.ndarray) and not isinstance(held, Truths)
    kinds = {"struct": Struct, "cell": Cells, "string": String, "char": str, "logical": Truths}
    if kind in kinds:
        return _fixed(given, isinstance(held, kinds[kind]) and not (kind == "char" and isinstance(held, String)))
    return _fixed(given, number and kind in ("double", "float", "numeric"))


@function("class")
def class_of(given: Given) -> Held:
    """The class of a value; all numbers are in double precision."""
    held = given.held[0]
    kinds = {Struct: "struct", Cells: "cell", String: "string", str: "char", Truths: "logical"}
    return next((name for kind, name in kinds.items() if isinstance(held, kind)), "double")


@function("isequal", least=2, most=2)
def equal(given: Given) -> Held:
    """Whether two values have the same form and elements."""
    loom = given.calls.loom
    return truths(np.array([[fold(loom, "and", list(_pairs(loom, *given.held)))]], dtype=np.int64))


def _pairs(loom: Loom, one: Held, other: Held) -> Iterator[int]:
    """What must hold where two values are equal; never where their forms differ."""
    one, other = resolved(one), resolved(other)
    if isinstance(one, str) != isinstance(other, str) and not isinstance(one, String) and not isinstance(other, String):
        one, other = (_codes(loom, held) if isinstance(held, str) else held for held in (one, other))
    yield loom.const(float(_form(one) == _form(other)))
    if isinstance(one, Struct) and isinstance(other, Struct):
        for name in one.fields.keys() & other.fields.keys():
            yield from _pairs(loom, field_of(one, name), field_of(other, name))
    elif isinstance(one, Cells) and isinstance(other, Cells):
        for first, second in zip(one.cells, other.cells, strict=False):
            yield from _pairs(loom, resolved(first), resolved(second))
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and one.shape == other.shape:
        yield from (int(node) for node in each(loom, "eq", one, other).ravel())


def _codes(loom: Loom, text: str) -> Nodes:
    """The characters of a text as numbers."""
    return constants(loom, [[float(ord(one)) for one in text]]) if text else EMPTY


def _form(held: Held) -> object:
    """What two values that are equal have in common for certain."""
    if isinstance(held, str):
        return str(held)
    if isinstance(held, Struct):
        return frozenset(held.fields)
    return ("cell", held.shape) if isinstance(held, Cells) else array_of(held).shape


@function("ismember", least=2, most=2)
def is_member(given: Given) -> Held:
    """Whether elements are among those of an array, or a text among cells of texts."""
    held, among = given.held[0], given.held[1]
    if isinstance(among, Cells) and isinstance(held, str):
        return _fixed(given, held in among.cells)
    if isinstance(held, String) or isinstance(among, String):
        if not (isinstance(held, str) and isinstance(among, str)):
            raise given.refuse("a string stands beside what is none")
        return _fixed(given, held == among)
    loom = given.calls.loom
    one, other = (_codes(loom, part) if isinstance(part, str) else array_of(part) for part in (held, among))
    made = np.full(one.shape, loom.const(0.0), dtype=np.int64)
    given.calls.desk.room(float(made.size) * other.size)
    for node in other.ravel(order="F"):
        same = each(loom, "eq", one, node.reshape(1, 1))
        made = each(loom, "or", made, same)
    return truths(made)
