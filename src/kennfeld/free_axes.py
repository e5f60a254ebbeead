"""Axes whose breakpoints are values to be fitted: how they are named, which tables they belong to, and moving them.

A group axis is one axis, however many tables share it; any other axis belongs to its table alone.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import NamedTuple

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter

__all__ = [
    "AxisKey",
    "FreeAxis",
    "breakpoints_by_name",
    "free_axes",
    "key_of",
    "with_breakpoints",
    "with_fixed_axes",
    "with_free_axes",
    "with_labelled",
]

DIRECTIONS = ("x", "y", "z", "w")


class AxisKey(NamedTuple):
    """The name of an axis: of its group, or of its table and the direction there.

    >>> str(AxisKey("AxisSpeed")), str(AxisKey("MapTorque", "x"))
    ('AxisSpeed', 'MapTorque.x')
    """

    owner: str
    direction: str = ""

    def __str__(self) -> str:
        return f"{self.owner}.{self.direction}" if self.direction else self.owner


@dataclass(frozen=True)
class FreeAxis:
    """An axis that moves, and its places: (table, direction as a number)."""

    key: AxisKey
    axis: Axis
    places: tuple[tuple[str, int], ...]


def key_of(parameter: Parameter, which: int) -> AxisKey:
    """The name of one axis of a table."""
    axis = parameter.axes[which]
    return AxisKey(axis.name) if axis.name else AxisKey(parameter.name, DIRECTIONS[which])


def _places(parameters: ParameterSet) -> dict[AxisKey, list[tuple[str, int]]]:
    places: dict[AxisKey, list[tuple[str, int]]] = {}
    for name, parameter in parameters.items():
        for which in range(len(parameter.axes)):
            places.setdefault(key_of(parameter, which), []).append((name, which))
    return places


def free_axes(parameters: ParameterSet) -> dict[AxisKey, FreeAxis]:
    """The axes that are marked as free, a group axis if any of its tables says so.

    >>> from kennfeld.parameters import Curve
    >>> curve = Curve("C", Axis([0, 1, 2], free=True), [0.0, 1.0, 4.0])
    >>> [str(key) for key in free_axes(ParameterSet([curve]))]
    ['C.x']
    """
    found = {}
    for key, places in _places(parameters).items():
        axes = (parameters[name].axes[which] for name, which in places)
        axis = next((axis for axis in axes if axis.free), None)
        if axis is not None and len(axis) > 1:
            found[key] = FreeAxis(key, axis, tuple(places))
    return found


def with_breakpoints(parameters: ParameterSet, moved: Mapping[AxisKey, Float]) -> ParameterSet:
    """The set with other breakpoints on some axes, the same in every table of a group; values stay."""
    if not moved:
        return parameters
    axes = {
        name: tuple(_moved(axis, moved.get(key_of(member, i))) for i, axis in enumerate(member.axes))
        for name, member in parameters.items()
    }
    changed = [member.changed(axes=axes[name]) for name, member in parameters.items() if axes[name] != member.axes]
    return parameters.with_parameters(*changed)


def _moved(axis: Axis, breakpoints: Float | None) -> Axis:
    return axis if breakpoints is None else axis.changed(breakpoints=breakpoints)


def breakpoints_by_name(breakpoints: Mapping[AxisKey, Float]) -> dict[str, Float]:
    """Breakpoints under names that no parameter has, to stand beside the values of tables."""
    return {f"axis {key}": points for key, points in breakpoints.items()}


def with_labelled(parameters: ParameterSet, values: Mapping[str, Float]) -> ParameterSet:
    """The set with the breakpoints among some values, see `labelled`; only those of axes marked as free."""
    moved = {key: values[f"axis {key}"] for key in free_axes(parameters) if f"axis {key}" in values}
    return with_breakpoints(parameters, moved)


def with_fixed_axes(parameters: ParameterSet, keys: Iterable[AxisKey]) -> ParameterSet:
    """The set with some axes no longer marked as free."""
    still = set(keys)
    changed = [
        member.changed(
            axes=tuple(
                axis.changed(free=False) if key_of(member, i) in still else axis for i, axis in enumerate(member.axes)
            )
        )
        for member in parameters.values()
        if any(key_of(member, i) in still for i in range(len(member.axes)))
    ]
    return parameters.with_parameters(*changed)


def with_free_axes(parameters: ParameterSet, patterns: Iterable[str]) -> ParameterSet:
    """The set with the axes marked as free that a pattern matches: the name of a group axis, or `Table.x`.

    Raises `ArgumentError` where a pattern matches none.

    >>> from kennfeld.parameters import Map
    >>> table = Map("M", [0, 1, 2], [0, 1], [[1, 2], [3, 4], [5, 6]])
    >>> [axis.free for axis in with_free_axes(ParameterSet([table]), ["M.x"])["M"].axes]
    [True, False]
    """
    keys = {str(key): key for key in _places(parameters)}
    chosen = set()
    for pattern in patterns:
        matches = {key for label, key in keys.items() if label == pattern or fnmatchcase(label, pattern)}
        if not matches:
            remedy = nearest(pattern, keys) or f"The axes are {', '.join(list(keys)[:12])}."
            raise ArgumentError(f"free_axes: {pattern} matches no axis. {remedy}")
        chosen |= matches
    changed = [
        member.changed(
            axes=tuple(
                axis.changed(free=True) if key_of(member, i) in chosen else axis for i, axis in enumerate(member.axes)
            )
        )
        for member in parameters.values()
        if any(key_of(member, i) in chosen for i in range(len(member.axes)))
    ]
    return parameters.with_parameters(*changed)
