"""Grids of numbers that a control unit can store, and the settings of rounding a calibration to them.

    value = (factor * n + shift) / divisor      for whole numbers n from `least` to `largest`

LINEAR of an A2L file has the divisor 1, RAT_FUNC another one. With these three numbers a value is computed by the very
operations with which the conversion computes it, so that what was rounded stays the same when it is stored and read.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from decimal import Decimal
from math import inf
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError, Finding, Location
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import number
from kennfeld.domain.free_axes import AxisKey
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter

RoundingMethod = Literal["joint", "nearest"]
MAX_SHIFT = 2.0  # steps
EXACT = 2.0**53  # whole numbers up to which a double has no gaps
SLACK = 1e-9  # of a step: a limit that close to a storable value allows it


@dataclass(frozen=True)
class StorageGrid:
    """The numbers that can be stored of one label or axis.

    Attributes:
        factor, shift, divisor: the conversion, see above.
        least, largest: the range of the whole number n.
        bits: of the stored number; 0 if unknown.

    >>> grid = StorageGrid(0.75, -10.0, least=0, largest=255)
    >>> grid.step, grid.nearest(np.array([0.0, 1000.0]))
    (0.75, array([ -0.25, 181.25]))
    """

    factor: float
    shift: float = 0.0
    divisor: float = 1.0
    least: float = -inf
    largest: float = inf
    bits: int = 0

    @classmethod
    def of_step(cls, step: float, owner: str = "a parameter") -> "StorageGrid":
        """Return the multiples of a step, each the double nearest to it in decimals: 7 steps of 0.1 are 0.7.

        Raises:
            ArgumentError: the step is not a positive number.

        >>> StorageGrid.of_step(0.1).values(np.array([7.0]))
        array([0.7])
        """
        step = number(step, "step", owner, above=0)
        # a product of doubles would be 0.7000000000000001; a fraction of whole numbers is rounded once
        above, below = Decimal(repr(step)).as_integer_ratio()
        exact = max(above, below) < EXACT
        return cls(float(above), 0.0, float(below)) if exact else cls(step)

    @property
    def step(self) -> float:
        """The distance between neighbours, in physical units."""
        return abs(self.factor / self.divisor)

    @property
    def slope(self) -> float:
        """The change of the value from one whole number to the next, in physical units; may be negative."""
        return self.factor / self.divisor

    def values(self, numbers: Float) -> Float:
        """Compute the physical values of whole numbers, Float[...]."""
        return np.asarray((self.factor * numbers + self.shift) / self.divisor)

    def positions(self, values: Float) -> Float:
        """Compute the place of physical values, Float[...], in units of n; whole numbers if they are on the grid."""
        return np.asarray((values * self.divisor - self.shift) / self.factor)

    def nearest(self, values: Float) -> Float:
        """Round physical values, Float[...], to the nearest storable ones."""
        return self.values(np.clip(np.rint(self.positions(values)), self.least, self.largest))

    def increasing(self, values: Float) -> Float:
        """Round increasing values, Float[values], to different storable ones, as near as possible by least squares.

        >>> StorageGrid(1.0).increasing(np.array([0.9, 1.0, 1.1, 5.2]))
        array([0., 1., 2., 5.])
        """
        from scipy.optimize import isotonic_regression

        # each whole number less its place does not fall; halves all to the same side, so that none of them meet
        place = np.arange(values.size)
        falling = self.slope < 0
        numbers = self.positions(values[::-1] if falling else values) - place
        level = np.clip(isotonic_regression(numbers).x, self.least, self.largest - (values.size - 1))
        rounded = self.values(np.floor(level + 0.5) + place)
        return rounded[::-1] if falling else rounded

    def holds(self, values: Float) -> Bool:
        """Mark the physical values that are stored as they are, Bool[...]."""
        return np.asarray(self.nearest(values) == values)

    def range_within(self, lower: Float, upper: Float) -> tuple[Float, Float]:
        """Find the least and the largest whole number whose value lies within bounds, Float[...] each.

        The first exceeds the second where the bounds contain no storable value.
        """
        with np.errstate(invalid="ignore"):
            ends = np.sort(np.stack([self.positions(lower), self.positions(upper)]), axis=0)
        low, high = np.ceil(ends[0] - SLACK), np.floor(ends[1] + SLACK)
        return np.maximum(low, self.least), np.minimum(high, self.largest)

    @property
    def range(self) -> tuple[float, float]:
        """The least and the largest storable value; infinite without an end."""
        ends = self.values(np.array([self.least, self.largest]))
        return float(ends.min()), float(ends.max())


@dataclass(frozen=True)
class FloatStorage:
    """Storage of a label in floating point: the conversion of its numbers, and their precision.

    >>> float(FloatStorage(single=True).nearest(np.array(0.1)))
    0.10000000149011612
    """

    factor: float = 1.0
    shift: float = 0.0
    divisor: float = 1.0
    single: bool = False

    def nearest(self, values: Float) -> Float:
        """Round physical values, Float[...], to the nearest storable ones."""
        if not self.single:
            return values
        with np.errstate(over="ignore"):
            numbers = np.float64(np.float32((values * self.divisor - self.shift) / self.factor))
        return np.asarray((self.factor * numbers + self.shift) / self.divisor)


@dataclass(frozen=True)
class StorageRounding:
    """Settings of rounding the end of a calibration to what a control unit stores.

    Attributes:
        method: "joint" or "nearest".
        grids: the grid of each parameter that is rounded.
        axes: the grid of the breakpoints of each axis that is rounded.
        floats: the parameters that are stored in floating point; with "joint", they make up for the rounding of others.
        max_shift: the largest distance from the fit, in steps.
        unrounded: why other labels of the file are not rounded, a clause by name.
        source: name of the file that the grids are from; may be empty.

    Raises:
        ArgumentError: an unknown method, or a shift below one step.

    >>> StorageRounding("joint", {"MapTorque": StorageGrid.of_step(2.5)}).max_shift
    2.0
    """

    method: RoundingMethod = "joint"
    grids: Mapping[str, StorageGrid] = field(default_factory=dict)
    axes: Mapping[AxisKey, StorageGrid] = field(default_factory=dict)
    floats: Mapping[str, FloatStorage] = field(default_factory=dict)
    max_shift: float = MAX_SHIFT
    unrounded: Mapping[str, str] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        if self.method not in ("joint", "nearest"):
            raise ArgumentError(f'rounding must be "joint" or "nearest", got {self.method!r}')
        object.__setattr__(self, "max_shift", number(self.max_shift, "max_shift", "the rounding", least=1))

    def with_steps(self, steps: Mapping[str, float], axes: Mapping[AxisKey, float] | None = None) -> "StorageRounding":
        """Return the rounding with steps of some parameters and breakpoints, which replace those of the file."""
        own = {name: StorageGrid.of_step(step, name) for name, step in steps.items()}
        rest = {name: reason for name, reason in self.unrounded.items() if name not in own}
        floats = {name: storage for name, storage in self.floats.items() if name not in own}
        points = {key: StorageGrid.of_step(step, str(key)) for key, step in (axes or {}).items()}
        grids, of_axes = {**self.grids, **own}, {**self.axes, **points}
        return replace(self, grids=grids, axes=of_axes, floats=floats, unrounded=rest)

    def bounds(self, table: Parameter) -> tuple[Float, Float]:
        """Narrow the bounds of a parameter to the range of its storage, so that a search ends within; Float[...] each.

        Ends of the bounds may lie between two steps, as a pin that they must admit may. Bounds outside of the range
        stay; `storage_findings` reports them.
        """
        if table.name not in self.grids:
            return table.lower, table.upper
        least, most = self.grids[table.name].range
        some = (table.lower <= most) & (table.upper >= least)
        low, high = np.maximum(table.lower, least), np.minimum(table.upper, most)
        return np.where(some, low, table.lower), np.where(some, high, table.upper)


def storage_findings(
    parameters: ParameterSet,
    rounding: StorageRounding,
    names: Sequence[str],
    location: Callable[[str], Location],
) -> Iterator[Finding]:
    """Yield what prevents the rounding of free parameters, `names`, and which of their values it leaves as they are."""
    for name in names:
        table, grid = parameters[name], rounding.grids.get(name)
        if table.kind == "rbf":
            yield Finding(location(name), f"{name} is not rounded: it is an expansion", severity="remark")
            continue
        if grid is None:
            missing = f"{rounding.source} does not define it" if rounding.source else "its step is not known"
            reason = rounding.unrounded.get(name, missing)
            if name in rounding.floats and rounding.method == "joint":
                reason += "; its values make up for the rounding of others"
            yield Finding(location(name), f"{name} is not rounded: {reason}", severity="remark")
            continue
        low, high = grid.range_within(table.lower, table.upper)
        # equal bounds are a lock
        fixed = table.locked | (table.lower == table.upper)
        without = (low > high) & ~fixed
        if without.any():
            at = tuple(int(i) for i in np.argwhere(without)[0])
            ends = f"{float(table.lower[at]):g} to {float(table.upper[at]):g}"
            of = f"{count_noun(int(without.sum()), 'value')} of {name}" if without.sum() > 1 else name
            such = "such as " if without.sum() > 1 else ""
            message = f"the bounds {such}{ends} of {of} contain no value that can be stored: its step is {grid.step:g}"
            least, most = grid.range
            if np.isfinite(most - least):
                message += f", its range {least:g} to {most:g}"
            yield Finding(location(name), message, "Widen the bounds, or choose a finer step.")
        kept = np.where(table.locked, table.values, table.lower)
        off = fixed & ~grid.holds(kept)
        if off.any():
            example = float(kept[off][0])
            verb = "is" if off.sum() == 1 else "are"
            count = count_noun(int(off.sum()), "locked value")
            message = f"{count} of {name} {verb} between two steps of {grid.step:g}, such as {example:g}"
            message += "; locked values are not rounded"
            yield Finding(location(name), message, "Correct them in the initial file.", severity="warning")
