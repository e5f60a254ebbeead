"""Compares two parameter sets: values, axes, units, and labels that only one of them has."""

from collections.abc import Iterator
from dataclasses import field, replace
from math import isfinite
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import count_noun, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import RBF
from kennfeld.domain.texts import Text

_Item = Parameter | Text | Axis


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
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if not (isfinite(value) and value >= 0):
                raise ArgumentError(f"{name} must be a finite number >= 0, got {value!r}")

    def exceeded(self, left: Float, right: Float) -> Bool:
        """Return a mask of the elements that differ by more than the tolerance.

        Args:
            left: Values of any shape, Float[...].
            right: Values of the same shape and unit.

        Returns:
            Bool[...], of that shape.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            allowed = self.absolute + self.relative * np.maximum(np.abs(left), np.abs(right))
            # inf - inf is NaN, so equal infinite values need the second condition
            far: Bool = ~(np.abs(left - right) <= allowed) & (left != right)
            known: Bool = ~(np.isnan(left) & np.isnan(right))
        return np.logical_and(far, known)


@dataclass(frozen=True)
class Difference:
    """One difference of two sets.

    `name` is followed by the variant if a label has several: `K (Engine=2)`; `function` is the first one that uses
    it, empty if none is known. `aspect` is values, kind, size, unit, text, content, "x axis" and the like, or
    "presence" if only one set has it: the other side is empty then. Numbers carry how many of them differ, the
    largest difference and its index.
    """

    name: str
    aspect: str
    left: str
    right: str
    count: int = 0
    total: int = 0
    largest: float | None = None  # infinite if one side has no value
    index: tuple[int, ...] = ()  # of the largest difference
    place: str = ""  # the same in the words of the axes
    function: str = ""
    label: str = field(default="", compare=False)  # the name without the variant

    @property
    def as_json(self) -> dict[str, Any]:
        """The difference for a program; `largest` is null if one side has no value."""
        plain: dict[str, Any] = {key: getattr(self, key) for key in ("name", "aspect", "left", "right", "function")}
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

    def __str__(self) -> str:
        lines = [f"{each.name}: {each.aspect} {each.left} -> {each.right}" for each in self.differences]
        return "\n".join(lines) or f"{count_noun(self.compared, 'label')} without a difference"

    @property
    def equal(self) -> bool:
        """True if there is no difference."""
        return not self.differences

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the parameters, texts and group axes that differ, without variants."""
        return tuple(dict.fromkeys(difference.label for difference in self.differences))


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
    for label, variant, first, second in _pair_items(left, right):
        name = f"{label} ({variant})" if variant else label
        if first is None or second is None:
            differences = [Difference(name, "presence", _describe_item(first), _describe_item(second))]
        else:
            compared += 1
            differences = [replace(difference, name=name) for difference in _differences(first, second, allowed)]
        function = _function(first) or _function(second)
        results += [replace(difference, function=function, label=label) for difference in differences]
    return Comparison(tuple(results), compared)


def changed(parameters: ParameterSet, since: ParameterSet, tolerance: Tolerance | None = None) -> ParameterSet:
    """Return the parameters and texts that differ from those of another set, or that it does not have.

    A table whose group axis differs is among them. A file of the result is a new one, not a copy of that which the
    parameters were read from.

    Args:
        parameters: The set.
        since: The other one.
        tolerance: The largest difference that counts as equal; none by default.

    >>> from kennfeld.domain.parameters import Scalar
    >>> old = ParameterSet([Scalar("K", 1.0), Scalar("L", 2.0)])
    >>> list(changed(ParameterSet([Scalar("K", 1.0), Scalar("L", 3.0)]), old))
    ['L']
    """
    labels = set(compare(since, parameters, tolerance).labels)
    kept = [
        item
        for item in parameters.parameters
        if item.name in labels or any(axis.name in labels for axis in item.axes if axis.name)
    ]
    used = {axis.name for item in kept for axis in item.axes} | labels
    texts = [text for text in parameters.texts if text.name in labels]
    axes = [axis for axis in parameters.axes if axis.name in used]
    others = [item for item in parameters.others if item.name in labels]
    return ParameterSet(kept, texts, axes, others)


def _pair_items(left: ParameterSet, right: ParameterSet) -> Iterator[tuple[str, str, _Item | None, _Item | None]]:
    """Yield the items to compare with their common name and variant; None for a side without it."""
    ours, theirs = _items_by_name(left), _items_by_name(right)
    for name in dict.fromkeys([*ours, *theirs]):
        mine, its = ours.get(name, {}), theirs.get(name, {})
        if mine and its and not mine.keys() & its.keys():
            # one of them knows no variants: what counts there is compared with what counts here
            yield name, "", mine.pop(next(iter(mine))), its.pop(next(iter(its)))
        for variant in dict.fromkeys([*mine, *its]):
            yield name, variant, mine.get(variant), its.get(variant)


def _items_by_name(members: ParameterSet) -> dict[str, dict[str, _Item]]:
    """Return all named items by variant; if a table and a group axis share a name, it is the table."""
    items: dict[str, dict[str, _Item]] = {}
    for (name, variant), item in members.everything.items():
        items.setdefault(name, {})[variant] = item
    for axis in members.axes:
        items.setdefault(axis.name, {"": axis})
    return items


