"""Sets of parameters by name, with texts, group axes and variants."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import count_noun, join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.data_frames import column_frame
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

MAX_NAMES = 6  # of members that a text shows

_Member = TypeVar("_Member", Parameter, Text, Parameter | Text)

_COMPARISON = "kennfeld.calfiles.comparison"  # in a higher layer
_FORMATS = "kennfeld.calfiles"  # calls `use_writer` when it is imported, only when needed: the import takes time


@dataclass(frozen=True, eq=False)
class ParameterSet(NotebookDisplay, Mapping[str, Parameter]):
    """Parameters by name, in a fixed order, with the texts that belong to them.

    A group axis (an axis with a name) has the same breakpoints in every table that uses it, and falls in files for all
    of them or for none: as it does in `axes`, else in the first table.

    Members read from files record what the format of their file cannot state, so that `completed` can take it from
    another set, however many sets were merged; `unstated` marks all members of a new set in this way.

    A parameter with several variants is a member in one of them; `in_variant` selects, and `values["Kp", "Engine=2"]`
    is the parameter in a variant.

    Attributes:
        parameters: the members.
        texts: the texts that belong to them.
        axes: group axes, including those without a table.
        others: further variants of members and texts.
        origin: what a format keeps of the file that the set was read from, so that it can update that file.

    Raises:
        ArgumentError: a name occurs twice, or tables disagree on a group axis.

    >>> from kennfeld import Scalar
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
        *,
        origin: object | None = None,
        unstated: Iterable[str] = (),
    ) -> None:
        members, notes, rest = tuple(parameters), tuple(texts), tuple(others)
        if aspects := frozenset(unstated):
            members, rest = _read_without(members, aspects), _read_without(rest, aspects)
        by_name: dict[str, Parameter] = {}
        for member in members:
            if member.name in by_name:
                raise ArgumentError(f"parameter {member.name} is defined twice")
            by_name[member.name] = member
        seen = {(member.name, member.variant) for member in members} | {(text.name, text.variant) for text in notes}
        for item in rest:
            if (item.name, item.variant) in seen:
                raise ArgumentError(f"parameter {item.name} is defined twice in the variant {item.variant!r}")
            seen.add((item.name, item.variant))
        spare = tuple(axes)
        groups = _group_axes(members, spare)
        tables = [item for item in (*members, *rest) if isinstance(item, Parameter) and item.axes]
        # only a mixture can contradict; the usual set needs no further pass
        if len({axis.falling for axis in (*spare, *(a for each in tables for a in each.axes)) if axis.name}) > 1:
            falling = {axis.name: axis.falling for axis in groups}
            members = tuple(_with_falling(member, falling) for member in members)
            rest = tuple(_with_falling(item, falling) if isinstance(item, Parameter) else item for item in rest)
        vars(self).update(parameters=members, texts=notes, others=rest, origin=origin)
        # the members may have been replaced in that pass
        vars(self)["_by_name"] = dict(zip(by_name, members, strict=True))
        vars(self)["axes"] = groups

    def __getitem__(self, name: str | tuple[str, str]) -> Parameter:
        """Return the parameter of a name, in the selected variant, or of a name and a variant."""
        by_name: dict[str, Parameter] = vars(self)["_by_name"]
        if isinstance(name, tuple):
            member = self.everything.get(name)
            if isinstance(member, Parameter):
                return member
            raise KeyError(f"{name[0]} is not a parameter of this set in the variant {name[1]!r}")
        if name not in by_name:
            raise KeyError(f"{name} is not a parameter of this set. {nearest(name, by_name)}".strip())
        return by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in vars(self)["_by_name"]

    def __iter__(self) -> Iterator[str]:
        return iter(vars(self)["_by_name"])

    def __len__(self) -> int:
        return len(self.parameters)

    def __repr__(self) -> str:
        values = sum(member.size for member in self.parameters)
        return f"ParameterSet({count_noun(values, 'value')}: {join_names(list(self), MAX_NAMES)})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ParameterSet):
            return NotImplemented
        plain = ("parameters", "texts", "axes", "others")
        return all(getattr(self, attribute) == getattr(other, attribute) for attribute in plain)

    def __hash__(self) -> int:
        return hash((self.parameters, self.texts))

    @property
    def unstated(self) -> frozenset[str]:
        """The aspects, such as `extrapolation`, that the format of the file of any member cannot state."""
        items = (*self.parameters, *self.others)
        return frozenset().union(*(item.unstated for item in items if isinstance(item, Parameter)))

    @property
    def chosen(self) -> tuple[Parameter | Text, ...]:
        """Parameters and texts, each in the selected variant."""
        return (*self.parameters, *self.texts)

    @property
    def everything(self) -> dict[tuple[str, str], Parameter | Text]:
        """All parameters and texts in all their variants, by name and variant."""
        return {(item.name, item.variant): item for item in (*self.chosen, *self.others)}

    @property
    def others_by_name(self) -> dict[str, list[Parameter | Text]]:
        """The further variants of each label that has any."""
        others: dict[str, list[Parameter | Text]] = {}
        for item in self.others:
            others.setdefault(item.name, []).append(item)
        return others

    @property
    def variants(self) -> tuple[str, ...]:
        """The variants of any member; empty if there are none."""
        return tuple(dict.fromkeys(variant for _, variant in self.everything if variant))

    def in_variant(self, variant: str) -> "ParameterSet":
        """Return the set with the values of a variant for every member that has it; the others are unchanged.

        Raises `ArgumentError` if no member has the variant.
        """
        if variant not in self.variants:
            known, remedy = ", ".join(self.variants) or "none", nearest(variant, self.variants)
            message = f"no parameter has the variant {variant!r}. The variants are: {known}. {remedy}"
            raise ArgumentError(message.strip())
        items = [item for item in self.everything.values() if item.variant == variant]
        members = [item for item in items if isinstance(item, Parameter)]
        return self.merged(ParameterSet(members, [item for item in items if isinstance(item, Text)]))

    def merged(self, other: "ParameterSet") -> "ParameterSet":
        """Return the set with the members of `other`, which replace those of the same name.

        If `other` has a member in another variant, that one becomes the selected one and the previous values are kept
        as a variant. A member without a variant replaces the selected one, whichever that is. Raises `ArgumentError` if
        a group axis of `other` contradicts tables that stay.
        """
        if not (self.chosen or self.others or self.axes):
            return other
        selected = {member.name: member.variant for member in self.chosen if member.variant}
        new = ParameterSet(
            (_of_variant(member, selected) for member in other.parameters),
            (_of_variant(text, selected) for text in other.texts),
            other.axes,
            other.others,
        )
        members = dict(zip(self, self.parameters, strict=True)) | dict(zip(new, new.parameters, strict=True))
        for text in new.texts:
            # a name is either a parameter or a text, as `other` has it
            members.pop(text.name, None)
        texts = {text.name: text for text in (*self.texts, *new.texts) if text.name not in new}
        # the axes of tables are found through these; only those without a table are passed on
        used = {axis.name for member in members.values() for axis in member.axes}
        spare = {axis.name: axis for axis in self.axes if axis.name not in used}
        axes = (spare | {axis.name: axis for axis in new.axes}).values()
        others = {**self.everything, **new.everything}
        chosen: tuple[Parameter | Text, ...] = (*members.values(), *texts.values())
        for member in chosen:
            # everything else remains a further variant, the values selected before among it
            others.pop((member.name, member.variant), None)
        # a set without members takes over the file of the other one
        origin = (self if self.chosen else other).origin
        return ParameterSet(members.values(), texts.values(), axes, others.values(), origin=origin)

    def with_parameters(self, *changed: Parameter) -> "ParameterSet":
        """Return the set with some parameters replaced or added."""
        return self.merged(ParameterSet(changed)) if changed else self

    def select(self, names: Iterable[str]) -> "ParameterSet":
        """Return the named parameters alone, in the order of `names`."""
        chosen = [self[name] for name in names]
        selected = {member.name for member in chosen}
        others = [item for item in self.others if item.name in selected]
        return ParameterSet(chosen, others=others, origin=self.origin)

    def from_origin(self, origin: object | None) -> "ParameterSet":
        """Return the set with another origin: the file that a save is to update."""
        return ParameterSet(self.parameters, self.texts, self.axes, self.others, origin=origin)

    def read_without(self, unstated: Iterable[str]) -> "ParameterSet":
        """Return the set as one that was read from a format which cannot state some aspects."""
        aspects = frozenset(unstated)
        members, others = _read_without(self.parameters, aspects), _read_without(self.others, aspects)
        return ParameterSet(members, self.texts, self.axes, others, origin=self.origin)

    def completed(self, known: "ParameterSet") -> "ParameterSet":
        """Return the set with what its files cannot state taken from the parameters of the same names in another set.

        They keep their values, their breakpoints and all that their file says. A parameter that was not read from a
        file is unchanged.
        """
        if not self.unstated:
            return self
        members = [
            _completed(each, known[each.name]) if each.unstated and each.name in known else each
            for each in self.parameters
        ]
        return ParameterSet(members, self.texts, self.axes, self.others, origin=self.origin)

    def compare(self, other: "ParameterSet", *, absolute: float = 0.0, relative: float = 0.0) -> Any:
        """Compare values, axes, units, kinds, texts and names with those of another set, as `kennfeld diff` does.

        Args:
            other: the other set.
            absolute: differences of numbers up to `absolute + relative * max(|a|, |b|)` count as equal.
            relative: see `absolute`.

        Returns:
            The differences; its text is a line for each.

        >>> from kennfeld import Scalar
        >>> before, after = ParameterSet([Scalar("K", 1.0)]), ParameterSet([Scalar("K", 1.5)])
        >>> [difference.name for difference in before.compare(after).differences]
        ['K']
        """
        module = import_module(_COMPARISON)
        return module.compare(self, other, module.Tolerance(absolute, relative))

    def without(self, names: Collection[str]) -> "ParameterSet":
        """Return all but the named parameters; group axes stay."""
        removed = frozenset(names)
        kept = [member for member in self.parameters if member.name not in removed]
        others = [item for item in self.others if item.name not in removed]
        return ParameterSet(kept, self.texts, self.axes, others, origin=self.origin)

    def to_frame(self) -> Any:
        """Return all values as a DataFrame of pandas, one row per value.

        Returns:
            The columns `parameter`, `unit`, `value`, `lower`, `upper` and `locked`, and before `value` the coordinates
            `x`, `y`, `z`, `w`, as many as the largest table has; NaN where a table has fewer.

        Raises:
            InputError: pandas is not installed; the message has the command that installs it.
        """
        members = self.parameters
        sizes = [member.size for member in members]
        columns: dict[str, Any] = {
            "parameter": np.repeat(np.array([member.name for member in members], dtype=object), sizes),
            "unit": np.repeat(np.array([member.unit for member in members], dtype=object), sizes),
        }
        grids = [_coordinates(member) for member in members]
        for direction in range(max((len(grid) for grid in grids), default=0)):
            parts = [
                # a table of fewer axes has no coordinate here
                grid[direction] if direction < len(grid) else np.full(size, np.nan)
                for grid, size in zip(grids, sizes, strict=True)
            ]
            columns[AXIS_LETTERS[direction]] = np.concatenate(parts)
        for name in ("value", "lower", "upper", "locked"):
            attribute = "values" if name == "value" else name
            parts = [getattr(member, attribute).ravel() for member in members]
            columns[name] = np.concatenate(parts) if parts else np.zeros(0)
        return column_frame(columns)

    def save(self, path: str | Path) -> None:
        """Write the set to a calibration file; the extension (`.dcm`, `.json`, ...) selects the format."""
        if _writer is None:
            import_module(_FORMATS)
        if _writer is None:
            raise ArgumentError("no calibration format is registered")
        _writer(self, Path(path))


