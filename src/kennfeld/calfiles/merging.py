"""Several calibrations as one: what a later one has replaces what an earlier one said."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.calfiles.comparison import Difference, compare
from kennfeld.errors import Finding, InputError
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["Change", "Merged", "merge"]


@dataclass(frozen=True)
class Change:
    """What one calibration did to a parameter, a text or a group axis."""

    name: str
    source: str
    replaces: str = ""  # where it was from before; empty where it is new
    differences: tuple[Difference, ...] = ()  # from what was there


@dataclass(frozen=True)
class Merged:
    """The merged set, and every change to what the first calibration held, in the order in which they were made."""

    parameters: ParameterSet
    changes: tuple[Change, ...]


def merge(sources: Sequence[tuple[str, ParameterSet]]) -> Merged:
    """One set out of several, each with the name its findings carry; later ones win.

    What is replaced keeps its position, what is new follows. A parameter is replaced as a whole, with its axes.
    Raises `InputError` for each group axis whose breakpoints change under a table that is not replaced with it.

    >>> from kennfeld.parameters import Scalar
    >>> old, new = ParameterSet([Scalar("K", 1.0)]), ParameterSet([Scalar("K", 2.0)])
    >>> merge([("old", old), ("new", new)]).parameters["K"].value
    2.0
    """
    things: dict[str, tuple[Parameter | Text, str]] = {}
    axes: dict[str, tuple[Axis, str]] = {}
    changes: list[Change] = []
    for at, (source, given) in enumerate(sources):
        made = [_put(things, member, source) for member in given.parameters]
        made += [_put(things, text, source) for text in given.texts]
        made += [_put_axis(axes, axis, source) for axis in given.axes]
        changes += [change for change in made if change is not None and at]
    conflicts = _conflicts(things, axes)
    if conflicts:
        raise InputError(conflicts)
    members = [thing for thing, _ in things.values() if isinstance(thing, Parameter)]
    texts = [thing for thing, _ in things.values() if isinstance(thing, Text)]
    sets = [given for _, given in sources]
    return Merged(_put_together(members, texts, [axis for axis, _ in axes.values()], sets), tuple(changes))


def _put_together(
    members: list[Parameter], texts: list[Text], axes: list[Axis], sets: Sequence[ParameterSet]
) -> ParameterSet:
    """The set, with the other variants of all sources, as a change of the file that the first one was read from."""
    made = ParameterSet(members, texts, axes)
    others = {key: thing for given in sets for key, thing in given.everything.items() if thing.variant}
    for thing in made.chosen:
        others.pop((thing.name, thing.variant), None)
    return ParameterSet(made.parameters, made.texts, made.axes, others.values(), sets[0].origin)


def _put(things: dict[str, tuple[Parameter | Text, str]], thing: Parameter | Text, source: str) -> Change | None:
    before = things.get(thing.name)
    if before is not None and before[0] == thing:
        return None
    things[thing.name] = (thing, source)
    if before is None:
        return Change(thing.name, source)
    found = compare(_alone(before[0]), _alone(thing)).differences
    # The group axis under a table has a line of its own.
    return Change(thing.name, source, before[1], tuple(one for one in found if one.name == thing.name))


def _alone(thing: Parameter | Text) -> ParameterSet:
    if isinstance(thing, Text):
        return ParameterSet((), [replace(thing, variant="")])
    return ParameterSet([thing.changed(variant="")])


def _put_axis(axes: dict[str, tuple[Axis, str]], axis: Axis, source: str) -> Change | None:
    before = axes.get(axis.name)
    axes[axis.name] = (axis, source)
    if before is None:
        return Change(axis.name, source)
    found = compare(ParameterSet((), (), [before[0]]), ParameterSet((), (), [axis])).differences
    return Change(axis.name, source, before[1], found) if found else None


def _conflicts(things: dict[str, tuple[Parameter | Text, str]], axes: dict[str, tuple[Axis, str]]) -> list[Finding]:
    """Tables that stay as they were although the group axis they share has other breakpoints now."""
    staying: dict[tuple[str, str], list[str]] = {}
    for thing, source in things.values():
        for axis in {axis.name: axis for axis in thing.axes}.values() if isinstance(thing, Parameter) else ():
            if axis.name and not np.array_equal(axis.breakpoints, axes[axis.name][0].breakpoints):
                staying.setdefault((axis.name, source), []).append(thing.name)
    return [_conflict(axis, axes[axis][1], source, names) for (axis, source), names in staying.items()]


def _conflict(axis: str, winner: str, source: str, names: list[str]) -> Finding:
    shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    message = f"group axis {axis} has other breakpoints than in {source}, from where {shown} would stay"
    return Finding(winner, message, f"Give these tables in {winner} too, or make the breakpoints agree.")
