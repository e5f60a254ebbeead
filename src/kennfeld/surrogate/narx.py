"""A dynamic data-driven model: y_k = f(past outputs, present and past inputs) on an even raster (NARX)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError
from kennfeld.expansion import Expansion
from kennfeld.surrogate.lags import Lags
from kennfeld.surrogate.quality import Quality
from kennfeld.surrogate.recursion import UNLIMITED, Run, Runs, simulate
from kennfeld.surrogate.static import check_names
from kennfeld.surrogate.validity import Validity

__all__ = ["DynamicSurrogate"]


@dataclass(frozen=True, eq=False)
class DynamicSurrogate:
    """y_k = min(max(f(x_k), lower), upper), x_k = [y_{k-l} for l of output_lags, u_{j,k-l} for each j and l of lags_j].

    `step` is in s. `start` is the output before the first sample, where none is measured; before the recording the
    inputs are what they are at its first sample, or `start_inputs` where a closed loop has none yet. `limits` hold the
    output, and with it what is fed back: a saturation that is part of the system. `units` are those of the inputs, then
    of the output. `stability` says in words what was
    checked. Raises `ArgumentError` where names, lags and expansion do not fit each other.
    """

    name: str
    inputs: tuple[str, ...]
    lags: tuple[tuple[int, ...], ...]
    output: str
    output_lags: tuple[int, ...]
    step: float
    expansion: Expansion
    validity: Validity | None = None
    quality: tuple[Quality, ...] = ()
    start: float = 0.0
    limits: tuple[float, float] = UNLIMITED
    units: tuple[str, ...] = ()
    stability: str = ""
    start_inputs: tuple[float, ...] = ()
    _looks: Lags = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_names(self.name, self.inputs, self.output, self.units)
        if len(self.lags) != len(self.inputs):
            raise ArgumentError(
                f"lags of surrogate {self.name} must be one tuple for each of {len(self.inputs)} inputs"
            )
        looks = Lags(self.output_lags, self.lags)
        if looks.size != self.expansion.inputs:
            raise ArgumentError(
                f"lags of surrogate {self.name} give {looks.size} numbers, its expansion has {self.expansion.inputs}"
            )
        if (looks.output, looks.inputs) != (tuple(self.output_lags), tuple(map(tuple, self.lags))):
            raise ArgumentError(f"the lags of surrogate {self.name} must rise, each once")
        object.__setattr__(self, "start_inputs", tuple(self.start_inputs) or (0.0,) * len(self.inputs))
        if len(self.start_inputs) != len(self.inputs):
            raise ArgumentError(f"start_inputs={self.start_inputs} of surrogate {self.name} must be one an input")
        if not 0 < self.step < np.inf:
            raise ArgumentError(f"step={self.step} of surrogate {self.name} must be a number of seconds above 0")
        if not self.limits[0] < self.limits[1]:
            raise ArgumentError(f"limits={self.limits} of surrogate {self.name} must be a lower and a higher number")
        if not np.isfinite(self.start):
            raise ArgumentError(f"start={self.start} of surrogate {self.name} must be a finite number")
        object.__setattr__(self, "_looks", looks)

    @property
    def longest(self) -> int:
        """The longest of all lags, in samples."""
        return self._looks.longest

    def simulate(self, u: Float, y0: Float | Sequence[float] | None = None) -> Float:
        """Free run over inputs Float[samples, inputs]: the output Float[samples].

        `y0` are the first measured outputs, which are given back as they are; the run begins after them. Fewer than the
        longest output lag are held back in time; without any the run begins at sample 0 from `start`.
        """
        given = self._inputs(u)
        first = np.zeros(0) if y0 is None else np.asarray(y0, dtype=np.float64).reshape(-1)[: len(given)]
        if not np.isfinite(first).all():
            raise ArgumentError(f"y0 of surrogate {self.name} has values that are not finite")
        return np.concatenate([first, self._run(given, first)])

    def predict(self, u: Float, y: Float) -> Float:
        """One step ahead from measured outputs: u Float[samples, inputs], y Float[samples] -> Float[samples].

        The samples that look back to before the recording are NaN.
        """
        given, back = self._inputs(u), self._looks.longest
        predicted = np.full(len(given), np.nan)
        if len(given) > back:
            predicted[back:] = np.clip(self.expansion(self.points(given, y)[back:]), *self.limits)
        return predicted

    def points(self, u: Float, y: Float) -> Float:
        """The points x_k along a recording or a run: Float[samples, numbers]; held back in time before it."""
        back = max(self.output_lags)
        padded = np.concatenate([np.full(back, y[0]), y])
        return np.column_stack([self._looks.of_outputs(padded, back), self._looks.of_inputs(self._inputs(u), 0)])

    def outside(self, u: Float, y: Float) -> Bool:
        """Bool[samples]: where a recording or a run leaves the range of the training data."""
        if self.validity is None:
            return np.zeros(len(y), dtype=bool)
        return self.validity.outside(self.points(u, y))

    def _inputs(self, u: Float) -> Float:
        given = np.asarray(u, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.inputs) or not len(given):
            raise ArgumentError(f"u of shape {given.shape} must be [samples, {len(self.inputs)}], an input a column")
        return given

    def _run(self, u: Float, y0: Float) -> Float:
        back = max(self.output_lags)
        known = np.concatenate([np.full(back, y0[0] if y0.size else self.start), y0])
        padded = np.concatenate([np.repeat(u[:1], back, axis=0), u])
        if known.size == len(padded):
            return np.zeros(0)
        run = Run(padded, np.concatenate([known, np.zeros(len(padded) - known.size)]))
        return simulate(self.expansion, Runs.of([run], self._looks, known.size), self.limits).y[:, 0]
