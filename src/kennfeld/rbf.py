"""A model of radial basis functions as a parameter: what data teach, and what may replace a large map."""

from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from kennfeld.arrays import ArrayLike, Float
from kennfeld.errors import ArgumentError
from kennfeld.expansion import Expansion
from kennfeld.parameters import Axis, Parameter

__all__ = ["RBF", "Parts", "parts"]

NARROWEST = 0.05  # of a width at the start: how narrow a calibration may make it where no bound says otherwise


class Parts(NamedTuple):
    """Where the numbers of an expansion lie among the values of a parameter."""

    offset: slice
    slopes: slice  # [inputs]
    weights: slice  # [centres]
    centres: slice  # [inputs, centres]
    widths: slice  # [inputs, centres]


def parts(inputs: int, size: int) -> Parts:
    """The parts of an expansion with so many inputs and centres, one after the other.

    >>> parts(2, 10).widths
    slice(33, 53, None)
    """
    ends = np.cumsum([0, 1, inputs, size, inputs * size, inputs * size]).tolist()
    return Parts(*(slice(a, b) for a, b in pairwise(ends)))


@dataclass(frozen=True, eq=False, kw_only=True, init=False)
class RBF(Parameter):
    """An `Expansion` whose numbers are values like those of a map: offset, slopes, weights, centres and widths.

    A formula calls it like a table, `y = Model(a, b)`. `values` holds the numbers in the order of `Parts`.

    >>> bell = RBF("Bell", Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]]), inputs=["Speed"])
    >>> bell.values, bell.coordinates
    (array([1. , 0. , 2. , 3. , 0.5]), 1)
    """

    kind: ClassVar[str] = "rbf"

    inputs: tuple[str, ...] = ()

    def __init__(self, name: str, expansion: Expansion, inputs: ArrayLike = (), **attributes: Any) -> None:
        labels = tuple(map(str, np.atleast_1d(np.asarray(inputs)))) or ("",) * expansion.inputs
        if len(labels) != expansion.inputs:
            raise ArgumentError(f"{name} has {expansion.inputs} inputs, not the {len(labels)} of inputs={list(labels)}")
        object.__setattr__(self, "inputs", labels)
        tables = (expansion.centres.T.ravel(), expansion.widths.T.ravel())
        values = np.concatenate([[expansion.offset], expansion.slopes, expansion.weights, *tables])
        super().__init__(name=name, values=values, **attributes)

    def __post_init__(self) -> None:
        super().__post_init__()
        widths = parts(self.coordinates, self.centres).widths
        lower = self.lower.copy()
        lower[widths] = np.where(lower[widths] > 0, lower[widths], NARROWEST * self.values[widths])
        lower.setflags(write=False)
        object.__setattr__(self, "lower", lower)

    def _expected_shape(self, values: Float) -> tuple[int, ...]:
        inputs = self.coordinates
        count, rest = divmod(values.size - 1 - inputs, 1 + 2 * inputs)
        if values.ndim != 1 or rest or count < 0:
            raise ArgumentError(f"{self.name} has values of shape {values.shape}, which fit no {inputs} inputs")
        return values.shape

    @property
    def centres(self) -> int:
        """How many centres it has."""
        return (self.values.size - 1 - self.coordinates) // (1 + 2 * self.coordinates)

    @property
    def coordinates(self) -> int:
        return len(self.inputs)

    @property
    def index_axes(self) -> tuple[Axis, ...]:
        return (Axis(np.arange(self.size)),)

    @property
    def expansion(self) -> Expansion:
        """The function that its values make."""
        at = parts(self.coordinates, self.centres)
        tables = (self.values[part].reshape(self.coordinates, self.centres).T for part in (at.centres, at.widths))
        return Expansion(float(self.values[0]), self.values[at.slopes], self.values[at.weights], *tables)

    @property
    def packed(self) -> Float:
        packed = self.values.copy()
        widths = parts(self.coordinates, self.centres).widths
        packed[widths] = 1 / packed[widths]
        return packed

    def value_name(self, number: int) -> str:
        """What a value is, counted from 1: `width 2 in Speed`.

        >>> bell = RBF("Bell", Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]]), inputs=["Speed"])
        >>> [bell.value_name(i) for i in range(bell.size)]
        ['offset', 'slope in Speed', 'weight 1', 'centre 1 in Speed', 'width 1 in Speed']
        """
        at = parts(self.coordinates, self.centres)
        labels = [name or f"input {d + 1}" for d, name in enumerate(self.inputs)]
        if number < at.slopes.start:
            return "offset"
        if number < at.slopes.stop:
            return f"slope in {labels[number - at.slopes.start]}"
        if number < at.weights.stop:
            return f"weight {number - at.weights.start + 1}"
        part = "centre" if number < at.centres.stop else "width"
        which, centre = divmod(number - (at.centres if part == "centre" else at.widths).start, self.centres)
        return f"{part} {centre + 1} in {labels[which]}"

    def changed(self, **changes: Any) -> Self:
        made = object.__new__(type(self))
        object.__setattr__(made, "inputs", changes.pop("inputs", self.inputs))
        Parameter.__init__(made, **({f.name: getattr(self, f.name) for f in fields(Parameter)} | changes))
        return made

    def value_slopes(self, x: Float) -> Float:
        """Derivatives with respect to its own values: Float[samples, inputs] -> Float[samples, values]."""
        e = self.expansion
        distance = (x[:, :, None] - e.centres.T) / e.widths.T  # [samples, inputs, centres]
        bells = np.exp(-0.5 * np.sum(distance * distance, axis=1))
        along = (e.weights * bells)[:, None, :] * distance / e.widths.T
        flat = (array.reshape(len(x), -1) for array in (along, along * distance))
        return np.hstack([np.ones((len(x), 1)), x, bells, *flat])
