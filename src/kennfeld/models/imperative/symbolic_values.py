"""Values of variables in lowered code: arrays of nodes, texts, and the structs, cells and functions of MATLAB.

All are immutable: an assignment to an element creates a new value. Structs have one element.
"""

from collections.abc import Callable, Iterator
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import GraphBuilder
from kennfeld.matlab.values import MatlabCell, MatlabFunctionHandle, MatlabStruct, trim_dimensions
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.node_arrays import Nodes, format_sizes

EMPTY: Final[Nodes] = np.zeros((0, 0), dtype=np.int64)


class LogicalNodes(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """Array of nodes of class logical, which is a mask if used as an index."""


class FoundIndex(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """Node of an index that `find` returns: NaN if there is none, where MATLAB has an empty array."""


class String(str):
    """Text in double quotes: one element, whereas text in single quotes is a row of characters."""

    __slots__ = ()


class Integers(np.ndarray[tuple[int, ...], np.dtype[np.int64]]):
    """Array of nodes of an integer class; the values themselves stay physical."""

    word: IntegerType | None = None

    def __array_finalize__(self, origin: object) -> None:
        self.word = getattr(origin, "word", None)


@dataclass(frozen=True, eq=False)
class ConditionalValue:
    """A variable that has a value only where the condition `defined` holds."""

    value: "SymbolicValue"
    defined: int


@dataclass(frozen=True, eq=False)
class InvalidValue:
    """A variable that cannot be used, with the reason `why`."""

    why: str
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class VaryingArray(InvalidValue):
    """An array whose size depends on conditions, of which exactly one holds; each comes with the array of a size.

    What reads it is evaluated for each size. Where that is not possible, it cannot be used.
    """

    options: tuple[tuple[int, Nodes], ...] = ()


@dataclass(frozen=True, eq=False)
class DeferredValue:
    """A value computed on first use; `name` is that of the parameter if it is an array parameter.

    Until then it may become a table instead.
    """

    make: "Callable[[], SymbolicValue]"
    name: str = ""


SymbolicValue: TypeAlias = (
    Nodes | str | MatlabStruct | MatlabCell | MatlabFunctionHandle | ConditionalValue | InvalidValue | DeferredValue
)


def as_logical(nodes: Nodes) -> Nodes:
    """Mark nodes as logical."""
    return nodes.view(LogicalNodes)


def integers(nodes: Nodes, word: IntegerType | None) -> Nodes:
    """Mark nodes as of an integer class; None leaves them unmarked."""
    result = np.asarray(nodes)
    if word is None:
        return result
    typed = result.view(Integers)
    typed.word = word
    return typed


def word_of(*arrays: Nodes) -> IntegerType | None:
    """Return the integer class of the first array that has one; results of several arrays take it over."""
    return next((array.word for array in arrays if isinstance(array, Integers)), None)


def of_class(model: Nodes, nodes: Nodes) -> Nodes:
    """Return nodes with the class of `model`: logical, an integer type, or none."""
    if isinstance(model, LogicalNodes):
        return as_logical(np.asarray(nodes))
    return integers(nodes, word_of(model))


def constants(builder: GraphBuilder, numbers: object) -> Nodes:
    """Return an array of constants of at least two dimensions; of class logical if the numbers are."""
    array = np.atleast_2d(np.asarray(numbers))
    result = np.array([builder.const(float(number)) for number in array.ravel()], dtype=np.int64).reshape(array.shape)
    return as_logical(result) if array.dtype == np.bool_ else result


def as_array(value: SymbolicValue, message: str = "it") -> Nodes:
    """Return a value as an array of nodes; raises `ProgramError` if it is not an array."""
    if isinstance(value, np.ndarray):
        return trim_dimensions(value)
    if isinstance(value, InvalidValue):
        raise ProgramError(value.why, value.remedy)
    raise ProgramError(f"{message} is {describe(value)}, not a number")


class StructArrayError(ProgramError):
    """A field of an array of structs, which has several values."""


def force(value: SymbolicValue) -> SymbolicValue:
    """Return a value, computing it if deferred."""
    while isinstance(value, DeferredValue):
        value = value.make()
    return value


def describe(value: SymbolicValue) -> str:
    """Return the kind of a value in words."""
    if isinstance(value, np.ndarray):
        return f"an array of {format_sizes(value)}"
    kinds = {
        str: "a text", String: "a string", MatlabStruct: "a struct", MatlabCell: "a cell array",
        MatlabFunctionHandle: "a function",
    }  # fmt: skip
    return kinds.get(type(value), "a variable that is not assigned in every case")


def field_of(value: SymbolicValue, name: str, message: str = "it") -> SymbolicValue:
    """Return a field of a struct; raises `ProgramError` if there is none of that name."""
    if isinstance(value, InvalidValue):
        raise ProgramError(value.why, value.remedy)
    if not isinstance(value, MatlabStruct):
        raise ProgramError(f"{message} is {describe(value)}, which has no field {name}")
    check_single(value, message)
    if name not in value.fields:
        raise ProgramError(f"{message} has no field {name}; it has {', '.join(list(value.fields)[:8]) or 'none'}")
    return force(value.fields[name])


def check_single(value: MatlabStruct, message: str = "it") -> None:
    """Raise `ProgramError` for an array of structs, whose fields have several values."""
    if value.elements.size != 1:
        count = value.elements.size
        raise StructArrayError(f"{message} is an array of {count} structs, of which one must be selected")


def leaf_arrays(value: SymbolicValue) -> Iterator[Nodes]:
    """Yield the arrays within a value, in order; raises `ProgramError` if it contains anything else."""
    if isinstance(value, MatlabStruct):
        check_single(value)
        for name in value.fields:
            yield from leaf_arrays(field_of(value, name))
    elif isinstance(value, MatlabCell):
        for cell in value.contents:
            yield from leaf_arrays(force(cell))
    else:
        yield as_array(value)


def with_leaf_arrays(value: SymbolicValue, arrays: Iterator[Nodes]) -> SymbolicValue:
    """Return a value of the same form with other arrays, in the order of `leaf_arrays`."""
    if isinstance(value, MatlabStruct):
        return MatlabStruct.of({name: with_leaf_arrays(field_of(value, name), arrays) for name in value.fields})
    if isinstance(value, MatlabCell):
        return MatlabCell.of((with_leaf_arrays(force(cell), arrays) for cell in value.contents), value.values.shape)
    result = next(arrays)
    return of_class(value, result) if isinstance(value, np.ndarray) else result
