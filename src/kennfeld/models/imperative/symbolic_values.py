"""What a variable of code holds while a graph is built: arrays of nodes, texts, structs, cells, functions.

None of them is ever changed: an assignment to an element makes a new one.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from kennfeld.graph import GraphBuilder
from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.evaluation_errors import CodeError
from kennfeld.models.imperative.integer_types import Word
from kennfeld.models.imperative.node_arrays import Nodes

__all__ = [
    "EMPTY",
    "Cells",
    "Handle",
    "Held",
    "Later",
    "Members",
    "Partial",
    "String",
    "Struct",
    "Truths",
    "Unclear",
    "array_of",
    "constants",
    "field_of",
    "integers",
    "leaves",
    "of_class",
    "rebuilt",
    "resolved",
    "said",
    "truths",
    "word_of",
]

EMPTY: Final[Nodes] = np.zeros((0, 0), dtype=np.int64)


class Truths(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """An array of nodes whose class is logical, so that as an index it is a mask."""


class String(str):
    """A text in double quotes: one element, where one in single quotes is a row of characters."""

    __slots__ = ()


class Integers(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """An array of nodes that have an integer type by their class; the values themselves stay physical."""

    word: Word | None = None

    def __array_finalize__(self, origin: object) -> None:
        self.word = getattr(origin, "word", None)


@dataclass(frozen=True, eq=False)
class Struct:
    """A struct of one element, its fields in their order."""

    fields: "Mapping[str, Held]"


@dataclass(frozen=True, eq=False)
class Members(Struct):
    """An enumeration by its members, each a whole number."""


@dataclass(frozen=True, eq=False)
class Cells:
    """A cell array, column by column."""

    cells: "tuple[Held, ...]"
    shape: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Handle:
    """`@name`, or `@(x) expression` with the variables that it has taken with it."""

    function: m.FunctionHandle | m.AnonymousFunction
    names: "Mapping[str, Held]"


@dataclass(frozen=True, eq=False)
class Partial:
    """A variable that has a value only where the condition `defined` holds."""

    value: "Held"
    defined: int


@dataclass(frozen=True, eq=False)
class Unclear:
    """A variable that cannot be used; `why` says what it is."""

    why: str
    mend: str = ""


@dataclass(frozen=True, eq=False)
class Later:
    """A value that is made when it is used; `name` is that of the parameter where it is an array that is one.

    Until then it may become a table instead.
    """

    make: "Callable[[], Held]"
    name: str = ""


Held: TypeAlias = Nodes | str | Struct | Cells | Handle | Partial | Unclear | Later


def truths(nodes: Nodes) -> Nodes:
    """Nodes that are known to be true or false."""
    return nodes.view(Truths)


def integers(nodes: Nodes, word: Word | None) -> Nodes:
    """Nodes with an integer type by their class; without one as they are."""
    made = np.asarray(nodes)
    if word is None:
        return made
    typed = made.view(Integers)
    typed.word = word
    return typed


def word_of(*arrays: Nodes) -> Word | None:
    """The integer type of the first array that has one, which what is made of several has too."""
    return next((one.word for one in arrays if isinstance(one, Integers)), None)


def of_class(model: Nodes, nodes: Nodes) -> Nodes:
    """Nodes with the class of an array: logical, an integer type, or none."""
    if isinstance(model, Truths):
        return truths(np.asarray(nodes))
    return integers(nodes, word_of(model))


def constants(builder: GraphBuilder, numbers: object) -> Nodes:
    """An array of constants, at least of two dimensions; of class logical where the numbers are."""
    array = np.atleast_2d(np.asarray(numbers))
    made = np.array([builder.const(float(number)) for number in array.ravel()], dtype=np.int64).reshape(array.shape)
    return truths(made) if array.dtype == np.bool_ else made


def array_of(held: Held, what: str = "it") -> Nodes:
    """A value as an array of nodes; raises `CodeError` where it is none."""
    if isinstance(held, np.ndarray):
        while held.ndim > 2 and held.shape[-1] == 1:
            held = held[..., 0]
        return held
    if isinstance(held, Unclear):
        raise CodeError(held.why, held.mend)
    raise CodeError(f"{what} is {said(held)}, not a number")


def resolved(held: Held) -> Held:
    """A value, made now where it is made when it is used."""
    while isinstance(held, Later):
        held = held.make()
    return held


def said(held: Held) -> str:
    """What kind of value it is, in words."""
    if isinstance(held, np.ndarray):
        return f"an array of {'x'.join(map(str, held.shape))}"
    kinds = {str: "a text", String: "a string", Struct: "a struct", Cells: "a cell array", Handle: "a function"}
    return kinds.get(type(held), "a variable without a value in every case")


def field_of(held: Held, name: str, what: str = "it") -> Held:
    """A field of a struct; raises `CodeError` where it has none of that name."""
    if isinstance(held, Unclear):
        raise CodeError(held.why, held.mend)
    if not isinstance(held, Struct):
        raise CodeError(f"{what} is {said(held)}, which has no field {name}")
    if name not in held.fields:
        raise CodeError(f"{what} has no field {name}; it has {', '.join(list(held.fields)[:8]) or 'none'}")
    return resolved(held.fields[name])


def leaves(held: Held) -> Iterator[Nodes]:
    """The arrays within a value, in order; raises `CodeError` where there is something else in it."""
    if isinstance(held, Struct):
        for name in held.fields:
            yield from leaves(field_of(held, name))
    elif isinstance(held, Cells):
        for cell in held.cells:
            yield from leaves(resolved(cell))
    else:
        yield array_of(held)


def rebuilt(held: Held, arrays: Iterator[Nodes]) -> Held:
    """A value of the same form with other arrays, taken in the order of `leaves`."""
    if isinstance(held, Struct):
        return Struct({name: rebuilt(field_of(held, name), arrays) for name in held.fields})
    if isinstance(held, Cells):
        return Cells(tuple(rebuilt(resolved(cell), arrays) for cell in held.cells), held.shape)
    made = next(arrays)
    return of_class(held, made) if isinstance(held, np.ndarray) else made
