"""The sections of tables in a project file: `[parameters.NAME]` and `[axes.NAME]`."""

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Literal

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.breakpoint_rounding import evenly_spaced
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.domain.parameters import Extrapolation
from kennfeld.domain.table_parts import Range
from kennfeld.project.forms import EitherForm, EntriesForm, NumberForm, TableOfForm, TextForm
from kennfeld.project.value_forms import (
    AXIS_RANGE,
    DIRECTIONS,
    FREE,
    Around,
    ArrayForm,
    BoundsForm,
    BreakpointsForm,
    CoordinatesForm,
    LimitPairForm,
    Lock,
    LockForm,
    PairForm,
)

Factor = float | Literal["auto"]

FACTOR = NumberForm(least=0, words=("auto",))
FACTORS = EitherForm(FACTOR, TableOfForm(FACTOR, names=DIRECTIONS))
_INITIAL = "by the initial files"
_MAX_BREAKPOINTS = 100_000
BREAKPOINT_KEYS = ("breakpoints", "begin", "end", "count", "round")  # of an axis: those that give its breakpoints
_LIMITS = TableOfForm(LimitPairForm(), names=DIRECTIONS)


@dataclass(frozen=True)
class GroupAxisEntry:
    """One `[axes.NAME]`. Without breakpoints, begin, end and count, they come from the initial files."""

    location: Location
    input: str = key("the quantity along the axis: an input, node or channel", "", holds="input")
    breakpoints: tuple[float, ...] | Literal["free"] = key(
        'strictly increasing numbers; or `"free"`: they are fitted, from `begin`, `end` and `count`, or from `count`, '
        "or, without these keys, from the initial files",
        (),
        form=BreakpointsForm(),
    )
    begin: float | None = key("the first breakpoint of a uniform axis", None)
    end: float | None = key("the last breakpoint of a uniform axis", None)
    count: int = key(
        "number of breakpoints: uniform from `begin` to `end`; alone, quantiles of the training data, including both "
        "ends",
        0,
        least=2,
        most=_MAX_BREAKPOINTS,
        default_text="",
    )
    round: bool = key(
        "`false`: quantiles are used as computed. By default they are [rounded](#rounding-of-quantiles)",
        True,
    )
    free: bool | None = key("`true`: the breakpoints are fitted", None, default_text="`false`")
    step: float | None = key(
        "the step of the breakpoints that a control unit can store, whose multiples [rounding](how-to/rounding.md) "
        "takes; precedes `storage` of `[calibration]`. Alone, it leaves the breakpoints to the initial files",
        None,
        above=0,
        default_text="by `storage`",
    )
    min_distance: float | None = key(
        "the minimum distance between two free breakpoints, in the unit of the axis",
        None,
        above=0,
        default_text="1/20 of the mean distance, or the smallest distance at the start",
    )
    range: tuple[float, float] | None = key(
        "`[lowest, highest]`: the first and the last free breakpoint are fitted as well, within this range. Without it "
        "they are fixed",
        None,
        form=PairForm("must be the lowest and the highest breakpoint", "Write {key} = [lowest, highest]."),
    )

    @property
    def is_free(self) -> bool:
        """True if the breakpoints are fitted."""
        return self.breakpoints == FREE or self.free is True

    @property
    def group(self) -> str:
        """The group axis that is used instead."""
        return ""

    @property
    def points(self) -> tuple[float, ...]:
        """The breakpoints, as far as the file defines them."""
        if isinstance(self.breakpoints, tuple) and self.breakpoints:
            return self.breakpoints
        if self.begin is None or self.end is None or not self.count:
            return ()
        if not math.isfinite(self.end - self.begin):
            return ()  # reported by `problems`
        return tuple(evenly_spaced(self.begin, self.end, self.count).tolist())

    @property
    def quantiles(self) -> int:
        """The number of quantiles of the training data that are the breakpoints."""
        return 0 if self.points else self.count

    @property
    def inherits(self) -> bool:
        """True if the breakpoints are those of the initial files."""
        # a step says how they are stored
        changed = self.is_free or self.step is not None
        return changed and not (self.group or self.points or self.quantiles)

    @property
    def needs_points(self) -> str:
        """Reason, in words, for which it needs breakpoints of the initial files, if it leaves them to these."""
        return "breakpoints are free" if self.is_free else "the axis has no breakpoints"

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield contradictions between the keys."""
        if self.breakpoints == FREE and self.free is False:
            yield "free", 'breakpoints = "free" contradicts free = false', "Remove one of them."
        if not self.is_free:
            for name in ("min_distance", "range"):
                if name in present:
                    yield name, "requires free breakpoints", "Write free = true, or remove it.", {"free": True}
        uniform = [name for name in ("begin", "end") if name in present]
        if any(getattr(self, name) is None for name in (*uniform, *({"free", "step"} & set(present)))) or (
            not self.count and "count" in present
        ):
            return  # invalid, and reported as such
        if "breakpoints" in present and self.breakpoints != FREE:
            if uniform or self.count:
                yield "", "breakpoints contradict begin, end and count", "Keep one of them."
        elif self.begin is not None and self.end is not None and self.count:
            if not self.begin < self.end:
                message, swapped = f"must be > begin = {self.begin:g}, got {self.end:g}", (self.end, self.begin)
                yield "end", message, "Swap them.", dict(zip(("begin", "end"), swapped, strict=True))
            elif not math.isfinite(self.end - self.begin):
                yield "end", f"is too far from begin = {self.begin:g}, got {self.end:g}", "Write physical values."
        elif uniform or not (self.count or self.is_free or self.step is not None):
            keys = f"only {', '.join(present)}" if present else "no breakpoints"
            yield "", f"the axis has {keys}", f"Write {self._forms}.", {"count": 8} if "count" not in present else {}
        if "round" in present and self.points:
            yield "round", "applies to quantiles of the training data only", "Remove it, or write count alone."

    @property
    def _forms(self) -> str:
        return "{ input, breakpoints }, { input, begin, end, count }, { input, count }"


@dataclass(frozen=True)
class AxisEntry(GroupAxisEntry):
    """An axis of a table: its own, or a group axis."""

    axis: str = key("the group axis, alone", "", holds="group axis")

    @property
    def group(self) -> str:
        """The group axis that is used instead."""
        return self.axis

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield contradictions between the keys."""
        if "axis" not in present:
            yield from super().problems(present)
        elif len(present) > 1:
            remedy = 'Write { axis = "..." } alone; its breakpoints are set in its own section.'
            yield "", "the keys of a group axis belong in its own section", remedy

    @property
    def _forms(self) -> str:
        return super()._forms + ' or { axis = "..." }'