def _function(item: _Item | None) -> str:
    return "" if item is None or isinstance(item, Axis) or not item.functions else item.functions[0]


def _differences(first: _Item, second: _Item, allowed: Tolerance) -> Iterator[Difference]:
    if isinstance(first, Text) and isinstance(second, Text):
        for aspect in ("kind", "text", "unit"):
            if getattr(first, aspect) != getattr(second, aspect):
                yield Difference(first.name, aspect, getattr(first, aspect), getattr(second, aspect))
    elif isinstance(first, Axis) and isinstance(second, Axis):
        yield from _axis_differences(first.name, "", first, second, allowed)
    elif isinstance(first, Parameter) and isinstance(second, Parameter) and first.kind == second.kind:
        yield from _member_differences(first, second, allowed)
    else:
        yield Difference(first.name, "kind", _describe_item(first), _describe_item(second))
        yield from _block_differences(first, second, allowed)


def _member_differences(first: Parameter, second: Parameter, allowed: Tolerance) -> Iterator[Difference]:
    name = first.name
    if first.values.shape != second.values.shape:
        yield Difference(name, "size", size_text(first.values.shape), size_text(second.values.shape))
    else:
        yield from _number_differences(name, "values", first.values, second.values, allowed, first.axes)
    for letter, mine, its in zip(AXIS_LETTERS, first.axes, second.axes, strict=False):
        if mine.name != its.name:
            yield Difference(name, f"{letter} group axis", mine.name or "none", its.name or "none")
        # a group axis of both sets is compared by itself
        if not mine.name or mine.name != its.name:
            yield from _axis_differences(name, f"{letter} ", mine, its, allowed)
        elif mine.unit != its.unit:
            yield Difference(name, f"{letter} unit", mine.unit, its.unit)
    if first.unit != second.unit:
        yield Difference(name, "unit", first.unit, second.unit)
    # the same numbers mean something else for another number of inputs
    same_values = first.kind == "rbf" and np.array_equal(first.values, second.values)
    if same_values and not np.array_equal(first.packed, second.packed):
        yield Difference(name, "content", "an expansion", "another expansion")
    if isinstance(first, RBF) and isinstance(second, RBF) and first.kernel != second.kernel:
        yield Difference(name, "kernel", first.kernel, second.kernel)
    if isinstance(first, RBF) and isinstance(second, RBF) and first.hinges != second.hinges:
        yield Difference(name, "hinges", _hinges_text(first), _hinges_text(second))


def _hinges_text(expansion: RBF) -> str:
    """Return input, position and height of each hinge."""
    labels = expansion.input_labels
    return "; ".join(f"{labels[d]} {position:g} {height:g}" for d, position, height in expansion.hinges) or "none"


def _axis_differences(name: str, prefix: str, first: Axis, second: Axis, allowed: Tolerance) -> Iterator[Difference]:
    aspect = f"{prefix}breakpoints"
    if len(first) != len(second):
        yield Difference(name, aspect, f"{len(first)} points", f"{len(second)} points")
    else:
        yield from _number_differences(name, aspect, first.breakpoints, second.breakpoints, allowed)
    if first.unit != second.unit:
        yield Difference(name, f"{prefix}unit", first.unit, second.unit)


def _block_differences(first: _Item, second: _Item, allowed: Tolerance) -> Iterator[Difference]:
    """Compare values if one set has a table or axis and the other only a block of its numbers."""
    left, right = _numbers(first), _numbers(second)
    tables = [item for item in (first, second) if isinstance(item, Parameter)]
    if left is not None and right is not None and left.shape == right.shape and any(t.kind == "block" for t in tables):
        axes = next((table.axes for table in tables if table.axes), ())
        yield from _number_differences(first.name, "values", left, right, allowed, axes)


def _numbers(item: _Item) -> Float | None:
    if isinstance(item, Axis):
        return item.breakpoints
    return item.values if isinstance(item, Parameter) else None


def _number_differences(
    name: str, aspect: str, left: Float, right: Float, allowed: Tolerance, axes: tuple[Axis, ...] = ()
) -> Iterator[Difference]:
    far = allowed.exceeded(left, right)
    if not far.any():
        return
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(left - right)
    # If one side has no value, nothing is farther apart.
    apart = np.where(far, np.where(np.isnan(apart), np.inf, apart), -1.0)
    index = tuple(int(i) for i in np.unravel_index(int(apart.argmax()), apart.shape))
    place = f"[{', '.join(map(str, index))}]" if index else ""
    if axes:
        points = [axis.breakpoints[at] for axis, at in zip(axes, index, strict=True)]
        place = ", ".join(f"{letter} = {point:g}" for letter, point in zip(AXIS_LETTERS, points, strict=False))
    shown = (repr(float(left[index])), repr(float(right[index])))
    yield Difference(name, aspect, *shown, int(far.sum()), far.size, float(apart[index]), index, place)


def _describe_item(item: _Item | None) -> str:
    if item is None:
        return ""
    if isinstance(item, Axis):
        return f"group axis of {len(item)}"
    if isinstance(item, Text):
        return item.kind
    return f"{item.kind} of {size_text(item.values.shape)}" if item.values.ndim else item.kind
