"""Calibration parameters: scalars, value blocks, curves, maps and cubes.

All types are frozen. `Map.values[i, j]` belongs to x breakpoint i and y breakpoint j.
"""

from collections.abc import Iterable
from dataclasses import field, fields
from importlib import import_module
from typing import Any, ClassVar, Literal, Self, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import ArrayLike, Bool, Float, readonly
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.base.numeric import array, truths
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.data_frames import grid_frame

Extrapolation = Literal["clip", "linear"]
LABELS = ("description", "display_name", "variant", "functions")  # attributes that parameters and texts share
_ASPECTS = {"extrapolation": "extrapolation", "lower": "bounds", "upper": "bounds", "locked": "locks"}  # by attribute
_LOOKUP = "kennfeld.graph.interpolation"  # in a higher layer


class ParameterAttributes(TypedDict, total=False):
    """The attributes that parameters of all kinds have besides their name, values and axes; see `Parameter`."""

    unit: str
    description: str
    lower: ArrayLike | None
    upper: ArrayLike | None
    locked: ArrayLike
    extrapolation: Extrapolation
    functions: Iterable[str]
    display_name: str
    variant: str
    unstated: Iterable[str]


class ParameterChanges(ParameterAttributes, total=False):
    """The attributes of a parameter that a copy may have otherwise."""

    name: str
    values: ArrayLike
    axes: tuple[Axis, ...]


def _freedom(axes: Iterable[Axis]) -> list[tuple[Any, ...]]:
    return [(axis.free, axis.min_distance, axis.range) for axis in axes]


