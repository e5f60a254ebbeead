"""Initial values of elements as arrays of numbers, by the fields of structs."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from kennfeld.ascet import syntax as e
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.ascet.declarations import FileScope
from kennfeld.importers.ascet.resolved_types import (
    Fields,
    NumberType,
    ResolvedArray,
    ResolvedTable,
    StructType,
    Type,
)
from kennfeld.importers.ascet.type_resolution import TypeResolver, dotted
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError, unsupported_error

Leaves: TypeAlias = dict[Fields, Float]
Elements: TypeAlias = Callable[[str], Leaves | None]  # the values of another element of the class by its name


@dataclass(frozen=True)
class TableValues:
    """Breakpoints of each axis and the values of a table, `Float[x, y]`."""

    axes: tuple[Float, ...]
    values: Float


@dataclass(frozen=True)
class InitialValues:
    """Evaluates initial values; `elements` returns those of another element of the class."""

    types: TypeResolver
    scope: FileScope
    elements: Elements

    def leaves(self, kind: Type, value: e.Expression | None) -> Leaves:
        """Return the numbers of a type that an expression defines; those that it leaves out have their default."""
        # `Speeds copy = other;`: the values are those of the other element, whatever its type
        known = self.elements(dotted(value)) if isinstance(value, e.Name) else None
        if known is not None:
            return known
        match kind:
            case NumberType():
                return {(): np.array(self._number(kind, value))}
            case StructType(_, elements):
                return self._struct(elements, value)
            case ResolvedArray():
                return self._array(kind, value)
        raise UnsupportedEsdlError("an element of this type has no initial value here")

    def _number(self, kind: NumberType, value: e.Expression | None) -> float:
        if value is None:
            return kind.default
        if isinstance(value, e.Name) and value.name in dict(kind.labels):
            return float(dict(kind.labels)[value.name])
        return self.types.constant(value, self.scope)

    def _struct(self, elements: tuple[tuple[str, Type], ...], value: e.Expression | None) -> Leaves:
        parts = self._parts(value, len(elements))
        result: Leaves = {}
        for (name, kind), part in zip(elements, parts, strict=True):
            result |= {(name, *path): numbers for path, numbers in self.leaves(kind, part).items()}
        return result

    def _array(self, kind: ResolvedArray, value: e.Expression | None) -> Leaves:
        # one dimension at a time, so that rows may be left out at the end as numbers may
        size = kind.dimensions[0].size
        if size is None:
            if not isinstance(value, e.Braces):
                raise UnsupportedEsdlError("an array without a size", "Write the size behind its name.")
            size = len(value.elements)
        rest = kind.dimensions[1:]
        inner: Type = ResolvedArray(rest, kind.element) if rest else kind.element
        parts = [self.leaves(inner, part) for part in self._parts(value, size)]
        # the first index first: Float[sizes of the array, sizes within the element]
        return {path: np.stack([part[path] for part in parts]) for path in parts[0]} if parts else {}

    def _parts(self, value: e.Expression | None, count: int) -> list[e.Expression | None]:
        if value is None:
            return [None] * count
        if isinstance(value, e.Unsupported):
            raise unsupported_error(value)
        if not isinstance(value, e.Braces):
            raise UnsupportedEsdlError("expected the elements in { }", place=value.place)
        if len(value.elements) > count:
            raise UnsupportedEsdlError(f"{len(value.elements)} elements, expected {count}", place=value.place)
        return [*value.elements, *[None] * (count - len(value.elements))]

    def table(self, kind: ResolvedTable, value: e.Expression | None, shared: tuple[Float, ...] | None) -> TableValues:
        """Return breakpoints and values of a table; `shared` are the breakpoints of a group table."""
        if value is None:
            raise UnsupportedEsdlError("a table without values", "Write its breakpoints and values.")
        if isinstance(value, e.Unsupported):
            raise unsupported_error(value)
        parts = self._numbers(value)
        if shared is not None:
            values = _array_of(parts, value)
            return TableValues(shared, _fitting(values, shared, value))
        if not isinstance(parts, list) or len(parts) != len(kind.axes) + 1:
            raise UnsupportedEsdlError(
                f"a table of {len(kind.axes)} axes needs {len(kind.axes) + 1} groups in {{ }}", place=value.place
            )
        values = _array_of(parts[-1], value)
        axes = tuple(
            _breakpoints(_array_of(part, value), count, kind.form)
            for part, count in zip(parts[:-1], values.shape, strict=False)
        )
        return TableValues(axes, _fitting(values, axes, value))

    def axis(self, value: e.Expression | None) -> Float:
        """Return the breakpoints of an axis."""
        if value is None:
            raise UnsupportedEsdlError("an axis without breakpoints", "Write them in { }.")
        return _array_of(self._numbers(value), value)

    def _numbers(self, value: e.Expression) -> float | list[Any]:
        if isinstance(value, e.Braces):
            return [self._numbers(part) for part in value.elements]
        return self.types.constant(value, self.scope)


def _array_of(parts: object, value: e.Expression) -> Float:
    try:
        return np.array(parts, dtype=np.float64)
    except ValueError:
        raise UnsupportedEsdlError("rows of different lengths", place=value.place) from None


def _breakpoints(points: Float, count: int, form: str) -> Float:
    """Return the breakpoints of an axis; a fixed one may be given by its first breakpoint and their distance."""
    # two numbers for two values are the breakpoints themselves
    if form == "fixed" and points.shape == (2,) and count != 2:
        return np.asarray(points[0] + points[1] * np.arange(count))
    return points


def _fitting(values: Float, axes: tuple[Float, ...], value: e.Expression) -> Float:
    shape = tuple(axis.size for axis in axes)
    if any(axis.ndim != 1 for axis in axes) or values.shape != shape:
        stated = " x ".join(map(str, shape))
        got = " x ".join(map(str, values.shape)) or "1"
        raise UnsupportedEsdlError(f"the table has {got} values, its axes require {stated}", place=value.place)
    if any(np.any(np.diff(axis) <= 0) for axis in axes):
        raise UnsupportedEsdlError("the breakpoints of a table do not increase", place=value.place)
    return values
