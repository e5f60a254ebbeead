"""Axes whose breakpoints are fitted: their keys, their tables, and replacement of breakpoints.

A group axis is a single axis, however many tables share it; any other axis belongs to one table.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from fnmatch import fnmatchcase
from typing import NamedTuple

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter

AXIS_LABEL = "axis "  # before the name of an axis among the values of tables; no parameter has such a name


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
    """A free axis and its places: (table, number of the direction)."""

    key: AxisKey
    axis: Axis
    places: tuple[tuple[str, int], ...]


def key_of(parameter: Parameter, direction: int) -> AxisKey:
    """Return the key of one axis of a table."""
    axis = parameter.axes[direction]
    return AxisKey(axis.name) if axis.name else AxisKey(parameter.name, AXIS_LETTERS[direction])


def _places(parameters: ParameterSet) -> dict[AxisKey, list[tuple[str, int]]]:
    places: dict[AxisKey, list[tuple[str, int]]] = {}
    for name, parameter in parameters.items():
        for direction in range(len(parameter.axes)):
            places.setdefault(key_of(parameter, direction), []).append((name, direction))
    return places


def axis_keys(parameters: ParameterSet) -> tuple[AxisKey, ...]:
    """Return the keys of all axes."""
    return tuple(_places(parameters))


def free_axes(parameters: ParameterSet) -> dict[AxisKey, FreeAxis]:
    """Return the free axes by key; a group axis is free if it is in any of its tables.

    >>> from kennfeld.domain.parameters import Curve
    >>> curve = Curve("C", Axis([0, 1, 2], free=True), [0.0, 1.0, 4.0])
    >>> [str(key) for key in free_axes(ParameterSet([curve]))]
    ['C.x']
    """
    free = {}
    for key, places in _places(parameters).items():
        axes = (parameters[name].axes[direction] for name, direction in places)
        axis = next((axis for axis in axes if axis.free), None)
        # a table is constant along an axis of one breakpoint, wherever that lies
        if axis is not None and len(axis) > 1:
            free[key] = FreeAxis(key, axis, tuple(places))
    return free


def with_breakpoints(parameters: ParameterSet, breakpoints: Mapping[AxisKey, Float]) -> ParameterSet:
    """Replace the breakpoints of some axes, Float[points] each, in every table of a group; values stay."""
    if not breakpoints:
        return parameters

    def move(axis: Axis, key: AxisKey) -> Axis:
        return axis.changed(breakpoints=breakpoints[key]) if key in breakpoints else axis

    return _with_axes(parameters, move)


def breakpoints_by_name(breakpoints: Mapping[AxisKey, Float]) -> dict[str, Float]:
    """Name breakpoints, Float[points] each, as no parameter can be called, to be stored with the values of tables."""
    return {f"{AXIS_LABEL}{key}": points for key, points in breakpoints.items()}


def with_labelled(parameters: ParameterSet, values: Mapping[str, Float]) -> ParameterSet:
    """Replace the breakpoints of free axes by those among some values, which `breakpoints_by_name` has named."""
    breakpoints = {key: values[label] for key in free_axes(parameters) if (label := f"{AXIS_LABEL}{key}") in values}
    return with_breakpoints(parameters, breakpoints)


def with_fixed_axes(parameters: ParameterSet, keys: Iterable[AxisKey]) -> ParameterSet:
    """Return the set with some axes fixed."""
    fixed = set(keys)
    return _with_axes(parameters, lambda axis, key: axis.changed(free=False) if key in fixed else axis)


def with_free_axes(parameters: ParameterSet, patterns: Collection[str]) -> ParameterSet:
    """Return the set with the axes free that a pattern matches: the name of a group axis, or `Table.x`.

    Raises `ArgumentError` if a pattern matches none.

    >>> from kennfeld.domain.parameters import Map
    >>> table = Map("M", [0, 1, 2], [0, 1], [[1, 2], [3, 4], [5, 6]])
    >>> [axis.free for axis in with_free_axes(ParameterSet([table]), ["M.x"])["M"].axes]
    [True, False]
    """
    if not patterns:
        return parameters
    keys = {str(key): key for key in _places(parameters)}
    free = set()
    for pattern in patterns:
        # equal, too: [ and ] in a name mean a choice of characters in a pattern
        matches = {key for label, key in keys.items() if label == pattern or fnmatchcase(label, pattern)}
        if not matches:
            remedy = nearest(pattern, keys) or f"The axes are {join_names(keys, 12)}."
            raise ArgumentError(f"free_axes: {pattern} matches no axis. {remedy}")
        free |= matches
    return _with_axes(parameters, lambda axis, key: axis.changed(free=True) if key in free else axis)


def _with_axes(parameters: ParameterSet, change: Callable[[Axis, AxisKey], Axis]) -> ParameterSet:
    axes = {
        name: tuple(change(axis, key_of(member, i)) for i, axis in enumerate(member.axes))
        for name, member in parameters.items()
    }
    # replaced all at once, as a group axis has to be the same in all its tables
    changed = [member.changed(axes=axes[name]) for name, member in parameters.items() if axes[name] != member.axes]
    return parameters.with_parameters(*changed)