@dataclass(frozen=True)
class PinEntry:
    """One entry of `pin`."""

    value: float = key("the value of the table", missing="Write value = ...")
    at: tuple[float, ...] = key("the coordinates, one per axis", (), form=CoordinatesForm(may_be_infinite=True))


@dataclass(frozen=True)
class ShapeEntry:
    """One entry of `gradient` or `curvature`: limits of a part of the table."""

    x: tuple[float, float] | None = key("the range along x", None, form=LimitPairForm(), default_text="none")
    y: tuple[float, float] | None = key("the range along y", None, form=LimitPairForm(), default_text="none")
    z: tuple[float, float] | None = key("the range along z", None, form=LimitPairForm(), default_text="none")
    w: tuple[float, float] | None = key("the range along w", None, form=LimitPairForm(), default_text="none")
    where: Range = key(
        "ranges of axis values, including their ends; a difference counts if all its grid points are within them",
        factory=dict,
        form=TableOfForm(AXIS_RANGE, names=DIRECTIONS),
        default_text="the whole table",
    )

    @property
    def limits(self) -> Range:
        """The limits by direction."""
        return {name: pair for name in DIRECTIONS if (pair := getattr(self, name)) is not None}

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield that there is no limit."""
        if not self.limits:
            yield "", "has no limit", "Write { x = [0, inf] }."


def _shapes(key: str) -> EitherForm:
    """Return the form of limits by direction, or of parts that have such limits."""
    fault, remedy = "must be a table by axis or a list of them", f"Write {key} = {{ x = [0, inf] }}."
    return EitherForm(EntriesForm(ShapeEntry, word=key, fault=fault, remedy=remedy, shows=True), _LIMITS)


@dataclass(frozen=True, eq=False)
class ParameterEntry:
    """One `[parameters.NAME]`; None where a key is missing."""

    location: Location
    name: str
    x: AxisEntry | None = key(
        'an axis, with the keys of `[axes.NAME]`, or the name of a group axis, `{ axis = "AxisSpeed" }`. A scalar has '
        "none, a curve has `x`, a map `x` and `y`",
        None,
        default_text=_INITIAL,
    )
    y: AxisEntry | None = key("the second axis", None, default_text=_INITIAL)
    z: AxisEntry | None = key("the third axis", None, default_text=_INITIAL)
    w: AxisEntry | None = key("the fourth axis", None, default_text=_INITIAL)
    per: Literal["recording"] | None = key(
        '`"recording"`: a scalar of the function has [a value for each recording](#a-value-for-each-recording)',
        None,
        default_text="one value for all",
    )
    unit: str | None = key("unit of the values", None, form=TextForm(may_be_empty=True), default_text=_INITIAL)
    description: str | None = key(
        "a text on the parameter", None, form=TextForm(may_be_empty=True), default_text=_INITIAL
    )
    initial: Float | None = key(
        "a number, or all values, one row for each x", None, form=ArrayForm(), default_text=_INITIAL
    )
    free: bool | None = key("`false` keeps the values", None, default_text="by `[calibration]`")
    bounds: tuple[Float, Float] | Around | None = key(
        "`[lower, upper]`; each a number or a table of the parameter's shape. They hold exactly. "
        "`{ relative = 0.1 }` keeps each value within 10 % of its initial one, `{ absolute = 5 }` within 5, both "
        "within the larger distance",
        None,
        form=BoundsForm(),
        default_text="none",
    )
    step: float | None = key(
        "the step of the values that a control unit can store, whose multiples [rounding](how-to/rounding.md) takes; "
        "precedes `storage` of `[calibration]`",
        None,
        above=0,
        default_text="by `storage`",
    )
    smoothness: Factor | Mapping[str, Factor] | None = key(
        'factor on the [roughness](method.md#roughness), for all axes or `{ x = 1, y = 0.3 }`. `"auto"` instead of a '
        "number [chooses it from the data](method.md#automatic-smoothness)",
        None,
        form=FACTORS,
        default_text="0",
    )
    lock: Lock = key(
        '`true`; or `"no-data"`: grid points that no training sample uses; or ranges of axis values, including their '
        "ends, `[{ x = [700, 1000], y = [0, 50] }]`; of a value block, ranges of its positions, which count from 0",
        False,
        form=LockForm(),
    )
    pins: tuple[PinEntry, ...] = key(
        "`[{ at = [1000, 50], value = 120 }]`: the table has exactly this value at this point",
        (),
        name="pin",
        word="pin",
        fault="must be a list of pins",
        remedy="Write pin = [{ at = [...], value = ... }].",
        shows=True,
    )
    gradient: Range | tuple[ShapeEntry, ...] = key(
        "`{ x = [0, inf] }`: range of dz/dx between neighbours, in units of z per unit of x; with 0 on one side the "
        "table is monotonic. A list limits parts of the table, "
        "`[{ y = [0, inf], where = { x = [2000, inf] } }]`",
        factory=dict,
        form=_shapes("gradient"),
        default_text="none",
    )
    curvature: Range | tuple[ShapeEntry, ...] = key(
        "`{ x = [0, inf] }`: range of d2z/dx2; >= 0 is convex, <= 0 concave. A list as for `gradient`",
        factory=dict,
        form=_shapes("curvature"),
        default_text="none",
    )
    extrapolation: Extrapolation | None = key(
        '`"linear"` extrapolates beyond the ends; an infinite input then gives no finite number',
        None,
        default_text='`"clip"`',
    )

    @property
    def axes(self) -> Mapping[str, AxisEntry]:
        """The axes by direction."""
        return {name: axis for name in DIRECTIONS if (axis := getattr(self, name)) is not None}
