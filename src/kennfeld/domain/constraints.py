"""Constraints of a calibration in addition to bounds and locks: shapes of tables, equalities, and output limits."""

from collections.abc import Mapping, Sequence
from dataclasses import field
from numbers import Integral
from typing import Literal, get_args

from kennfeld.base.arrays import ArrayLike
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import array, number
from kennfeld.domain.axis import AXIS_LETTERS

AxisLetter = Literal["x", "y", "z", "w"]
UNBOUNDED = float("inf")


@dataclass(frozen=True)
class Limit:
    """Limits of an output at every scored sample of the training data: `lower <= node <= upper`.

    Attributes:
        node: a node, or an expression over nodes, inputs, channels and lookups of tables, `MapA(u, 1)`.
        lower: lower limit, in the unit of the node; None stands for no limit.
        upper: upper limit.
        where: a condition over inputs and channels; the limit applies to samples at which it is not 0.

    Raises:
        ArgumentError: a bound is not a number, or the lower one exceeds the upper one.

    >>> Limit("abs(n_set - n)", upper=50.0, where="t_since_step > 1").upper
    50.0
    """

    node: str
    lower: float = -UNBOUNDED
    upper: float = UNBOUNDED
    where: str = ""

    def __init__(self, node: str, lower: float | None = None, upper: float | None = None, where: str = "") -> None:
        object.__setattr__(self, "node", node)
        object.__setattr__(self, "where", where)
        _set_range(self, f"limit of {node}", lower, upper)


@dataclass(frozen=True)
class Pin:
    """An equality: the parameter's interpolated value at these coordinates is `value`.

    Attributes:
        parameter: name of the parameter.
        at: a coordinate for each axis, in its unit.
        value: in the unit of the parameter.

    >>> Pin("CurveEta", (0,), 1.0)
    Pin(parameter='CurveEta', at=(0.0,), value=1.0)
    """

    parameter: str
    at: tuple[float, ...]
    value: float

    def __post_init__(self) -> None:
        owner = f"the pin of {self.parameter}"
        object.__setattr__(self, "at", _coordinates(self.at, owner))
        object.__setattr__(self, "value", float(array(self.value, f"value of {owner}")))


@dataclass(frozen=True)
class Shape:
    """Limits of a table's slope or curvature along one axis, at every grid point.

    Attributes:
        parameter: name of the table.
        axis: `x`, `y`, `z` or `w`, or its number from 0.
        kind: `slope` is dz/dx between neighbours, in units of z per unit of x: monotonic if >= 0. `curvature` is
            d2z/dx2 between three neighbours: convex if >= 0.
        lower: lower bound.
        upper: upper bound.
        where: by axis letter a range of axis values, both ends included; differences count whose grid points are all
            within these ranges. Default is the whole table.

    Raises:
        ArgumentError: a bound is not a number, or the lower one exceeds the upper one.

    >>> Shape("MapX", 1, "slope", lower=0.0, where={"x": (2000, 6000)}).where
    {'x': (2000.0, 6000.0)}
    """

    parameter: str
    axis: int
    kind: Literal["slope", "curvature"]
    lower: float = -UNBOUNDED
    upper: float = UNBOUNDED
    where: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __init__(
        self,
        parameter: str,
        axis: int | AxisLetter,
        kind: Literal["slope", "curvature"],
        *,
        lower: float | None = None,
        upper: float | None = None,
        where: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        if isinstance(axis, str) and axis in get_args(AxisLetter):
            axis = get_args(AxisLetter).index(axis)
        elif isinstance(axis, bool) or not isinstance(axis, Integral):
            message = f"axis={axis!r} of a shape of {parameter} must be x, y, z or w, or its number from 0"
            raise ArgumentError(message)
        if kind not in ("slope", "curvature"):
            raise ArgumentError(f"kind={kind!r} of a shape of {parameter} must be slope or curvature")
        for name, value in (("parameter", parameter), ("axis", int(axis)), ("kind", kind)):
            object.__setattr__(self, name, value)
        owner = f"{kind} of {parameter}"
        _set_range(self, owner, lower, upper)
        ranges = {letter: _ends(ends, letter, owner) for letter, ends in (where or {}).items()}
        object.__setattr__(self, "where", ranges)


@dataclass(frozen=True)
class Term:
    """A parameter's interpolated value at coordinates, times a factor; without coordinates the sum of all values.

    Attributes:
        parameter: name of the parameter.
        at: a coordinate for each axis; None for the sum of all values.
        factor: multiplies the value or the sum.

    >>> Term("CurveEta", (0,), -1.0).at
    (0.0,)
    """

    parameter: str
    at: tuple[float, ...] | None = None
    factor: float = 1.0

    def __post_init__(self) -> None:
        owner = f"the term of {self.parameter}"
        if self.at is not None:
            object.__setattr__(self, "at", _coordinates(self.at, owner))
        object.__setattr__(self, "factor", number(self.factor, "factor", owner))


@dataclass(frozen=True)
class Equality:
    """The sum of the terms is `value`: two equal values, or several values with a given sum.

    Attributes:
        terms: at least one.
        value: their sum.

    Raises:
        ArgumentError: there are no terms, or the value is not a number.

    >>> print(Equality([Term("MapA", (1000, 50)), Term("MapB", (1000, 50), -1.0)]))
    MapA(1000, 50) + -1 MapB(1000, 50) = 0
    """

    terms: tuple[Term, ...]
    value: float = 0.0

    def __init__(self, terms: Sequence[Term], value: float = 0.0) -> None:
        if not terms:
            raise ArgumentError("an equality needs at least one term")
        object.__setattr__(self, "terms", tuple(terms))
        object.__setattr__(self, "value", number(value, "value", "an equality"))

    def __str__(self) -> str:
        return f"{' + '.join(map(_term_text, self.terms))} = {self.value:g}"


def _term_text(term: Term) -> str:
    name = f"sum({term.parameter})" if term.at is None else f"{term.parameter}({', '.join(f'{x:g}' for x in term.at)})"
    return name if term.factor == 1 else f"{term.factor:g} {name}"


def _coordinates(at: ArrayLike, owner: str) -> tuple[float, ...]:
    return tuple(array(at, f"coordinates of {owner}").tolist())


def _ends(ends: tuple[float, float], axis: str, owner: str) -> tuple[float, float]:
    """Return the ends of a range along an axis as numbers, in order."""
    if axis not in AXIS_LETTERS:
        raise ArgumentError(f"where of the {owner}: axis {axis!r} is none of {', '.join(AXIS_LETTERS)}")
    first, last = (number(end, f"where of the {owner} along {axis}", "", infinite=True) for end in ends)
    if not first <= last:
        raise ArgumentError(f"where of the {owner}: {first:g} exceeds {last:g} along {axis}")
    return first, last


def _set_range(limit: Limit | Shape, owner: str, lower: float | None, upper: float | None) -> None:
    """Set the bounds of a limit; None stands for none."""
    low = -UNBOUNDED if lower is None else number(lower, "lower", owner, infinite=True)
    high = UNBOUNDED if upper is None else number(upper, "upper", owner, infinite=True)
    if not low <= high:
        raise ArgumentError(f"{owner}: lower limit {low:g} exceeds upper limit {high:g}")
    object.__setattr__(limit, "lower", low)
    object.__setattr__(limit, "upper", high)
