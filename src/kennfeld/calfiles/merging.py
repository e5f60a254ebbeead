"""Merges several calibrations; later ones replace values of earlier ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.calfiles.comparison import Difference, compare
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import count_labels
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text


@dataclass(frozen=True)
class Change:
    """A change of a parameter, a text or a group axis by one calibration."""

    name: str
    source: str
    replaces: str = ""  # where it was from before; empty where it is new
    differences: tuple[Difference, ...] = ()  # from what was there


@dataclass(frozen=True)
class Merged:
    """The merged set, and every change to the first calibration, in order."""

    parameters: ParameterSet
    changes: tuple[Change, ...]


def merge(sources: Sequence[tuple[str, ParameterSet]]) -> Merged:
    """Merge several sets; later ones win.

    Replaced items keep their position, new ones follow. A parameter is replaced as a whole, with its axes.

    Args:
        sources: Each set with the name that findings use for it.

    Returns:
        The merged set, and the changes to the first one.

    Raises:
        InputError: The breakpoints of a group axis change under a table that is not replaced with it.

    >>> from kennfeld.parameters import Scalar
    >>> old, new = ParameterSet([Scalar("K", 1.0)]), ParameterSet([Scalar("K", 2.0)])
    >>> merge([("old", old), ("new", new)]).parameters["K"].value
    2.0
    """
    items: dict[str, tuple[Parameter | Text, str]] = {}
    axes: dict[str, tuple[Axis, str]] = {}
    changes: list[Change] = []
    for at, (source, given) in enumerate(sources):
        result = [_put_item(items, member, source) for member in given.parameters]
        result += [_put_item(items, text, source) for text in given.texts]
        result += [_put_axis(axes, axis, source) for axis in given.axes]
        changes += [change for change in result if change is not None and at]
    conflicts = _conflicts(items, axes)
    if conflicts:
        raise InputError(conflicts)
    members = [item for item, _ in items.values() if isinstance(item, Parameter)]
    texts = [item for item, _ in items.values() if isinstance(item, Text)]
    sets = [given for _, given in sources]
    return Merged(_build_merged_set(members, texts, [axis for axis, _ in axes.values()], sets), tuple(changes))


def _build_merged_set(
    members: list[Parameter], texts: list[Text], axes: list[Axis], sets: Sequence[ParameterSet]
) -> ParameterSet:
    """Build the set with the other variants of all sources, as a change of the first file."""
    result = ParameterSet(members, texts, axes)
    others = {key: item for given in sets for key, item in given.everything.items() if item.variant}
    for item in result.chosen:
        others.pop((item.name, item.variant), None)
    return ParameterSet(result.parameters, result.texts, result.axes, others.values(), sets[0].origin)


def _put_item(items: dict[str, tuple[Parameter | Text, str]], item: Parameter | Text, source: str) -> Change | None:
    before = items.get(item.name)
    if before is not None and before[0] == item:
        return None
    items[item.name] = (item, source)
    if before is None:
        return Change(item.name, source)
    found = compare(_as_single_set(before[0]), _as_single_set(item)).differences
    # The group axis under a table has a line of its own.
    return Change(item.name, source, before[1], tuple(one for one in found if one.name == item.name))


def _as_single_set(item: Parameter | Text) -> ParameterSet:
    if isinstance(item, Text):
        return ParameterSet((), [replace(item, variant="")])
    return ParameterSet([item.changed(variant="")])


def _put_axis(axes: dict[str, tuple[Axis, str]], axis: Axis, source: str) -> Change | None:
    before = axes.get(axis.name)
    axes[axis.name] = (axis, source)
    if before is None:
        return Change(axis.name, source)
    found = compare(ParameterSet((), (), [before[0]]), ParameterSet((), (), [axis])).differences
    return Change(axis.name, source, before[1], found) if found else None


def _conflicts(items: dict[str, tuple[Parameter | Text, str]], axes: dict[str, tuple[Axis, str]]) -> list[Finding]:
    """Report tables that are not replaced although the breakpoints of their group axis change."""
    staying: dict[tuple[str, str], list[str]] = {}
    for item, source in items.values():
        for axis in {axis.name: axis for axis in item.axes}.values() if isinstance(item, Parameter) else ():
            if axis.name and not np.array_equal(axis.breakpoints, axes[axis.name][0].breakpoints):
                staying.setdefault((axis.name, source), []).append(item.name)
    return [_conflict(axis, axes[axis][1], source, names) for (axis, source), names in staying.items()]


def _conflict(axis: str, winner: str, source: str, names: list[str]) -> Finding:
    message = f"group axis {axis} has other breakpoints than in {source}, where {count_labels(names)} are defined"
    return Finding(winner, message, f"Define these tables in {winner} too, or make the breakpoints equal.")
