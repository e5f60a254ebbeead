"""What is calibrated: scalars, value blocks, curves, maps and cubes, and sets of them.

All types are frozen. `Map.values[i, j]` belongs to x breakpoint i and y breakpoint j.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TypeVar

import numpy as np

from kennfeld.errors import ArgumentError
from kennfeld.formatting import nearest
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["ParameterSet", "use_writer"]

_FORMATS = "kennfeld.calfiles"  # calls `use_writer` when it is imported, which is late: reading and writing take time


@dataclass(frozen=True, eq=False)
class ParameterSet(Mapping[str, Parameter]):
    """Parameters by name, in a fixed order, with the texts that belong to them.

    A group axis (an axis with a name) has the same breakpoints in every table that uses it;
    `ArgumentError` where two tables disagree or a name occurs twice.

    A label that has several variants is there in one of them; `others` holds the rest, `in_variant` chooses, and
    `values["Kp", "Engine=2"]` is one of a variant.
    `origin` is what a format keeps of the file that the set was read from, so that it can write into it again.

    >>> from kennfeld.parameters import Scalar
    >>> values = ParameterSet([Scalar("Kp", 0.08), Scalar("Ki", 0.046)])
    >>> values["Kp"].value, list(values)
    (0.08, ['Kp', 'Ki'])
    """

    parameters: tuple[Parameter, ...] = ()
    texts: tuple[Text, ...] = ()
    axes: tuple[Axis, ...] = ()  # group axes, those without a table included
    others: tuple[Parameter | Text, ...] = ()  # further variants of what is in parameters and texts
    origin: object | None = None

    def __init__(
        self,
        parameters: Iterable[Parameter] = (),
        texts: Iterable[Text] = (),
        axes: Iterable[Axis] = (),
        others: Iterable[Parameter | Text] = (),
        origin: object | None = None,
    ) -> None:
        members, notes, rest = tuple(parameters), tuple(texts), tuple(others)
        by_name: dict[str, Parameter] = {}
        for member in members:
            if member.name in by_name:
                raise ArgumentError(f"parameter {member.name} is given twice")
            by_name[member.name] = member
        seen = {(member.name, member.variant) for member in members} | {(text.name, text.variant) for text in notes}
        for thing in rest:
            if (thing.name, thing.variant) in seen:
                raise ArgumentError(f"parameter {thing.name} is given twice in the variant {thing.variant!r}")
            seen.add((thing.name, thing.variant))
        object.__setattr__(self, "parameters", members)
        object.__setattr__(self, "texts", notes)
        object.__setattr__(self, "axes", _group_axes(members, axes))
        object.__setattr__(self, "others", rest)
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "_by_name", by_name)

    def __getitem__(self, name: str | tuple[str, str]) -> Parameter:
        """The parameter of a name, in the variant that counts, or of a name and a variant."""
        by_name: dict[str, Parameter] = self.__dict__["_by_name"]
        if isinstance(name, tuple):
            found = self.everything.get(name)
            if isinstance(found, Parameter):
                return found
            raise KeyError(f"{name[0]} is no parameter of this set in the variant {name[1]!r}")
        if name not in by_name:
            raise KeyError(f"{name} is no parameter of this set. {nearest(name, by_name)}".strip())
        return by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self.__dict__["_by_name"]

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dict__["_by_name"])

    def __len__(self) -> int:
        return len(self.parameters)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ParameterSet):
            return NotImplemented
        plain = ("parameters", "texts", "axes", "others")
        return all(getattr(self, attribute) == getattr(other, attribute) for attribute in plain)

    def __hash__(self) -> int:
        return hash((self.parameters, self.texts))

    @property
    def chosen(self) -> tuple[Parameter | Text, ...]:
        """Parameters and texts, each in the variant that counts."""
        return (*self.parameters, *self.texts)

    @property
    def everything(self) -> dict[tuple[str, str], Parameter | Text]:
        """All parameters and texts in all their variants, by name and variant."""
        return {(thing.name, thing.variant): thing for thing in (*self.chosen, *self.others)}

    @property
    def variants(self) -> tuple[str, ...]:
        """The variants that some label has; empty where no label has any."""
        return tuple(dict.fromkeys(variant for _, variant in self.everything if variant))

    def in_variant(self, variant: str) -> "ParameterSet":
        """This set with the values of a variant for every label that has it; the others keep theirs.

        Raises `ArgumentError` where no label has the variant.
        """
        if variant not in self.variants:
            known = ", ".join(self.variants) or "none"
            remedy = nearest(variant, self.variants)
            raise ArgumentError(
                f"no parameter has the variant {variant!r}. The variants are: {known}. {remedy}".strip()
            )
        return self.merged(_of([thing for (_, one), thing in self.everything.items() if one == variant]))

    def merged(self, other: "ParameterSet") -> "ParameterSet":
        """This set with the members of `other` replacing those of the same name and following the rest.

        What `other` has in another variant becomes the chosen one; the values of the variant before are kept. What has
        no variant replaces the chosen one, whichever that is. Raises `ArgumentError` where a group axis of `other`
        contradicts tables that stay.
        """
        stand = {thing.name: thing.variant for thing in self.chosen if thing.variant}
        given = ParameterSet(
            (_of_variant(member, stand) for member in other.parameters),
            (_of_variant(text, stand) for text in other.texts),
            other.axes,
            other.others,
        )
        members = dict(zip(self, self.parameters, strict=True)) | dict(zip(given, given.parameters, strict=True))
        for text in given.texts:
            members.pop(text.name, None)
        texts = {text.name: text for text in (*self.texts, *given.texts) if text.name not in given}
        used = {axis.name for member in members.values() for axis in member.axes}
        kept = {axis.name: axis for axis in self.axes if axis.name not in used}
        axes = (kept | {axis.name: axis for axis in given.axes}).values()
        made = ParameterSet(members.values(), texts.values(), axes)
        kept_aside = {**self.everything, **given.everything}
        for thing in made.chosen:
            kept_aside.pop((thing.name, thing.variant), None)
        return ParameterSet(
            made.parameters, made.texts, made.axes, kept_aside.values(), (self if self.chosen else other).origin
        )

    def with_parameters(self, *changed: Parameter) -> "ParameterSet":
        """This set with some parameters replaced or added."""
        return self.merged(ParameterSet(changed))

    def select(self, names: Iterable[str]) -> "ParameterSet":
        """The named parameters alone, in the order of `names`."""
        chosen = [self[name] for name in names]
        others = [thing for thing in self.others if any(thing.name == member.name for member in chosen)]
        return ParameterSet(chosen, others=others, origin=self.origin)

    def from_origin(self, origin: object | None) -> "ParameterSet":
        """This set as if it were read from another file, into which it is to be written."""
        return ParameterSet(self.parameters, self.texts, self.axes, self.others, origin)

    def without(self, names: Collection[str]) -> "ParameterSet":
        """All but the named parameters; group axes stay."""
        kept = [member for member in self.parameters if member.name not in names]
        others = [thing for thing in self.others if thing.name not in names]
        return ParameterSet(kept, self.texts, self.axes, others, self.origin)

    def save(self, path: str | Path) -> None:
        """Write the set to a calibration file; the ending (`.dcm`, `.json`, ...) chooses the format."""
        if _writer is None:
            import_module(_FORMATS)
        if _writer is None:
            raise ArgumentError("no calibration format is registered")
        _writer(self, Path(path))


def _of(things: Iterable[Parameter | Text]) -> ParameterSet:
    known = list(things)
    members = [thing for thing in known if isinstance(thing, Parameter)]
    return ParameterSet(members, [thing for thing in known if isinstance(thing, Text)])


_Thing = TypeVar("_Thing", Parameter, Text)


def _of_variant(thing: _Thing, stand: Mapping[str, str]) -> _Thing:
    """What says no variant is of the one it replaces."""
    variant = "" if thing.variant else stand.get(thing.name, "")
    if not variant:
        return thing
    return thing.changed(variant=variant) if isinstance(thing, Parameter) else replace(thing, variant=variant)


def _group_axes(members: tuple[Parameter, ...], spare: Iterable[Axis]) -> tuple[Axis, ...]:
    groups: dict[str, Axis] = {}
    users: dict[str, str] = {}
    for axis, user in [(axis, m.name) for m in members for axis in m.axes] + [(axis, "the set") for axis in spare]:
        if not axis.name:
            continue
        first = groups.setdefault(axis.name, axis)
        users.setdefault(axis.name, user)
        if not np.array_equal(first.breakpoints, axis.breakpoints):
            raise ArgumentError(
                f"group axis {axis.name} has other breakpoints in {user} than in {users[axis.name]}: "
                f"{axis.breakpoints.tolist()} against {first.breakpoints.tolist()}"
            )
    return tuple(groups.values())


_writer: Callable[[ParameterSet, Path], object] | None = None


def use_writer(writer: Callable[[ParameterSet, Path], object]) -> None:
    """Tell the domain types how sets are written; the formats live on a floor above."""
    global _writer
    _writer = writer
