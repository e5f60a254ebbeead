"""Compares two parameter sets: values, axes, units, and labels that only one of them has."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

_Item = Parameter | Text | Axis
_LETTERS = ("x", "y", "z", "u")


@dataclass(frozen=True)
class Tolerance:
    """The largest difference that counts as equal: `absolute + relative * max(|a|, |b|)`.

    Without tolerance only the same number is equal; two missing values (NaN) are, and so are 0 and -0.

    >>> bool(Tolerance(relative=1e-3).exceeded(np.array(1000.0), np.array(1000.5)))
    False
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        for name, given in (("absolute", self.absolute), ("relative", self.relative)):
            if not (isfinite(given) and given >= 0):
                raise ArgumentError(f"{name} must be a finite number >= 0, got {given!r}")

    def exceeded(self, left: Float, right: Float) -> Bool:
        """Return a mask of the elements that differ by more than the tolerance.

        Args:
            left: Values of any shape.
            right: Values of the same shape and unit.

        Returns:
            A boolean array of that shape.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            allowed = self.absolute + self.relative * np.maximum(np.abs(left), np.abs(right))
            far: Bool = ~(np.abs(left - right) <= allowed) & (left != right)
            known: Bool = ~(np.isnan(left) & np.isnan(right))
        return np.logical_and(far, known)


@dataclass(frozen=True)
class Difference:
    """One difference of two sets.

    `name` is followed by the variant where a label has several: `K (Engine=2)`; `function` is the first one that uses
    it, empty if none is known. `aspect` is values, kind, size, unit, text, content, "x axis" and the like, or
    "presence" where only one set has it: the other side is empty then. Numbers carry how many of them differ, the
    largest difference and its index.
    """

    name: str
    aspect: str
    left: str
    right: str
    count: int = 0
    total: int = 0
    largest: float | None = None  # infinite where one side has no value
    index: tuple[int, ...] = ()  # of the largest difference
    place: str = ""  # the same in the words of the axes
    function: str = ""

    @property
    def as_json(self) -> dict[str, Any]:
        """The difference for a program; `largest` is null where one side has no value."""
        plain: dict[str, Any] = {"name": self.name, "aspect": self.aspect, "left": self.left, "right": self.right}
        plain |= {"function": self.function}
        if self.largest is None:
            return plain
        numbers = {"left": float(self.left), "right": float(self.right)}
        largest = self.largest if isfinite(self.largest) else None
        plain |= {side: number if isfinite(number) else None for side, number in numbers.items()}
        return plain | {"count": self.count, "total": self.total, "largest": largest, "index": list(self.index)}


@dataclass(frozen=True)
class Comparison:
    """All differences of two sets, in the order of the first; `compared` is the number of common names."""

    differences: tuple[Difference, ...]
    compared: int

    @property
    def equal(self) -> bool:
        """True if there is no difference."""
        return not self.differences


def compare(left: ParameterSet, right: ParameterSet, tolerance: Tolerance | None = None) -> Comparison:
    """Compare values, axes, units, kinds, texts and names of two sets.

    Tables of different size are not compared by value. Breakpoints of a group axis of both sets are compared once.
    Variants are compared by name. Descriptions, bounds, locks, axis inputs and extrapolation are not compared, because
    most formats do not store them.

    Args:
        left: The first set.
        right: The second set.
        tolerance: The largest difference that counts as equal; none by default.

    Returns:
        All differences, in the order of `left`.
    """
    allowed = tolerance or Tolerance()
    results: list[Difference] = []
    compared = 0
    for name, one, other in _pair_items(left, right):
        if one is None or other is None:
            result = [Difference(name, "presence", _describe_item(one), _describe_item(other))]
        else:
            compared += 1
            result = [replace(difference, name=name) for difference in _differences(one, other, allowed)]
        function = _function(one) or _function(other)
        results += [replace(difference, function=function) for difference in result] if function else result
    return Comparison(tuple(results), compared)


def _pair_items(left: ParameterSet, right: ParameterSet) -> Iterator[tuple[str, _Item | None, _Item | None]]:
    """Yield the items to compare with their common name; None for a side without it."""
    ours, theirs = _items_by_name(left), _items_by_name(right)
    for name in dict.fromkeys([*ours, *theirs]):
        mine, its = ours.get(name, {}), theirs.get(name, {})
        if mine.keys() & its.keys() or not (mine and its):
            for variant in dict.fromkeys([*mine, *its]):
                yield _label_with_variant(name, variant), mine.get(variant), its.get(variant)
        else:  # one of them knows no variants: what counts there is compared with what counts here
            (_, one), *more = mine.items()
            (_, other), *further = its.items()
            yield name, one, other
            yield from ((_label_with_variant(name, variant), item, None) for variant, item in more)
            yield from ((_label_with_variant(name, variant), None, item) for variant, item in further)


def _label_with_variant(name: str, variant: str) -> str:
    return f"{name} ({variant})" if variant else name


def _function(item: _Item | None) -> str:
    return "" if item is None or isinstance(item, Axis) or not item.functions else item.functions[0]


def _items_by_name(members: ParameterSet) -> dict[str, dict[str, _Item]]:
    """Return all named items by variant; if a table and a group axis share a name, it is the table."""
    items: dict[str, dict[str, _Item]] = {}
    for (name, variant), item in members.everything.items():
        items.setdefault(name, {})[variant] = item
    for axis in members.axes:
        items.setdefault(axis.name, {"": axis})
    return items


def _differences(one: _Item, other: _Item, allowed: Tolerance) -> list[Difference]:
    if isinstance(one, Text) and isinstance(other, Text):
        pairs = {aspect: (getattr(one, aspect), getattr(other, aspect)) for aspect in ("kind", "text", "unit")}
        return [Difference(one.name, aspect, *pair) for aspect, pair in pairs.items() if pair[0] != pair[1]]
    if isinstance(one, Axis) and isinstance(other, Axis):
        return list(_axis_differences(one.name, "", one, other, allowed))
    if isinstance(one, Parameter) and isinstance(other, Parameter) and one.kind == other.kind:
        return list(_member_differences(one, other, allowed))
    return [
        Difference(one.name, "kind", _describe_item(one), _describe_item(other)),
        *_block_differences(one, other, allowed),
    ]


def _block_differences(one: _Item, other: _Item, allowed: Tolerance) -> Iterator[Difference]:
    """Compare values if one set has a table or axis and the other only a block of its numbers."""
    left, right = _numbers(one), _numbers(other)
    if left is None or right is None or left.shape != right.shape:
        return
    if any(isinstance(item, Parameter) and item.kind == "block" for item in (one, other)):
        axes = next((item.axes for item in (one, other) if isinstance(item, Parameter) and item.axes), ())
        yield from _number_differences(one.name, "values", left, right, allowed, axes)


def _numbers(item: _Item) -> Float | None:
    if isinstance(item, Axis):
        return item.breakpoints
    return item.values if isinstance(item, Parameter) else None


def _member_differences(one: Parameter, other: Parameter, allowed: Tolerance) -> Iterator[Difference]:
    if one.values.shape != other.values.shape:
        yield Difference(one.name, "size", _size(one.values), _size(other.values))
    else:
        yield from _number_differences(one.name, "values", one.values, other.values, allowed, one.axes)
    for letter, mine, theirs in zip(_LETTERS, one.axes, other.axes, strict=False):
        if mine.name != theirs.name:
            yield Difference(one.name, f"{letter} group axis", mine.name or "none", theirs.name or "none")
        if not mine.name or mine.name != theirs.name:
            yield from _axis_differences(one.name, f"{letter} ", mine, theirs, allowed)
        elif mine.unit != theirs.unit:
            yield Difference(one.name, f"{letter} unit", mine.unit, theirs.unit)
    if one.unit != other.unit:
        yield Difference(one.name, "unit", one.unit, other.unit)
    if one.kind == "rbf" and np.array_equal(one.values, other.values) and not np.array_equal(one.packed, other.packed):
        yield Difference(one.name, "content", "an expansion", "another expansion")


def _axis_differences(name: str, prefix: str, one: Axis, other: Axis, allowed: Tolerance) -> Iterator[Difference]:
    if len(one) != len(other):
        yield Difference(name, f"{prefix}breakpoints", f"{len(one)} points", f"{len(other)} points")
    else:
        aspect = f"{prefix}breakpoints"
        yield from _number_differences(name, aspect, one.breakpoints, other.breakpoints, allowed, ())
    if one.unit != other.unit:
        yield Difference(name, f"{prefix}unit", one.unit, other.unit)


def _number_differences(
    name: str, aspect: str, left: Float, right: Float, allowed: Tolerance, axes: tuple[Axis, ...]
) -> Iterator[Difference]:
    far = allowed.exceeded(left, right)
    if not far.any():
        return
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(left - right)
    # Where one side has no value nothing is farther apart.
    apart = np.where(far, np.where(np.isnan(apart), np.inf, apart), -1.0)
    index = tuple(int(i) for i in np.unravel_index(int(apart.argmax()), apart.shape))
    shown = (repr(float(left[index])), repr(float(right[index])))
    largest, place = float(apart[index]), _describe_place(index, axes)
    yield Difference(name, aspect, *shown, int(far.sum()), far.size, largest, index, place)


def _describe_place(index: tuple[int, ...], axes: tuple[Axis, ...]) -> str:
    if axes:
        points = (f"{axis.breakpoints[at]:g}" for axis, at in zip(axes, index, strict=True))
        return ", ".join(f"{letter} = {point}" for letter, point in zip(_LETTERS, points, strict=False))
    return f"[{', '.join(map(str, index))}]" if index else ""


def _describe_item(item: _Item | None) -> str:
    if item is None:
        return ""
    if isinstance(item, Axis):
        return f"group axis of {len(item)}"
    if isinstance(item, Text):
        return item.kind
    return f"{item.kind} of {_size(item.values)}" if item.values.ndim else item.kind


def _size(values: Float) -> str:
    return " x ".join(map(str, values.shape))
