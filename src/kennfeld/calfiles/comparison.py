"""What distinguishes two parameter sets: values, axes, units, and what only one of them has."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["Comparison", "Difference", "Tolerance", "compare"]

_Thing = Parameter | Text | Axis
_LETTERS = ("x", "y", "z", "u")


@dataclass(frozen=True)
class Tolerance:
    """How far two numbers may be apart and still count as equal: `absolute + relative * max(|a|, |b|)`.

    Without tolerance only the same number is equal; two missing values (NaN) are, and so are 0 and -0.

    >>> bool(Tolerance(relative=1e-3).exceeded(np.array(1000.0), np.array(1000.5)))
    False
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        for name, given in (("absolute", self.absolute), ("relative", self.relative)):
            if not (isfinite(given) and given >= 0):
                raise ArgumentError(f"{name}={given!r} is no tolerance: it must be a number from 0 on")

    def exceeded(self, left: Float, right: Float) -> Bool:
        """Where two arrays of one shape differ by more than this."""
        with np.errstate(invalid="ignore", over="ignore"):
            allowed = self.absolute + self.relative * np.maximum(np.abs(left), np.abs(right))
            far: Bool = ~(np.abs(left - right) <= allowed) & (left != right)
            known: Bool = ~(np.isnan(left) & np.isnan(right))
        return np.logical_and(far, known)


@dataclass(frozen=True)
class Difference:
    """One thing in which two sets differ.

    `name` is followed by the variant where a label has several: `K (Engine=2)`; `function` is the first one that uses
    it, empty where none is known. `aspect` is values, kind, size, unit, text, content, "x axis" and the like, or
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
    """All differences of two sets, in the order of the first; `compared` counts the names that both have."""

    differences: tuple[Difference, ...]
    compared: int

    @property
    def equal(self) -> bool:
        """Whether there is no difference."""
        return not self.differences


def compare(left: ParameterSet, right: ParameterSet, tolerance: Tolerance | None = None) -> Comparison:
    """Every difference in values, axes, units, kinds, texts and names.

    Values of tables of another size are not compared. Breakpoints of a group axis that both sets have are compared
    once. Variants of a label are compared each with its own. Descriptions, bounds, locks, axis inputs and
    extrapolation are not compared: most formats have no place for them.
    """
    allowed = tolerance or Tolerance()
    found: list[Difference] = []
    compared = 0
    for name, one, other in _paired(left, right):
        if one is None or other is None:
            made = [Difference(name, "presence", _described(one), _described(other))]
        else:
            compared += 1
            made = [replace(difference, name=name) for difference in _differences(one, other, allowed)]
        function = _function(one) or _function(other)
        found += [replace(difference, function=function) for difference in made] if function else made
    return Comparison(tuple(found), compared)


def _paired(left: ParameterSet, right: ParameterSet) -> Iterator[tuple[str, _Thing | None, _Thing | None]]:
    """What is compared with what, under which name; None where one side has it not."""
    ours, theirs = _by_name(left), _by_name(right)
    for name in dict.fromkeys([*ours, *theirs]):
        mine, its = ours.get(name, {}), theirs.get(name, {})
        if mine.keys() & its.keys() or not (mine and its):
            for variant in dict.fromkeys([*mine, *its]):
                yield _labelled(name, variant), mine.get(variant), its.get(variant)
        else:  # one of them knows no variants: what counts there is compared with what counts here
            (_, one), *more = mine.items()
            (_, other), *further = its.items()
            yield name, one, other
            yield from ((_labelled(name, variant), thing, None) for variant, thing in more)
            yield from ((_labelled(name, variant), None, thing) for variant, thing in further)


def _labelled(name: str, variant: str) -> str:
    return f"{name} ({variant})" if variant else name


def _function(thing: _Thing | None) -> str:
    return "" if thing is None or isinstance(thing, Axis) or not thing.functions else thing.functions[0]


def _by_name(members: ParameterSet) -> dict[str, dict[str, _Thing]]:
    """Everything that has a name, by variant; where a table and a group axis share one, it stands for the table."""
    things: dict[str, dict[str, _Thing]] = {}
    for (name, variant), thing in members.everything.items():
        things.setdefault(name, {})[variant] = thing
    for axis in members.axes:
        things.setdefault(axis.name, {"": axis})
    return things


def _differences(one: _Thing, other: _Thing, allowed: Tolerance) -> list[Difference]:
    if isinstance(one, Text) and isinstance(other, Text):
        pairs = {aspect: (getattr(one, aspect), getattr(other, aspect)) for aspect in ("kind", "text", "unit")}
        return [Difference(one.name, aspect, *pair) for aspect, pair in pairs.items() if pair[0] != pair[1]]
    if isinstance(one, Axis) and isinstance(other, Axis):
        return list(_axis_differences(one.name, "", one, other, allowed))
    if isinstance(one, Parameter) and isinstance(other, Parameter) and one.kind == other.kind:
        return list(_member_differences(one, other, allowed))
    return [
        Difference(one.name, "kind", _described(one), _described(other)),
        *_block_differences(one, other, allowed),
    ]


def _block_differences(one: _Thing, other: _Thing, allowed: Tolerance) -> Iterator[Difference]:
    """The values where one file has a table or axis, and the other, a script, a block of its numbers alone."""
    left, right = _numbers(one), _numbers(other)
    if left is None or right is None or left.shape != right.shape:
        return
    if any(isinstance(thing, Parameter) and thing.kind == "block" for thing in (one, other)):
        axes = next((thing.axes for thing in (one, other) if isinstance(thing, Parameter) and thing.axes), ())
        yield from _number_differences(one.name, "values", left, right, allowed, axes)


def _numbers(thing: _Thing) -> Float | None:
    if isinstance(thing, Axis):
        return thing.breakpoints
    return thing.values if isinstance(thing, Parameter) else None


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
        yield Difference(name, f"{prefix}breakpoints", f"{len(one)} of them", f"{len(other)} of them")
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
    largest, place = float(apart[index]), _place(index, axes)
    yield Difference(name, aspect, *shown, int(far.sum()), far.size, largest, index, place)


def _place(index: tuple[int, ...], axes: tuple[Axis, ...]) -> str:
    if axes:
        points = (f"{axis.breakpoints[at]:g}" for axis, at in zip(axes, index, strict=True))
        return ", ".join(f"{letter} = {point}" for letter, point in zip(_LETTERS, points, strict=False))
    return f"[{', '.join(map(str, index))}]" if index else ""


def _described(thing: _Thing | None) -> str:
    if thing is None:
        return ""
    if isinstance(thing, Axis):
        return f"group axis of {len(thing)}"
    if isinstance(thing, Text):
        return thing.kind
    return f"{thing.kind} of {_size(thing.values)}" if thing.values.ndim else thing.kind


def _size(values: Float) -> str:
    return " x ".join(map(str, values.shape))