@dataclass(frozen=True, eq=False, kw_only=True)
class Parameter(NotebookDisplay):
    """A calibratable quantity: an array of values over zero to four axes.

    Attributes:
        name: its name in formulas and files.
        values: Float of the shape of its axes.
        axes: its axes x, y, z and w.
        unit: unit of the values.
        description: free text.
        lower: lower bounds, in the shape of `values`; a single number is broadcast, None stands for no bound.
        upper: upper bounds.
        locked: True for values that a calibration does not change.
        extrapolation: `clip` holds the values at the ends of the axes, `linear` continues their slope.
        functions: the parts of the ECU software that use it.
        display_name: its short name.
        variant: the variant (`Engine=2`) that the values belong to; empty if there is just one.
        kind: `scalar`, `block`, `curve`, `map`, `cube` or `rbf`.
        unstated: the aspects that the format of its file cannot state, of "extrapolation", "bounds", "locks" and "free
            axes". It plays no part in comparisons, and an aspect that `changed` sets is stated.

    Raises:
        ArgumentError: shapes, bounds or axes are inconsistent.

    A parameter can be called with coordinates; NumPy functions take it as the array of its values.

    >>> gain = Curve("Gain", [0, 10, 20], [1.0, 1.2, 1.6])
    >>> gain(15), np.asarray(gain)
    (1.4, array([1. , 1.2, 1.6]))
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
    unstated: frozenset[str] = field(default=frozenset(), repr=False)

    def __post_init__(self) -> None:
        attributes = vars(self)  # the class is frozen
        attributes["functions"] = tuple(self.functions)
        attributes["unstated"] = frozenset(self.unstated)
        values = attributes["values"] = readonly(self.values)
        shape = self._expected_shape(values)
        if values.shape != shape:
            raise ArgumentError(f"{self.name} has values of shape {values.shape}, its axes require {shape}")
        if self.extrapolation not in ("clip", "linear"):
            raise ArgumentError(f"extrapolation={self.extrapolation!r} of {self.name} must be clip or linear")
        for side, unbounded in (("lower", -np.inf), ("upper", np.inf)):
            attributes[side] = unbounded if attributes[side] is None else attributes[side]
            attributes[side] = self._spread(side, array(attributes[side], f"{side} bounds of {self.name}"))
        attributes["locked"] = self._spread("locked", truths(self.locked, f"locked of {self.name}"))
        # false for NaN, too, which is refused as well
        ordered = self.lower <= self.upper
        if not ordered.all():
            reversed_bounds = ~ordered
            at = tuple(int(i) for i in np.unravel_index(int(reversed_bounds.argmax()), reversed_bounds.shape))
            place = f"{self.name}{list(at)}" if at else self.name
            bounds = f"the lower bound {self.lower[at]:g} above its upper bound {self.upper[at]:g}"
            raise ArgumentError(f"{place} has {bounds}")

    def _expected_shape(self, values: Float) -> tuple[int, ...]:
        return tuple(len(axis) for axis in self.axes)

    def _spread(self, attribute: str, numbers: NDArray[Any]) -> Any:
        try:
            same = numbers.shape == self.values.shape
            # memory of its own: the caller may write to the array later
            spread = numbers.copy() if same else np.broadcast_to(numbers, self.values.shape).copy()
        except ValueError:
            message = f"{attribute} of {self.name} has shape {numbers.shape}, its values have {self.values.shape}"
            raise ArgumentError(message) from None
        spread.setflags(write=False)
        return spread

    @property
    def size(self) -> int:
        """Number of values."""
        return self.values.size

    @property
    def value(self) -> float:
        """The number, if it is a single one; `ArgumentError` for tables."""
        if self.size != 1:
            raise ArgumentError(f"{self.name} has {self.size} values; `values` holds them")
        return float(self.values.item())

    def __float__(self) -> float:
        return self.value

    @property
    def limited(self) -> bool:
        """True if any of its values has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    @property
    def at_bound(self) -> Bool:
        """True for values at a bound; locked values, and those with equal bounds, do not count."""
        outside = (self.values <= self.lower) | (self.values >= self.upper)
        # equal bounds are another way to lock a value
        return outside & ~self.locked & (self.lower < self.upper)

    @property
    def index_axes(self) -> tuple[Axis, ...]:
        """The axes that a lookup searches: its own, or the positions 0, 1, ... of a value block."""
        return self.axes

    @property
    def coordinates(self) -> int:
        """Number of coordinates of a lookup."""
        return len(self.index_axes)

    @property
    def packed(self) -> Float:
        """The values as compiled code reads them if no calibration changes them: Float[values], in C order."""
        return self.values.ravel()

    def to_frame(self) -> Any:
        """Return the values as a DataFrame of pandas, over the breakpoints.

        A map has x along the rows and y along the columns; a curve, a cube and a value block have one column, with a
        level of the index per axis.

        Raises:
            InputError: pandas is not installed; the message has the command that installs it.
        """
        axes = zip(self.index_axes, AXIS_LETTERS, strict=False)
        return grid_frame(self.name, self.values, [(a.input or a.name or letter, a.breakpoints) for a, letter in axes])

    def has_grid_of(self, other: "Parameter") -> bool:
        """Check whether another parameter is of the same kind, with the same shape and breakpoints."""
        same = self.kind == other.kind and self.values.shape == other.values.shape
        pairs = zip(self.axes, other.axes, strict=False)
        return same and all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in pairs)

    def with_values(self, values: ArrayLike) -> Self:
        """Return the same parameter with other values: an array of its shape, or a flat one in C order."""
        numbers = array(values, f"values of {self.name}")
        if numbers.shape not in (self.values.shape, (self.size,)):
            raise ArgumentError(f"{self.name} has values of shape {self.values.shape}, got {numbers.shape}")
        copy = object.__new__(type(self))
        # all else has been checked, and is read-only
        vars(copy).update(vars(self), values=readonly(numbers.reshape(self.values.shape)))
        return copy

    def with_bounds(self, lower: ArrayLike | None = None, upper: ArrayLike | None = None) -> Self:
        """Return the same parameter within other bounds, each a number, an array of its shape, or None for none."""
        return self.changed(lower=lower, upper=upper)

    def __call__(self, *coordinates: ArrayLike) -> Any:
        """Look the parameter up, as the function does: `C(1.5)`, `M(1200, 50)`.

        Args:
            coordinates: one for each axis, numbers or arrays of the same shape.

        Returns:
            A number, or Float of the shape of the coordinates; NaN where a coordinate is NaN.

        Raises:
            ArgumentError: more or fewer coordinates than axes.
        """
        if len(coordinates) != self.coordinates:
            message = f"{self.name} takes {self.coordinates} coordinates, got {len(coordinates)}"
            raise ArgumentError(message)
        points = [array(each, f"coordinates of {self.name}") for each in coordinates]
        looked_up = self._look_up(list(np.broadcast_arrays(*points))) if points else self.values
        return float(looked_up) if np.ndim(looked_up) == 0 else looked_up

    def _look_up(self, points: list[Float]) -> Float:
        result: Float = import_module(_LOOKUP).look_up(self.values, self.index_axes, points, self.extrapolation)
        return result

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the values for NumPy, `np.asarray(curve)`."""
        return np.array(self.values, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        numbers = f"{float(self.values):g}" if self.values.ndim == 0 else f"{size_text(self.values.shape)} values"
        over = ", ".join(axis.label for axis in self.axes if axis.name or axis.input)
        parts = [repr(self.name), numbers + (f" over {over}" if over else "")]
        parts += [f"unit={self.unit!r}"] if self.unit else []
        return f"{type(self).__name__}({', '.join(parts)})"

    def changed(self, **changes: Unpack[ParameterChanges]) -> Self:
        """Return the same parameter with some of its attributes replaced."""
        # not the constructor of the kind, which takes other arguments
        copy = object.__new__(type(self))
        Parameter.__init__(copy, **self._attributes({**changes}))
        return copy

    def read_without(self, unstated: Iterable[str]) -> Self:
        """Return the same parameter as one that was read from a format which cannot state some aspects."""
        # a large file has 50 000 parameters, which need no further check
        copy = object.__new__(type(self))
        vars(copy).update(vars(self), unstated=frozenset(unstated))
        return copy

    def _attributes(self, changes: dict[str, Any]) -> dict[str, Any]:
        """Return all attributes with some replaced; an aspect that these set is no longer unstated."""
        own = {f.name: getattr(self, f.name) for f in fields(Parameter)}
        if self.unstated:
            own["unstated"] = self.unstated - {_ASPECTS[name] for name in changes if name in _ASPECTS}
            if _freedom(changes.get("axes", self.axes)) != _freedom(self.axes):
                own["unstated"] -= {"free axes"}
        return own | changes

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Parameter):
            return NotImplemented
        plain = ("kind", "name", "axes", "unit", "extrapolation", *LABELS)
        arrays = ("values", "lower", "upper", "locked")
        # a value may be NaN, missing; bounds and locks never are
        return all(getattr(self, a) == getattr(other, a) for a in plain) and all(
            np.array_equal(getattr(self, a), getattr(other, a), equal_nan=a == "values") for a in arrays
        )

    def __hash__(self) -> int:
        return hash((self.kind, self.name, self.values.tobytes()))


class Scalar(Parameter):
    """One number.

    >>> Scalar("Kp", 0.08, unit="-").value
    0.08
    """

    kind: ClassVar[str] = "scalar"

    def __init__(self, name: str, value: ArrayLike, **attributes: Unpack[ParameterAttributes]) -> None:
        super().__init__(name=name, values=array(value, f"value of {name}"), **attributes)  # type: ignore[arg-type]


class Block(Parameter):
    """A value block: numbers without axes. A formula reads it by position, counted from 0.

    >>> Block("Gains", [0.5, 1.0, 2.0]).values
    array([0.5, 1. , 2. ])
    """

    kind: ClassVar[str] = "block"

    def __init__(self, name: str, values: ArrayLike, **attributes: Unpack[ParameterAttributes]) -> None:
        super().__init__(name=name, values=array(values, f"values of {name}"), **attributes)  # type: ignore[arg-type]

    def _expected_shape(self, values: Float) -> tuple[int, ...]:
        if values.ndim == 0 or values.ndim > 4:
            raise ArgumentError(f"value block {self.name} needs one to four dimensions, got {values.ndim}")
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

    def __init__(
        self, name: str, x: Axis | ArrayLike, values: ArrayLike, **attributes: Unpack[ParameterAttributes]
    ) -> None:
        numbers = array(values, f"values of {name}")
        super().__init__(name=name, axes=(_axis(x),), values=numbers, **attributes)  # type: ignore[arg-type]


class Map(Parameter):
    """Values over two axes, interpolated bilinearly; `values[i, j]` is at x[i], y[j].

    >>> torque = Map("MapTorque", Axis([1000, 2000], "Speed"), Axis([0, 50, 100], "Load"), np.zeros((2, 3)), unit="Nm")
    >>> torque.size, torque.axes[1].input
    (6, 'Load')
    """

    kind: ClassVar[str] = "map"

    def __init__(
        self,
        name: str,
        x: Axis | ArrayLike,
        y: Axis | ArrayLike,
        values: ArrayLike,
        **attributes: Unpack[ParameterAttributes],
    ) -> None:
        numbers = array(values, f"values of {name}")
        super().__init__(name=name, axes=(_axis(x), _axis(y)), values=numbers, **attributes)  # type: ignore[arg-type]


class Cube(Parameter):
    """Values over three or four axes, interpolated multilinearly.

    >>> Cube("Charge", [[1000, 2000], [0, 100], [20, 50, 90]], np.zeros((2, 2, 3))).axes[2].breakpoints
    array([20., 50., 90.])
    """

    kind: ClassVar[str] = "cube"

    def __init__(
        self,
        name: str,
        axes: Iterable[Axis | ArrayLike],
        values: ArrayLike,
        **attributes: Unpack[ParameterAttributes],
    ) -> None:
        converted = tuple(_axis(axis) for axis in axes)
        if len(converted) not in (3, 4):
            raise ArgumentError(f"cube {name} needs 3 or 4 axes, got {len(converted)}")
        numbers = array(values, f"values of {name}")
        super().__init__(name=name, axes=converted, values=numbers, **attributes)  # type: ignore[arg-type]


def _axis(axis: Axis | ArrayLike) -> Axis:
    return axis if isinstance(axis, Axis) else Axis(axis)


_KINDS: tuple[type[Parameter], ...] = (Scalar, Curve, Map, Cube, Cube)


def parameter(
    name: str, values: ArrayLike, axes: Iterable[Axis] = (), **attributes: Unpack[ParameterAttributes]
) -> Parameter:
    """Return the scalar, curve, map or cube with these axes.

    >>> parameter("K", 2.0).kind, parameter("C", [1, 2], [Axis([0, 1])]).kind
    ('scalar', 'curve')
    """
    own = tuple(axes)
    if len(own) >= len(_KINDS):
        raise ArgumentError(f"{name} has {len(own)} axes; tables have at most 4")
    table = object.__new__(_KINDS[len(own)])
    numbers = array(values, f"values of {name}")
    Parameter.__init__(table, name=name, values=numbers, axes=own, **attributes)  # type: ignore[arg-type]
    return table
