"""Merges several calibrations; later ones replace values of earlier ones."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import count_labels
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.comparison import Difference, compare
from kennfeld.calfiles.format import Item
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text


@dataclass(frozen=True)
class Change:
    """A change of a parameter, a text or a group axis by one calibration."""

    name: str
    source: str
    replaces: str = ""  # where it was from before; empty if it is new
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

    >>> from kennfeld.domain.parameters import Scalar
    >>> old, new = ParameterSet([Scalar("K", 1.0)]), ParameterSet([Scalar("K", 2.0)])
    >>> merge([("old", old), ("new", new)]).parameters["K"].value
    2.0
    """
    items: dict[str, tuple[Item, str]] = {}  # each with the source that it is from
    axes: dict[str, tuple[Axis, str]] = {}
    changes: list[Change] = []
    for number, (source, members) in enumerate(sources):
        result = [_put_item(items, item, source) for item in members.chosen]
        result += [_put_axis(axes, axis, source) for axis in members.axes]
        changes += [change for change in result if change is not None and number]
    conflicts = list(_conflicts(items, axes))
    if conflicts:
        raise InputError(conflicts)
    chosen = {(item.name, item.variant): item for item, _ in items.values()}
    # later sources replace further variants as well
    others = {key: item for _, members in sources for key, item in members.everything.items() if item.variant}
    variants = [item for key, item in others.items() if key not in chosen]
    parameters = [item for item in chosen.values() if isinstance(item, Parameter)]
    texts = [item for item in chosen.values() if isinstance(item, Text)]
    origin = sources[0][1].origin  # the result is a change of the first file
    merged = ParameterSet(parameters, texts, [axis for axis, _ in axes.values()], variants, origin=origin)
    return Merged(merged, tuple(changes))


def _put_item(items: dict[str, tuple[Item, str]], item: Item, source: str) -> Change | None:
    before, origin = items.get(item.name, (None, ""))
    if before == item:
        return None
    items[item.name] = (item, source)
    if before is None:
        return Change(item.name, source)
    differences = compare(_as_single_set(before), _as_single_set(item)).differences
    # The group axis under a table has a line of its own.
    own = tuple(difference for difference in differences if difference.name == item.name)
    return Change(item.name, source, origin, own)


def _as_single_set(item: Item) -> ParameterSet:
    if isinstance(item, Text):
        return ParameterSet((), [replace(item, variant="")])
    return ParameterSet([item.changed(variant="")])


def _put_axis(axes: dict[str, tuple[Axis, str]], axis: Axis, source: str) -> Change | None:
    before, origin = axes.get(axis.name, (None, ""))
    axes[axis.name] = (axis, source)
    if before is None:
        return Change(axis.name, source)
    differences = compare(ParameterSet((), (), [before]), ParameterSet((), (), [axis])).differences
    return Change(axis.name, source, origin, differences) if differences else None


def _conflicts(items: dict[str, tuple[Item, str]], axes: dict[str, tuple[Axis, str]]) -> Iterator[Finding]:
    """Report tables that are not replaced although the breakpoints of their group axis change."""
    staying: dict[tuple[str, str], list[str]] = {}
    for item, source in items.values():
        for axis in {axis.name: axis for axis in item.axes}.values() if isinstance(item, Parameter) else ():
            if axis.name and not np.array_equal(axis.breakpoints, axes[axis.name][0].breakpoints):
                staying.setdefault((axis.name, source), []).append(item.name)
    for (name, source), tables in staying.items():
        winner = axes[name][1]
        message = f"group axis {name} has other breakpoints than in {source}, where {count_labels(tables)} are defined"
        remedy = f"Define these tables in {winner} too, or make the breakpoints equal."
        yield Finding(Location(winner), message, remedy)
