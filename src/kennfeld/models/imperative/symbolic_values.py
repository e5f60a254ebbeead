"""What a variable of code holds while a graph is built: arrays of nodes, texts, structs, cells, functions.

None of them is ever changed: an assignment to an element makes a new one.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from kennfeld.graph import GraphBuilder
from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.node_arrays import Nodes

__all__ = [
    "EMPTY",
    "ConditionalValue",
    "DeferredValue",
    "EnumerationStruct",
    "FunctionHandleValue",
    "InvalidValue",
    "LogicalNodes",
    "String",
    "SymbolicCell",
    "SymbolicStruct",
    "SymbolicValue",
    "as_array",
    "as_logical",
    "constants",
    "describe",
    "field_of",
    "force",
    "integers",
    "leaf_arrays",
    "of_class",
    "with_leaf_arrays",
    "word_of",
]

EMPTY: Final[Nodes] = np.zeros((0, 0), dtype=np.int64)


class LogicalNodes(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """An array of nodes whose class is logical, so that as an index it is a mask."""


class String(str):
    """A text in double quotes: one element, where one in single quotes is a row of characters."""

    __slots__ = ()


class Integers(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """An array of nodes that have an integer type by their class; the values themselves stay physical."""

    word: IntegerType | None = None

    def __array_finalize__(self, origin: object) -> None:
        self.word = getattr(origin, "word", None)


@dataclass(frozen=True, eq=False)
class SymbolicStruct:
    """A struct of one element, its fields in their order."""

    fields: "Mapping[str, SymbolicValue]"


@dataclass(frozen=True, eq=False)
class EnumerationStruct(SymbolicStruct):
    """An enumeration by its members, each a whole number."""


@dataclass(frozen=True, eq=False)
class SymbolicCell:
    """A cell array, column by column."""

    cells: "tuple[SymbolicValue, ...]"
    shape: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class FunctionHandleValue:
    """`@name`, or `@(x) expression` with the variables that it has taken with it."""

    function: m.FunctionHandle | m.AnonymousFunction
    names: "Mapping[str, SymbolicValue]"


@dataclass(frozen=True, eq=False)
class ConditionalValue:
    """A variable that has a value only where the condition `defined` holds."""

    value: "SymbolicValue"
    defined: int


@dataclass(frozen=True, eq=False)
class InvalidValue:
    """A variable that cannot be used; `why` says what it is."""

    why: str
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class DeferredValue:
    """A value that is made when it is used; `name` is that of the parameter where it is an array that is one.

    Until then it may become a table instead.
    """

    make: "Callable[[], SymbolicValue]"
    name: str = ""


SymbolicValue: TypeAlias = (
    Nodes | str | SymbolicStruct | SymbolicCell | FunctionHandleValue | ConditionalValue | InvalidValue | DeferredValue
)


def as_logical(nodes: Nodes) -> Nodes:
    """Nodes that are known to be true or false."""
    return nodes.view(LogicalNodes)


def integers(nodes: Nodes, word: IntegerType | None) -> Nodes:
    """Nodes with an integer type by their class; without one as they are."""
    made = np.asarray(nodes)
    if word is None:
        return made
    typed = made.view(Integers)
    typed.word = word
    return typed


def word_of(*arrays: Nodes) -> IntegerType | None:
    """The integer type of the first array that has one, which what is made of several has too."""
    return next((one.word for one in arrays if isinstance(one, Integers)), None)


def of_class(model: Nodes, nodes: Nodes) -> Nodes:
    """Nodes with the class of an array: logical, an integer type, or none."""
    if isinstance(model, LogicalNodes):
        return as_logical(np.asarray(nodes))
    return integers(nodes, word_of(model))


def constants(builder: GraphBuilder, numbers: object) -> Nodes:
    """An array of constants, at least of two dimensions; of class logical where the numbers are."""
    array = np.atleast_2d(np.asarray(numbers))
    made = np.array([builder.const(float(number)) for number in array.ravel()], dtype=np.int64).reshape(array.shape)
    return as_logical(made) if array.dtype == np.bool_ else made


def as_array(held: SymbolicValue, message: str = "it") -> Nodes:
    """A value as an array of nodes; raises `CodeError` where it is none."""
    if isinstance(held, np.ndarray):
        while held.ndim > 2 and held.shape[-1] == 1:
            held = held[..., 0]
        return held
    if isinstance(held, InvalidValue):
        raise ProgramError(held.why, held.remedy)
    raise ProgramError(f"{message} is {describe(held)}, not a number")


def force(held: SymbolicValue) -> SymbolicValue:
    """A value, made now where it is made when it is used."""
    while isinstance(held, DeferredValue):
        held = held.make()
    return held


def describe(held: SymbolicValue) -> str:
    """What kind of value it is, in words."""
    if isinstance(held, np.ndarray):
        return f"an array of {'x'.join(map(str, held.shape))}"
    kinds = {
        str: "a text",
        String: "a string",
        SymbolicStruct: "a struct",
        SymbolicCell: "a cell array",
        FunctionHandleValue: "a function",
    }
    return kinds.get(type(held), "a variable without a value in every case")


def field_of(held: SymbolicValue, name: str, message: str = "it") -> SymbolicValue:
    """A field of a struct; raises `CodeError` where it has none of that name."""
    if isinstance(held, InvalidValue):
        raise ProgramError(held.why, held.remedy)
    if not isinstance(held, SymbolicStruct):
        raise ProgramError(f"{message} is {describe(held)}, which has no field {name}")
    if name not in held.fields:
        raise ProgramError(f"{message} has no field {name}; it has {', '.join(list(held.fields)[:8]) or 'none'}")
    return force(held.fields[name])


def leaf_arrays(held: SymbolicValue) -> Iterator[Nodes]:
    """The arrays within a value, in order; raises `CodeError` where there is something else in it."""
    if isinstance(held, SymbolicStruct):
        for name in held.fields:
            yield from leaf_arrays(field_of(held, name))
    elif isinstance(held, SymbolicCell):
        for cell in held.cells:
            yield from leaf_arrays(force(cell))
    else:
        yield as_array(held)


def with_leaf_arrays(held: SymbolicValue, arrays: Iterator[Nodes]) -> SymbolicValue:
    """A value of the same form with other arrays, taken in the order of `leaves`."""
    if isinstance(held, SymbolicStruct):
        return SymbolicStruct({name: with_leaf_arrays(field_of(held, name), arrays) for name in held.fields})
    if isinstance(held, SymbolicCell):
        return SymbolicCell(tuple(with_leaf_arrays(force(cell), arrays) for cell in held.cells), held.shape)
    made = next(arrays)
    return of_class(held, made) if isinstance(held, np.ndarray) else made
