"""What is calibrated: scalars, value blocks, curves, maps and cubes, and sets of them.

All types are frozen. `Map.values[i, j]` belongs to x breakpoint i and y breakpoint j.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import ArrayLike, Bool, Float, readonly
from kennfeld.errors import ArgumentError, nearest
from kennfeld.numeric import array, truths

__all__ = [
    "Axis",
    "Block",
    "Cube",
    "Curve",
    "Extrapolation",
    "Map",
    "Parameter",
    "ParameterSet",
    "Scalar",
    "Text",
    "TextKind",
    "parameter",
    "use_writer",
]

Extrapolation = Literal["clip", "linear"]
TextKind = Literal["text", "enumeration", "boolean"]
_LABELS = ("functions", "display_name", "variant")
CLOSEST = 0.05  # of the mean distance of breakpoints, as far as free ones approach each other


@dataclass(frozen=True, eq=False, init=False)
class Axis:
    """Breakpoints of one direction of a table, strictly increasing.

    `name` is set for a group axis, which several tables share; `input` names the quantity on the axis.

    With `free`, a calibration moves the breakpoints. They stay at least `min_distance` apart; None stands for a
    twentieth of their mean distance, or the smallest where that is less. The first and the last one stay where they are
    unless `range` gives the limits within which all of them may move.

    >>> Axis([700, 1000, 1500], input="Speed", unit="rpm").breakpoints
    array([ 700., 1000., 1500.])
    """

    breakpoints: Float  # Float[points]
    input: str = ""
    unit: str = ""
    name: str = ""
    free: bool = False
    min_distance: float | None = None
    range: tuple[float, float] | None = None

    def __init__(
        self,
        breakpoints: ArrayLike,
        input: str = "",  # noqa: A002
        unit: str = "",
        name: str = "",
        *,
        free: bool = False,
        min_distance: float | None = None,
        range: tuple[float, float] | None = None,  # noqa: A002
    ) -> None:
        for attribute, given in (("input", input), ("unit", unit), ("name", name), ("free", bool(free))):
            object.__setattr__(self, attribute, given)
        object.__setattr__(self, "min_distance", None if min_distance is None else float(min_distance))
        object.__setattr__(self, "range", None if range is None else (float(range[0]), float(range[1])))
        points = readonly(np.atleast_1d(array(breakpoints, f"breakpoints of axis {self.label}")))
        if points.ndim != 1 or points.size == 0:
            raise ArgumentError(
                f"breakpoints of axis {self.label} must be a list of numbers, not of shape {points.shape}"
            )
        if not np.all(np.isfinite(points)):
            raise ArgumentError(f"breakpoints of axis {self.label} must be finite: {points.tolist()}")
        falling = np.flatnonzero(points[1:] <= points[:-1])
        if falling.size:
            at = int(falling[0])
            raise ArgumentError(
                f"breakpoints of axis {self.label} must increase: "
                f"number {at + 2} ({points[at + 1]:g}) does not exceed number {at + 1} ({points[at]:g})"
            )
        object.__setattr__(self, "breakpoints", points)
        self._check_freedom()

    def _check_freedom(self) -> None:
        """Whether the start keeps what it shall keep while it moves."""
        points = self.breakpoints
        if self.range is not None and not (self.range[0] <= points[0] and points[-1] <= self.range[1]):
            low, high = self.range
            raise ArgumentError(
                f"range=({low:g}, {high:g}) of axis {self.label} must hold all its breakpoints, "
                f"{points[0]:g} to {points[-1]:g}"
            )
        if self.min_distance is None or not self.free:
            return
        if not (self.min_distance > 0 and np.isfinite(self.min_distance)):
            raise ArgumentError(f"min_distance={self.min_distance:g} of axis {self.label} must be a number above 0")
        gaps = np.diff(points)
        if gaps.size and gaps.min() < self.min_distance - 1e-6 * gaps.mean():
            at = int(gaps.argmin())
            raise ArgumentError(
                f"min_distance={self.min_distance:g} of axis {self.label} is more than the distance of its breakpoints "
                f"{points[at]:g} and {points[at + 1]:g}"
            )

    @property
    def label(self) -> str:
        """The axis' name, or what lies on it."""
        return self.name or self.input or "without a name"

    @property
    def least_distance(self) -> float:
        """How close two neighbouring breakpoints may come while they move; infinite for a single one."""
        gaps = np.diff(self.breakpoints)
        wanted = CLOSEST * float(gaps.mean()) if self.min_distance is None and gaps.size else self.min_distance
        return min(float(gaps.min(initial=np.inf)), np.inf if wanted is None else wanted)

    def changed(self, **changes: Any) -> "Axis":
        """The same axis with some of its attributes replaced."""
        return Axis(**({f.name: getattr(self, f.name) for f in fields(Axis)} | changes))

    def __len__(self) -> int:
        return self.breakpoints.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Axis):
            return NotImplemented
        plain = ("input", "unit", "name", "free", "min_distance", "range")
        same = all(getattr(self, a) == getattr(other, a) for a in plain)
        return same and np.array_equal(self.breakpoints, other.breakpoints)

    def __hash__(self) -> int:
        return hash((self.breakpoints.tobytes(), self.name))


