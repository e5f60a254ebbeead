"""Radial basis functions: a plane, perhaps with kinks, plus a sum of bell-shaped kernels, "bells" for short.

`Expansion` is the function, which every data-driven model of this package evaluates; `RBF` is the parameter that holds
its values, so that they can be calibrated, for example in place of a large map.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from numbers import Real
from typing import Any, ClassVar, Literal, NamedTuple, Self, Unpack, get_args

import numpy as np

from kennfeld.base.arrays import ArrayLike, Float, readonly
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Parameter, ParameterAttributes

BELLS_PER_BLOCK = 1 << 18  # 2 MB, which stays in the cache
MAX_DISTANCE = 1e3  # widths from a centre; the bell is exactly 0 long before
MIN_WIDTH = 0.05  # of the initial width: default lower bound of a width

Kernel = Literal["gaussian", "matern52"]


def kernel_of_square(square: Float, kernel: Kernel) -> tuple[Float, Float]:
    """Evaluate the bell b at squared distances r^2 in widths, Float[any], and its decline -db/dr / r; both Float[any].

    The Gaussian bell is exp(-r^2 / 2), which is its own decline. The one of the Matern kernel of order 5/2 is
    (1 + s + s^2 / 3) exp(-s) with s = sqrt(5) r; it is twice differentiable, and its decline is 5/3 (1 + s) exp(-s).
    C. E. Rasmussen, C. K. I. Williams: Gaussian Processes for Machine Learning, 2006, equation 4.17.

    >>> [float(part.round(6)) for part in kernel_of_square(np.array(1.0), "matern52")]
    [0.523994, 0.57644]
    """
    if kernel == "gaussian":
        bell: Float = np.exp(-0.5 * square)
        return bell, bell
    s = np.sqrt(5.0 * square)
    fading = np.exp(-s)
    return (1.0 + s + s * s / 3.0) * fading, 5.0 / 3.0 * (1.0 + s) * fading


class Hinge(NamedTuple):
    """The term height max(x_input - position, 0): the slope along an input changes by `height` at a kink.

    `input` counts from 0; `position` is in the unit of that input.
    """

    input: int
    position: float
    height: float


@dataclass(frozen=True, eq=False)
class Expansion:
    """y(x) = offset + slopes . x + sum_i weights_i bell(r_i), r_i^2 = sum_d ((x_d - centres_id) / widths_id)^2.

    `x` and `y` are in physical units, and `kernel_of_square` gives the bell. The mean of a Gaussian process has this
    form, and so does a network of radial basis functions. Hinges, if there are any, are added. Two are equal if all
    their numbers are, bit for bit.

    Attributes:
        offset: in the unit of y.
        slopes: Float[inputs], of the plane.
        weights: Float[centres], the heights of the bells.
        centres: Float[centres, inputs].
        widths: Float[centres, inputs], > 0.
        kernel: the shape of a bell: "gaussian", or "matern52" of the Matern kernel of order 5/2.
        hinges: terms that kink the plane; at a kink, the slope is that above it.

    Raises:
        ArgumentError: shapes are inconsistent, a number is not finite, a width is not > 0, the kernel is unknown, or a
            hinge is along an input that does not exist.

    >>> bell = Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]])
    >>> float(bell(np.array([3.0])))
    3.0
    """

    offset: float
    slopes: Float  # Float[inputs]
    weights: Float  # Float[centres]
    centres: Float  # Float[centres, inputs]
    widths: Float  # Float[centres, inputs]
    kernel: Kernel = "gaussian"
    hinges: tuple[Hinge, ...] = ()

    def __init__(
        self,
        offset: float,
        slopes: ArrayLike,
        weights: ArrayLike,
        centres: ArrayLike,
        widths: ArrayLike,
        kernel: Kernel = "gaussian",
        hinges: Sequence[Sequence[float]] = (),
    ) -> None:
        tables = {"slopes": slopes, "weights": weights, "centres": centres, "widths": widths}
        for name, value in {"offset": offset, **tables, "kernel": kernel, "hinges": hinges}.items():
            object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        check_kernel(self.kernel)
        object.__setattr__(self, "offset", float(self.offset))
        if not np.isfinite(self.offset):
            raise ArgumentError(f"offset={self.offset} of an expansion must be a finite number")
        for name in ("slopes", "weights", "centres", "widths"):
            object.__setattr__(self, name, _finite(name, getattr(self, name)))
        if self.slopes.ndim != 1 or not self.slopes.size:
            raise ArgumentError(f"slopes of an expansion must be one number per input, got shape {self.slopes.shape}")
        if self.weights.ndim != 1:
            raise ArgumentError(
                f"weights of an expansion must be one number per centre, got shape {self.weights.shape}"
            )
        shape = (self.weights.size, self.slopes.size)
        for name in ("centres", "widths"):
            own = getattr(self, name).shape
            if own != shape:
                raise ArgumentError(f"{name} of an expansion have shape {own}, weights and slopes require {shape}")
        if not np.all(self.widths > 0):
            raise ArgumentError(f"widths of an expansion must be > 0, the smallest is {self.widths.min():g}")
        object.__setattr__(self, "hinges", _checked_hinges(self.hinges, self.slopes.size))

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self.slopes.size

    @property
    def size(self) -> int:
        """Number of centres."""
        return self.weights.size

    def __call__(self, x: Float) -> Float:
        """Evaluate the function at each point: Float[..., inputs] -> Float[...]."""
        points, shape = self._points(x)
        value = np.empty(len(points))
        for part, _, square in self._blocks(points):
            # [points, centres] @ [centres]
            value[part] = kernel_of_square(square, self.kernel)[0] @ self.weights
        with np.errstate(invalid="ignore", over="ignore"):
            value += self.offset + points @ self.slopes
            if self.hinges:
                value += evaluate_hinges(self.hinges, points)
        return value.reshape(shape)

    def gradient(self, x: Float) -> Float:
        """Return the slope along each input at each point: Float[..., inputs] -> Float[..., inputs]."""
        points, shape = self._points(x)
        slopes = np.empty(points.shape)
        # dy/dx_d = slope_d - sum_i weight_i decline_i (x_d - c_id) / width_id^2; `distances` has one of the divisions
        for part, distances, square in self._blocks(points):
            weighted = kernel_of_square(square, self.kernel)[1] * self.weights
            for d in range(self.inputs):
                slopes[part, d] = self.slopes[d] - np.sum(weighted * distances[d] / self.widths[:, d], axis=1)
        for along, position, height in self.hinges:
            slopes[:, along] += np.where(points[:, along] >= position, height, 0.0)
        return slopes.reshape((*shape, self.inputs))

    @property
    def without_hinges(self) -> "Expansion":
        """The plane and the bells alone."""
        parts = (self.offset, self.slopes, self.weights, self.centres, self.widths)
        return Expansion(*parts, kernel=self.kernel) if self.hinges else self

    def _points(self, x: Float) -> tuple[Float, tuple[int, ...]]:
        """Return the points one after another, and the shape that their values have."""
        points = np.asarray(x, dtype=np.float64)
        if points.ndim == 0 or points.shape[-1] != self.inputs:
            raise ArgumentError(f"x must have the shape [..., {self.inputs}], got {points.shape}")
        return points.reshape(-1, self.inputs), points.shape[:-1]

    def _blocks(self, points: Float) -> Iterator[tuple[slice, list[Float], Float]]:
        """Yield for each block its points, their distances to the centres along each input in widths, and r^2."""
        rows = max(BELLS_PER_BLOCK // max(self.size, 1), 1)
        for first in range(0, len(points), rows):
            part = slice(first, first + rows)
            distances = [self._distances(points[part, d], d) for d in range(self.inputs)]
            square = np.zeros((len(points[part]), self.size))
            for distance in distances:
                square += distance * distance
            yield part, distances, square

    def _distances(self, x: Float, d: int) -> Float:
        with np.errstate(over="ignore", invalid="ignore"):
            distance: Float = (x[:, None] - self.centres[:, d]) / self.widths[:, d]
        # far away, an infinite distance times 0 would be NaN; the NaN of a missing input stays
        return np.clip(distance, -MAX_DISTANCE, MAX_DISTANCE, out=distance)

    def __eq__(self, other: object) -> bool:
        return self._content == other._content if isinstance(other, Expansion) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def _content(self) -> tuple[str, tuple[int, int], bytes, bytes]:
        numbers = np.concatenate([[self.offset], self.slopes, self.weights, *self.hinges])
        # with both counts, the numbers of slopes, weights and hinges follow
        counts = self.slopes.size, self.size
        return self.kernel, counts, numbers.tobytes(), self.centres.tobytes() + self.widths.tobytes()


def check_kernel(kernel: str) -> None:
    """Raise `ArgumentError` if there is no such kernel."""
    if kernel not in get_args(Kernel):
        raise ArgumentError(f"kernel={kernel!r} of an expansion must be {' or '.join(get_args(Kernel))}")


def evaluate_hinges(hinges: Sequence[Hinge], x: Float) -> Float:
    """Add up hinges at points: Float[points, inputs] -> Float[points]."""
    value = np.zeros(len(x))
    for along, position, height in hinges:
        value += height * np.maximum(x[:, along] - position, 0.0)
    return value


def _checked_hinges(hinges: Sequence[Sequence[float]], inputs: int) -> tuple[Hinge, ...]:
    try:
        rows: list[tuple[Any, ...]] = [tuple(hinge) for hinge in hinges]
        # float() would take texts, and a truth value is a number to Python
        if not all(isinstance(number, Real) and not isinstance(number, bool) for row in rows for number in row):
            raise TypeError
        checked = tuple(Hinge(int(along), float(position), float(height)) for along, position, height in rows)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError("hinges of an expansion must be rows of input, position and height") from None
    for hinge, given in zip(checked, rows, strict=True):
        # int() has cut off a fraction
        if hinge.input != given[0] or not 0 <= hinge.input < inputs:
            message = f"hinges of an expansion are along inputs 0 to {inputs - 1}, counted from 0, not {given[0]:g}"
            raise ArgumentError(message)
        if not np.isfinite(hinge).all():
            raise ArgumentError(f"hinges of an expansion must have finite numbers, got {tuple(hinge)}")
    return checked


def _finite(name: str, values: Float) -> Float:
    try:
        array = readonly(values)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} of an expansion must be numbers, all rows of equal length") from None
    bad = ~np.isfinite(array)
    if bad.any():
        at = ", ".join(str(int(i)) for i in np.argwhere(bad)[0])
        raise ArgumentError(f"{name}[{at}]={array[bad][0]} of an expansion must be a finite number")
    return array


class Parts(NamedTuple):
    """Positions of the numbers of an expansion among the values of a parameter."""

    offset: slice
    slopes: slice  # [inputs]
    weights: slice  # [centres]
    centres: slice  # [inputs, centres]
    widths: slice  # [inputs, centres]


def parts(inputs: int, size: int) -> Parts:
    """Return the positions of the parts of an expansion, one after the other.

    >>> parts(2, 10).widths
    slice(33, 53, None)
    """
    ends = np.cumsum([0, 1, inputs, size, inputs * size, inputs * size]).tolist()
    return Parts(*(slice(a, b) for a, b in pairwise(ends)))


@dataclass(frozen=True, eq=False, kw_only=True, init=False)
class RBF(Parameter):
    """An `Expansion` as a parameter whose values are its offset, slopes, weights, centres and widths.

    A formula calls it like a table, `y = Model(a, b)`. `values` holds the offset, the slopes, the weights, then the
    centres and the widths by input.

    Args:
        name: its name in formulas and files.
        expansion: the function.
        inputs: the quantities that it depends on.
        attributes: unit, bounds and all else that parameters have.

    Attributes:
        kernel: the shape of a bell, that of the expansion.
        hinges: those of the expansion, which are not among the values; calibration leaves them as they are.

    Raises:
        ArgumentError: the number of inputs is not that of the expansion.

    >>> bell = RBF("Bell", Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]]), inputs=["Speed"])
    >>> bell.values, bell.coordinates
    (array([1. , 0. , 2. , 3. , 0.5]), 1)
    """

    kind: ClassVar[str] = "rbf"

    inputs: tuple[str, ...] = ()
    kernel: Kernel = "gaussian"
    hinges: tuple[Hinge, ...] = ()

    def __init__(
        self,
        name: str,
        expansion: Expansion,
        inputs: str | Iterable[str] = (),
        **attributes: Unpack[ParameterAttributes],
    ) -> None:
        labels = ((inputs,) if isinstance(inputs, str) else tuple(map(str, inputs))) or ("",) * expansion.inputs
        if len(labels) != expansion.inputs:
            raise ArgumentError(f"{name} has {expansion.inputs} inputs, got inputs={list(labels)}")
        object.__setattr__(self, "inputs", labels)
        object.__setattr__(self, "kernel", expansion.kernel)
        object.__setattr__(self, "hinges", expansion.hinges)
        # by input: all centres of the first one, then of the next
        tables = (expansion.centres.T.ravel(), expansion.widths.T.ravel())
        values = np.concatenate([[expansion.offset], expansion.slopes, expansion.weights, *tables])
        super().__init__(name=name, values=values, **attributes)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        super().__post_init__()
        widths = parts(self.coordinates, self.centres).widths
        lower = self.lower.copy()
        # at a width of 0 the function is not defined
        lower[widths] = np.where(lower[widths] > 0, lower[widths], MIN_WIDTH * self.values[widths])
        lower.setflags(write=False)
        object.__setattr__(self, "lower", lower)

    def with_values(self, values: ArrayLike) -> Self:
        # the bounds of widths may depend on them
        return super().with_values(values).changed()

    def _expected_shape(self, values: Float) -> tuple[int, ...]:
        inputs = self.coordinates
        # an offset and a slope per input; each centre has a weight, and a position and a width per input
        count, rest = divmod(values.size - 1 - inputs, 1 + 2 * inputs)
        if values.ndim != 1 or rest or count < 0:
            raise ArgumentError(f"{self.name} has values of shape {values.shape}, which do not fit {inputs} inputs")
        return values.shape

    @property
    def centres(self) -> int:
        """Number of centres."""
        return (self.values.size - 1 - self.coordinates) // (1 + 2 * self.coordinates)

    @property
    def coordinates(self) -> int:
        return len(self.inputs)

    @property
    def index_axes(self) -> tuple[Axis, ...]:
        return (Axis(np.arange(self.size)),)

    @property
    def expansion(self) -> Expansion:
        """The function of its values."""
        at = parts(self.coordinates, self.centres)
        centres, widths = (
            self.values[part].reshape(self.coordinates, self.centres).T for part in (at.centres, at.widths)
        )
        slopes, weights = self.values[at.slopes], self.values[at.weights]
        return Expansion(
            float(self.values[0]), slopes, weights, centres, widths, kernel=self.kernel, hinges=self.hinges
        )

    def _look_up(self, points: list[Float]) -> Float:
        return self.expansion(np.stack(points, axis=-1))

    @property
    def packed(self) -> Float:
        """Its values as compiled code reads them, Float[values]: in place of each width, its reciprocal."""
        packed = self.values.copy()
        widths = parts(self.coordinates, self.centres).widths
        # so that compiled code multiplies by widths that no calibration changes
        packed[widths] = 1 / packed[widths]
        return packed

    @property
    def input_labels(self) -> list[str]:
        """The inputs by name, or by number from 1 on if they have none."""
        return [name or f"input {d + 1}" for d, name in enumerate(self.inputs)]

    def value_name(self, number: int) -> str:
        """Return the name of a value, counted from 1: `width 2 in Speed`.

        >>> bell = RBF("Bell", Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]]), inputs=["Speed"])
        >>> [bell.value_name(i) for i in range(bell.size)]
        ['offset', 'slope in Speed', 'weight 1', 'centre 1 in Speed', 'width 1 in Speed']
        """
        at = parts(self.coordinates, self.centres)
        labels = self.input_labels
        if number < at.slopes.start:
            return "offset"
        if number < at.slopes.stop:
            return f"slope in {labels[number - at.slopes.start]}"
        if number < at.weights.stop:
            return f"weight {number - at.weights.start + 1}"
        part = "centre" if number < at.centres.stop else "width"
        d, centre = divmod(number - (at.centres if part == "centre" else at.widths).start, self.centres)
        return f"{part} {centre + 1} in {labels[d]}"

    def has_form_of(self, other: "RBF") -> bool:
        """Check whether another one has as many inputs and the same kernel and hinges, which are not among values."""
        return (self.coordinates, self.kernel, self.hinges) == (other.coordinates, other.kernel, other.hinges)

    def has_grid_of(self, other: Parameter) -> bool:
        """Check whether equal values of another parameter make the same function."""
        return super().has_grid_of(other) and isinstance(other, RBF) and self.has_form_of(other)

    def changed(self, **changes: Any) -> Self:
        copy = object.__new__(type(self))
        for name in ("inputs", "kernel", "hinges"):
            # before the others, whose check needs the number of inputs
            object.__setattr__(copy, name, changes.pop(name, getattr(self, name)))
        Parameter.__init__(copy, **self._attributes(changes))
        return copy

    def value_slopes(self, x: Float) -> Float:
        """Return the derivatives by its own values: Float[samples, inputs] -> Float[samples, values]."""
        e = self.expansion
        distance = (x[:, :, None] - e.centres.T) / e.widths.T  # [samples, inputs, centres]
        kernels, declines = kernel_of_square(np.sum(distance * distance, axis=1), e.kernel)
        # dy/dc_id = weight_i decline_i (x_d - c_id) / width_id^2; dy/dwidth_id is that times (x_d - c_id) / width_id
        along = (e.weights * declines)[:, None, :] * distance / e.widths.T
        flat = (array.reshape(len(x), -1) for array in (along, along * distance))
        return np.hstack([np.ones((len(x), 1)), x, kernels, *flat])
