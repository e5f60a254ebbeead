"""Types of ESDL after names are resolved: numbers with their range, structs, arrays, tables and classes."""

import math
from collections.abc import Iterator
from dataclasses import field, replace
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from kennfeld.base.lazy_dataclass import dataclass

if TYPE_CHECKING:
    from kennfeld.importers.ascet.declarations import Declared

Kind: TypeAlias = Literal["real", "integer", "boolean", "enumeration"]


@dataclass(frozen=True)
class NumberType:
    """A number; the labels are those of an enumeration, with their numbers.

    `is_limited` is True for a real number that is limited to its range when it is assigned, as integers always are.
    """

    kind: Kind
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    labels: tuple[tuple[str, int], ...] = ()
    name: str = field(default="", compare=False)
    is_limited: bool = field(default=False, compare=False)

    @property
    def default(self) -> float:
        """The initial value of a variable without one."""
        return 0.0 if self.low <= 0 <= self.high else self.low

    @property
    def is_whole(self) -> bool:
        """True for integers and enumerations."""
        return self.kind in ("integer", "enumeration")


@dataclass(frozen=True)
class StructType:
    """A struct with its elements in order; `size` is the number of numbers and tables in it."""

    name: str
    elements: "tuple[tuple[str, Type], ...]"
    size: int = 0


@dataclass(frozen=True)
class Dimension:
    """A dimension of an array: its first index and its size, None if open; by label for an enumeration."""

    first: int = 0
    size: int | None = None
    enumeration: NumberType | None = None


@dataclass(frozen=True)
class ResolvedArray:
    """An array; `element` is not an array itself."""

    dimensions: tuple[Dimension, ...]
    element: "Type"


@dataclass(frozen=True)
class ResolvedTable:
    """A table over one or more axes; `form` is "", "fixed" or "group"; `axis_names` are the types of its axes."""

    axes: tuple[NumberType, ...]
    value: NumberType
    form: str = ""
    axis_names: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResolvedAxis:
    """Breakpoints that group tables share; `name` is that of the type."""

    element: NumberType
    name: str = ""


@dataclass(frozen=True)
class ClassType:
    """A class."""

    declared: "Declared"


Type: TypeAlias = NumberType | StructType | ResolvedArray | ResolvedTable | ResolvedAxis | ClassType

REAL: Final = NumberType("real")
BOOLEAN: Final = NumberType("boolean", 0.0, 1.0)
INTEGER: Final = NumberType("integer", -(2.0**31), 2.0**31 - 1)
Fields: TypeAlias = tuple[str, ...]


def size_of(kind: Type) -> int:
    """Return the number of numbers and tables in a type, an open dimension counted as 1."""
    match kind:
        case StructType():
            return kind.size
        case ResolvedArray(dimensions, element):
            return math.prod(dimension.size or 1 for dimension in dimensions) * size_of(element)
    return 1


def leaves_of(
    kind: Type,
) -> Iterator[tuple[Fields, "NumberType | ResolvedTable | ResolvedAxis", tuple[Dimension, ...]]]:
    """Yield the numbers and tables within a type: their path of fields, type, and dimensions."""
    match kind:
        case StructType(_, elements):
            for name, element in elements:
                for path, leaf, dimensions in leaves_of(element):
                    yield (name, *path), leaf, dimensions
        case ResolvedArray(own, element):
            for path, leaf, dimensions in leaves_of(element):
                yield path, leaf, (*own, *dimensions)
        case NumberType() | ResolvedTable() | ResolvedAxis():
            yield (), kind, ()


def with_sizes(kind: Type, other: Type) -> Type:
    """Return a type whose open dimensions are those of another type."""
    match kind, other:
        case ResolvedArray(own, element), ResolvedArray(dimensions) if len(own) == len(dimensions):
            sizes = (
                mine if mine.size is not None else replace(mine, size=its.size)
                for mine, its in zip(own, dimensions, strict=True)
            )
            return ResolvedArray(tuple(sizes), element)
    return kind


def is_open(kind: Type) -> bool:
    """Return True if a dimension of an array is not fixed."""
    return isinstance(kind, ResolvedArray) and any(dimension.size is None for dimension in kind.dimensions)


def describe_type(kind: Type) -> str:
    """Return a type in words."""
    match kind:
        case NumberType():
            return kind.name or kind.kind
        case StructType(name, _):
            return f"the struct {name}"
        case ResolvedArray():
            return "an array"
        case ResolvedTable():
            return "a table"
        case ResolvedAxis():
            return "an axis"
        case ClassType(declared):
            return f"the class {declared.name}"
