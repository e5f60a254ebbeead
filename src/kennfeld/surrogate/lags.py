"""How far back a dynamic model looks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError

__all__ = ["Lags"]


@dataclass(frozen=True)
class Lags:
    """The lags, in samples, at which a model looks at its output (1 or more) and at each input (0 is the present).

    A point of the model's expansion is [the output at each lag, then each input at each of its lags].

    >>> Lags((2, 1), ((0, 1), (0,))).output, Lags((1, 2), ((0, 1), (0,))).size
    ((1, 2), 5)
    """

    output: tuple[int, ...]
    inputs: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "output", _rising("output_lags", self.output, 1))
        object.__setattr__(self, "inputs", tuple(_rising("lags", lags, 0) for lags in self.inputs))
        if not self.output:
            raise ArgumentError("output_lags=() of a dynamic model need at least one lag; without any it is static")

    @property
    def size(self) -> int:
        """How many numbers a point has."""
        return len(self.output) + sum(len(lags) for lags in self.inputs)

    @property
    def longest(self) -> int:
        """The longest of all lags."""
        return max(self.output + tuple(lag for lags in self.inputs for lag in lags))

    def of_inputs(self, u: Float, first: int) -> Float:
        """What the inputs give to the points from sample `first` on: Float[samples, inputs] -> Float[steps, ...].

        Before the recording they are held at their first sample.
        """
        held = max(self.longest - first, 0)
        padded = np.concatenate([np.repeat(u[:1], held, axis=0), u])
        begin, count = first + held, len(padded)
        columns = [padded[begin - lag : count - lag, j] for j, lags in enumerate(self.inputs) for lag in lags]
        return np.column_stack(columns) if columns else np.empty((max(count - begin, 0), 0))

    def of_outputs(self, y: Float, first: int) -> Float:
        """What measured outputs give to the points from sample `first` on: Float[samples] -> Float[steps, ...]."""
        return np.column_stack([y[first - lag : len(y) - lag] for lag in self.output])


def _rising(name: str, lags: Sequence[int], least: int) -> tuple[int, ...]:
    if any(isinstance(lag, bool) or int(lag) != lag or lag < least for lag in lags):
        raise ArgumentError(f"{name}={tuple(lags)} must be whole numbers from {least} on")
    return tuple(sorted({int(lag) for lag in lags}))
