"""A static data-driven model: an expansion with names, a validity range and its quality.

How well a data-driven model meets recordings.

A dynamic data-driven model: y_k = f(past outputs, present and past inputs) on an even raster (NARX).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.dataset import Use
from kennfeld.errors import ArgumentError
from kennfeld.rbf import Expansion
from kennfeld.surrogate.recursion import UNLIMITED, Lags, Recording, Runs, simulate
from kennfeld.surrogate.validity import Validity

__all__ = ["DynamicSurrogate", "Mode", "StaticSurrogate", "SurrogateQuality", "quality_of"]

Mode = Literal["static", "leave one out", "one step", "free run"]


@dataclass(frozen=True)
class SurrogateQuality:
    """One line: the residuals over one dataset, in the unit of the output."""

    dataset: str
    use: Use
    mode: Mode
    samples: int
    rmse: float
    r2: float
    max_abs: float

    def __str__(self) -> str:
        return (
            f"{self.dataset} ({self.use}), {self.mode}: RMSE {self.rmse:.4g}, "
            f"{f'R2 {self.r2:.4f}' if np.isfinite(self.r2) else 'no R2, for the target is constant'}, "
            f"maximum {self.max_abs:.4g} over {self.samples} samples"
        )


def quality_of(dataset: str, use: Use, mode: Mode, residual: Float, target: Float) -> SurrogateQuality:
    """The line for residuals Float[samples] of a measured target Float[samples]; R2 is NaN where it never changes."""
    with np.errstate(over="ignore", invalid="ignore"):
        square = float(np.sum(residual**2))
        varying = target - target[:1]  # exactly 0 if the target is constant
        spread = float(np.sum((varying - varying.mean()) ** 2)) if target.size else 0.0
        worst = float(np.max(np.abs(residual), initial=0.0))
    r2 = 1 - square / spread if spread > 0 else np.nan
    rmse = float(np.sqrt(square / target.size)) if target.size else np.nan
    return SurrogateQuality(dataset, use, mode, int(target.size), rmse, r2, worst)


@dataclass(frozen=True, eq=False)
class StaticSurrogate:
    """y = f(inputs), trained on steady-state points.

    `units` are those of the inputs, then of the output; empty where none are known.
    Raises `ArgumentError` where names and expansion do not fit each other.
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    units: tuple[str, ...]
    expansion: Expansion
    validity: Validity | None = None
    quality: tuple[SurrogateQuality, ...] = ()

    def __post_init__(self) -> None:
        check_names(self.name, self.inputs, self.output, self.units)
        if self.expansion.inputs != len(self.inputs):
            raise ArgumentError(
                f"surrogate {self.name} has {len(self.inputs)} inputs, its expansion {self.expansion.inputs}"
            )

    def __call__(self, x: Float) -> Float:
        """The output at points Float[..., inputs]."""
        return self.expansion(x)

    def outside(self, x: Float) -> Bool:
        """Whether points Float[..., inputs] are too far from the training data; none is without a validity range."""
        return np.zeros(np.shape(x)[:-1], dtype=bool) if self.validity is None else self.validity.outside(x)


def check_names(name: str, inputs: tuple[str, ...], output: str, units: tuple[str, ...]) -> None:
    """What the names of any surrogate must keep to."""
    if not inputs:
        raise ArgumentError(f"inputs=() of surrogate {name}: it needs at least one")
    twice = [given for i, given in enumerate(inputs) if given in inputs[:i]]
    if twice:
        raise ArgumentError(f"surrogate {name} has input {twice[0]} twice")
    if output in inputs:
        raise ArgumentError(f"output={output!r} of surrogate {name} is one of its inputs")
    if units and len(units) != len(inputs) + 1:
        raise ArgumentError(f"units={units} of surrogate {name} must be one an input and one of the output, or none")


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
    quality: tuple[SurrogateQuality, ...] = ()
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
        run = Recording(padded, np.concatenate([known, np.zeros(len(padded) - known.size)]))
        return simulate(self.expansion, Runs.of([run], self._looks, known.size), self.limits).y[:, 0]
