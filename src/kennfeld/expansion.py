"""A sum of Gaussian bells over a plane: what every data-driven model of this package computes in the end."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float, readonly
from kennfeld.errors import ArgumentError

__all__ = ["Expansion"]

BLOCK = 1 << 18  # bells worked out at a time: 2 MB, which stays in the cache
FARTHEST = 1e3  # widths from a centre; the bell is exactly 0 long before


@dataclass(frozen=True, eq=False)
class Expansion:
    """y(x) = offset + slopes . x + sum_i weights_i exp(-1/2 sum_d ((x_d - centres_id) / widths_id)^2).

    `x` and `y` are in physical units. The mean of a Gaussian process with a squared-exponential kernel is one, and so
    is a network of radial basis functions. Two are equal where all their numbers are, bit for bit.
    Raises `ArgumentError` where shapes contradict each other, a number is not finite or a width is not above 0.

    >>> bell = Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]])
    >>> float(bell(np.array([3.0])))
    3.0
    """

    offset: float
    slopes: Float  # Float[inputs]
    weights: Float  # Float[centres]
    centres: Float  # Float[centres, inputs]
    widths: Float  # Float[centres, inputs]

    def __post_init__(self) -> None:
        object.__setattr__(self, "offset", float(self.offset))
        if not np.isfinite(self.offset):
            raise ArgumentError(f"offset={self.offset} of an expansion must be a finite number")
        for name in ("slopes", "weights", "centres", "widths"):
            object.__setattr__(self, name, _finite(name, getattr(self, name)))
        if self.slopes.ndim != 1 or not self.slopes.size:
            raise ArgumentError(f"slopes of an expansion must be one number an input, not of shape {self.slopes.shape}")
        if self.weights.ndim != 1:
            raise ArgumentError(
                f"weights of an expansion must be one number a centre, not of shape {self.weights.shape}"
            )
        shape = (self.weights.size, self.slopes.size)
        for name in ("centres", "widths"):
            given = getattr(self, name).shape
            if given != shape:
                raise ArgumentError(f"{name} of an expansion have shape {given}, weights and slopes ask for {shape}")
        if not np.all(self.widths > 0):
            raise ArgumentError(f"widths of an expansion must be above 0, the least is {self.widths.min():g}")

    @property
    def inputs(self) -> int:
        """How many inputs it has."""
        return self.slopes.size

    @property
    def size(self) -> int:
        """How many centres it has."""
        return self.weights.size

    def __call__(self, x: Float) -> Float:
        """The value at each point: Float[..., inputs] -> Float[...]."""
        points, shape = self._points(x)
        value = np.empty(len(points))
        for part, _, bells in self._blocks(points):
            value[part] = bells @ self.weights
        with np.errstate(invalid="ignore", over="ignore"):
            value += self.offset + points @ self.slopes
        return value.reshape(shape)

    def gradient(self, x: Float) -> Float:
        """The slope along each input at each point: Float[..., inputs] -> Float[..., inputs]."""
        points, shape = self._points(x)
        slopes = np.empty(points.shape)
        for part, distances, bells in self._blocks(points):
            weighted = bells * self.weights
            for d in range(self.inputs):
                slopes[part, d] = self.slopes[d] - np.sum(weighted * distances[d] / self.widths[:, d], axis=1)
        return slopes.reshape((*shape, self.inputs))

    def _points(self, x: Float) -> tuple[Float, tuple[int, ...]]:
        """The points one after another, and the shape that their values have."""
        given = np.asarray(x, dtype=np.float64)
        if given.ndim == 0 or given.shape[-1] != self.inputs:
            raise ArgumentError(f"x of shape {given.shape} must end with the {self.inputs} inputs of the expansion")
        return given.reshape(-1, self.inputs), given.shape[:-1]

    def _blocks(self, points: Float) -> Iterator[tuple[slice, list[Float], Float]]:
        """Block by block: its points, their distances to the centres along each input in widths, their bells."""
        rows = max(BLOCK // max(self.size, 1), 1)
        for first in range(0, len(points), rows):
            part = slice(first, first + rows)
            distances = [self._distances(points[part, d], d) for d in range(self.inputs)]
            exponent = np.zeros((len(points[part]), self.size))
            for distance in distances:
                exponent -= 0.5 * distance * distance
            yield part, distances, np.exp(exponent)

    def _distances(self, x: Float, d: int) -> Float:
        with np.errstate(over="ignore", invalid="ignore"):
            distance: Float = (x[:, None] - self.centres[:, d]) / self.widths[:, d]
        return np.clip(distance, -FARTHEST, FARTHEST, out=distance)

    def __eq__(self, other: object) -> bool:
        return self._content == other._content if isinstance(other, Expansion) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def _content(self) -> tuple[int, bytes, bytes]:
        numbers = np.concatenate([[self.offset], self.slopes, self.weights])
        return self.size, numbers.tobytes(), self.centres.tobytes() + self.widths.tobytes()


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