@dataclass(frozen=True, eq=False, kw_only=True)
class Parameter:
    """A calibratable quantity: an array of values over zero to four axes.

    Bounds and locks have the shape of `values`; a single number is spread over it. `functions` are the parts of the
    ECU software that use it, `display_name` is its short name, and `variant` says for which of several variants
    (`Engine=2`) the values hold; empty where there is just one.
    Raises `ArgumentError` where shapes, bounds or axes contradict each other.
    """

    kind: ClassVar[str] = ""

    name: str
    values: Float
    axes: tuple[Axis, ...] = ()
    unit: str = ""
    description: str = ""
    lower: Float = field(default_factory=lambda: np.array(-np.inf), repr=False)
    upper: Float = field(default_factory=lambda: np.array(np.inf), repr=False)
    locked: Bool = field(default_factory=lambda: np.array(False), repr=False)
    extrapolation: Extrapolation = "clip"
    functions: tuple[str, ...] = ()
    display_name: str = ""
    variant: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "functions", tuple(self.functions))
        values = readonly(self.values)
        shape = self._expected_shape(values)
        if values.shape != shape:
            raise ArgumentError(f"{self.name} has values of shape {values.shape}, its axes ask for {shape}")
        object.__setattr__(self, "values", values)
        if self.extrapolation not in ("clip", "linear"):
            raise ArgumentError(f"extrapolation={self.extrapolation!r} of {self.name} must be clip or linear")
        for side in ("lower", "upper"):
            bounds = array(getattr(self, side), f"{side} bounds of {self.name}")
            object.__setattr__(self, side, self._spread(side, bounds))
        object.__setattr__(self, "locked", self._spread("locked", truths(self.locked, f"locked of {self.name}")))
        crossed = ~(self.lower <= self.upper)
        if crossed.any():
            at = tuple(int(i) for i in np.unravel_index(int(crossed.argmax()), crossed.shape))
            raise ArgumentError(
                f"{self.name}{_subscript(at)} has the lower bound {self.lower[at]:g} "
                f"above its upper bound {self.upper[at]:g}"
            )

    def _expected_shape(self, values: Float) -> tuple[int, ...]:
        return tuple(len(axis) for axis in self.axes)

    def _spread(self, attribute: str, given: NDArray[Any]) -> Any:
        try:
            spread = np.broadcast_to(given, self.values.shape).copy()
        except ValueError:
            message = f"{attribute} of {self.name} has shape {given.shape}, its values have {self.values.shape}"
            raise ArgumentError(message) from None
        spread.setflags(write=False)
        return spread

    @property
    def size(self) -> int:
        """How many values it holds."""
        return self.values.size

    @property
    def limited(self) -> bool:
        """Whether any of its values has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    @property
    def index_axes(self) -> tuple[Axis, ...]:
        """The axes a lookup searches: the own ones, or the positions 0, 1, ... of a value block."""
        return self.axes

    @property
    def coordinates(self) -> int:
        """How many coordinates a lookup gives."""
        return len(self.index_axes)

    @property
    def packed(self) -> Float:
        """The values as compiled code reads them where no calibration changes them, in C order."""
        return self.values.ravel()

    def with_values(self, values: ArrayLike) -> Self:
        """The same parameter holding other values: an array of its shape, or a flat one in C order."""
        given = array(values, f"values of {self.name}")
        if given.shape not in (self.values.shape, (self.size,)):
            raise ArgumentError(f"{self.name} has values of shape {self.values.shape}, not {given.shape}")
        return self.changed(values=given.reshape(self.values.shape))

    def with_bounds(self, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf) -> Self:
        """The same parameter within other bounds, each a number or an array of its shape."""
        return self.changed(lower=lower, upper=upper)

    def changed(self, **changes: Any) -> Self:
        """The same parameter with some of its attributes replaced."""
        made = object.__new__(type(self))
        Parameter.__init__(made, **({f.name: getattr(self, f.name) for f in fields(Parameter)} | changes))
        return made

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Parameter):
            return NotImplemented
        plain = ("kind", "name", "axes", "unit", "description", "extrapolation", *_LABELS)
        arrays = ("values", "lower", "upper", "locked")
        return all(getattr(self, a) == getattr(other, a) for a in plain) and all(
            np.array_equal(getattr(self, a), getattr(other, a), equal_nan=a == "values") for a in arrays
        )

    def __hash__(self) -> int:
        return hash((self.kind, self.name, self.values.tobytes()))


def _subscript(at: tuple[int, ...]) -> str:
    return f"[{', '.join(str(int(i)) for i in at)}]" if at else ""


class Scalar(Parameter):
    """One number.

    >>> Scalar("Kp", 0.08, unit="-").value
    0.08
    """

    kind: ClassVar[str] = "scalar"

    def __init__(self, name: str, value: ArrayLike, **attributes: Any) -> None:
        super().__init__(name=name, values=array(value, f"value of {name}"), **attributes)

    @property
    def value(self) -> float:
        """The number itself."""
        return float(self.values)


class Block(Parameter):
    """A value block: numbers without axes. A formula reads it by position, counted from 0."""

    kind: ClassVar[str] = "block"

    def __init__(self, name: str, values: ArrayLike, **attributes: Any) -> None:
        super().__init__(name=name, values=array(values, f"values of {name}"), **attributes)

    def _expected_shape(self, values: Float) -> tuple[int, ...]:
        if values.ndim == 0 or values.ndim > 4:
            raise ArgumentError(f"value block {self.name} needs one to four dimensions, not {values.ndim}")
        return values.shape

    @property
    def index_axes(self) -> tuple[Axis, ...]:
        return tuple(Axis(np.arange(count)) for count in self.values.shape)


class Curve(Parameter):
    """Values over one axis, interpolated linearly.

    >>> Curve("Eta", [0, 10, 20], [1.0, 0.95, 0.8]).values
    array([1.  , 0.95, 0.8 ])
    """

    kind: ClassVar[str] = "curve"

    def __init__(self, name: str, x: Axis | ArrayLike, values: ArrayLike, **attributes: Any) -> None:
        super().__init__(name=name, axes=(_axis(x),), values=array(values, f"values of {name}"), **attributes)


class Map(Parameter):
    """Values over two axes, interpolated bilinearly; `values[i, j]` is at x[i], y[j]."""

    kind: ClassVar[str] = "map"

    def __init__(
        self, name: str, x: Axis | ArrayLike, y: Axis | ArrayLike, values: ArrayLike, **attributes: Any
    ) -> None:
        super().__init__(name=name, axes=(_axis(x), _axis(y)), values=array(values, f"values of {name}"), **attributes)


class Cube(Parameter):
    """Values over three or four axes, interpolated multilinearly."""

    kind: ClassVar[str] = "cube"

    def __init__(self, name: str, axes: Iterable[Axis | ArrayLike], values: ArrayLike, **attributes: Any) -> None:
        made = tuple(_axis(axis) for axis in axes)
        if len(made) not in (3, 4):
            raise ArgumentError(f"cube {name} needs 3 or 4 axes, not {len(made)}")
        super().__init__(name=name, axes=made, values=array(values, f"values of {name}"), **attributes)


def _axis(given: Axis | ArrayLike) -> Axis:
    return given if isinstance(given, Axis) else Axis(given)


@dataclass(frozen=True)
class Text:
    """A parameter that holds text; it is carried through, never calibrated.

    `kind` tells free text from an enumeration, whose text is one of the words that the control unit knows, and from a
    boolean, which is true or false.

    >>> Text("Mode", "ON", kind="enumeration").kind
    'enumeration'
    """

    name: str
    text: str
    description: str = ""
    functions: tuple[str, ...] = ()
    display_name: str = ""
    variant: str = ""
    unit: str = ""
    kind: TextKind = "text"

    def __post_init__(self) -> None:
        if self.kind not in get_args(TextKind):
            raise ArgumentError(f"kind={self.kind!r} of {self.name} must be text, enumeration or boolean")


_KINDS: tuple[type[Parameter], ...] = (Scalar, Curve, Map, Cube, Cube)


def parameter(name: str, values: ArrayLike, axes: Iterable[Axis] = (), **attributes: Any) -> Parameter:
    """The scalar, curve, map or cube that has these axes.

    >>> parameter("K", 2.0).kind, parameter("C", [1, 2], [Axis([0, 1])]).kind
    ('scalar', 'curve')
    """
    made = tuple(axes)
    if len(made) >= len(_KINDS):
        raise ArgumentError(f"{name} has {len(made)} axes; tables have at most 4")
    table = object.__new__(_KINDS[len(made)])
    Parameter.__init__(table, name=name, values=array(values, f"values of {name}"), axes=made, **attributes)
    return table


@dataclass(frozen=True, eq=False)
class ParameterSet(Mapping[str, Parameter]):
    """Parameters by name, in a fixed order, with the texts that belong to them.

    A group axis (an axis with a name) has the same breakpoints in every table that uses it;
    `ArgumentError` where two tables disagree or a name occurs twice.

    A label that has several variants is there in one of them; `others` holds the rest, `in_variant` chooses, and
    `values["Kp", "Engine=2"]` is one of a variant.
    `origin` is what a format keeps of the file that the set was read from, so that it can write into it again.

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
            mend = nearest(variant, self.variants)
            raise ArgumentError(f"no parameter has the variant {variant!r}. The variants are: {known}. {mend}".strip())
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


_FORMATS = "kennfeld.calfiles"  # calls `use_writer` when it is imported, which is late: reading and writing take time
_writer: Callable[[ParameterSet, Path], object] | None = None


def use_writer(writer: Callable[[ParameterSet, Path], object]) -> None:
    """Tell the domain types how sets are written; the formats live on a floor above."""
    global _writer
    _writer = writer