def _read_without(items: Iterable[_Member], aspects: frozenset[str]) -> tuple[_Member, ...]:
    return tuple(item.read_without(aspects) if isinstance(item, Parameter) else item for item in items)


def _completed(own: Parameter, known: Parameter) -> Parameter:
    """Return a parameter with what its format cannot state taken from a known one."""
    changes: dict[str, Any] = {name: getattr(known, name) for name in ("unit", "description") if not getattr(own, name)}
    if len(own.axes) == len(known.axes):
        pairs = zip(own.axes, known.axes, strict=True)
        changes["axes"] = tuple(_completed_axis(axis, other, own.unstated) for axis, other in pairs)
        if "extrapolation" in own.unstated and own.extrapolation == "clip":  # as a file without it is read
            changes["extrapolation"] = known.extrapolation
    if own.values.shape == known.values.shape:
        bounds = ("lower", "upper") if "bounds" in own.unstated and not own.limited else ()
        locks = ("locked",) if "locks" in own.unstated else ()
        changes |= {name: getattr(known, name) for name in (*bounds, *locks)}
    return own.changed(**changes)


def _completed_axis(own: Axis, known: Axis, unstated: Collection[str]) -> Axis:
    changes = {name: getattr(known, name) for name in ("input", "unit") if not getattr(own, name)}
    if "free axes" in unstated and np.array_equal(own.breakpoints, known.breakpoints):
        changes |= {name: getattr(known, name) for name in ("free", "min_distance", "range")}
    return own.changed(**changes)


def _coordinates(member: Parameter) -> list[Float]:
    """Return the coordinates of all values along each axis, Float[values]."""
    grid = np.meshgrid(*(axis.breakpoints for axis in member.index_axes), indexing="ij")
    return [points.ravel() for points in grid]


def _of_variant(member: _Member, selected: Mapping[str, str]) -> _Member:
    """Return the member in the variant that it replaces if it states none."""
    variant = "" if member.variant else selected.get(member.name, "")
    if not variant:
        return member
    return member.changed(variant=variant) if isinstance(member, Parameter) else replace(member, variant=variant)


def _group_axes(members: tuple[Parameter, ...], spare: tuple[Axis, ...]) -> tuple[Axis, ...]:
    groups: dict[str, Axis] = {}
    users: dict[str, str] = {}
    for axis, user in [(axis, m.name) for m in members for axis in m.axes] + [(axis, "the set") for axis in spare]:
        if not axis.name:
            continue
        first = groups.setdefault(axis.name, axis)
        users.setdefault(axis.name, user)
        if not np.array_equal(first.breakpoints, axis.breakpoints):
            raise ArgumentError(
                f"group axis {axis.name} has different breakpoints in {user} and in {users[axis.name]}: "
                f"{axis.breakpoints.tolist()} and {first.breakpoints.tolist()}"
            )
    # reversed, so that the first of equal names counts
    falling = {axis.name: axis.falling for axis in reversed(spare)}
    return tuple(_turned(axis, falling) for axis in groups.values())


def _with_falling(member: Parameter, falling: Mapping[str, bool]) -> Parameter:
    """Return the table with its group axes falling in files as those of the set do."""
    if all(falling.get(axis.name, axis.falling) == axis.falling for axis in member.axes if axis.name):
        return member
    return member.changed(axes=tuple(_turned(axis, falling) for axis in member.axes))


def _turned(axis: Axis, falling: Mapping[str, bool]) -> Axis:
    wanted = falling.get(axis.name, axis.falling) if axis.name else axis.falling
    return axis if axis.falling == wanted else axis.changed(falling=wanted)


_writer: Callable[[ParameterSet, Path], object] | None = None


def use_writer(writer: Callable[[ParameterSet, Path], object]) -> None:
    """Set the function that `ParameterSet.save` calls; the formats are in a higher layer."""
    global _writer
    _writer = writer
