"""Data-driven models with their validity range and quality.

A static model is y = f(inputs). A dynamic one is y_k = f(past outputs, present and past inputs) with a fixed step (a
nonlinear autoregressive model with exogenous inputs, NARX). In both, f is an `Expansion`.
"""

from collections.abc import Sequence
from dataclasses import field
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Use
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty, LinearisedRun
from kennfeld.surrogate.recursion import UNLIMITED, Lags, Recording, Runs, simulate
from kennfeld.surrogate.uncertainty import Deviation, Uncertainty
from kennfeld.surrogate.validity import Validity

Mode = Literal[
    "static", "leave one out", "blocks left out", "plane left out", "one step", "free run", "plane", "ARX"
]  # planes and ARX are linear baselines


@dataclass(frozen=True)
class SurrogateQuality:
    """Residuals over one dataset, in the unit of the output."""

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
            f"{f'R2 {self.r2:.4f}' if np.isfinite(self.r2) else 'R2 undefined, the target is constant'}, "
            f"maximum {self.max_abs:.4g} over {self.samples} samples"
        )


def quality_of(dataset: str, use: Use, mode: Mode, residual: Float, target: Float) -> SurrogateQuality:
    """Score residuals against targets, each Float[samples]; R2 is NaN if the target is constant."""
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

    Attributes:
        name: its name in formula text.
        inputs: channels.
        output: the channel that it was trained on.
        units: those of the inputs, then of the output; empty if none are known.
        expansion: f, a function of the inputs in their units.
        validity: the range of the training data; None if it is unknown.
        quality: errors on the data of the training, and those of the plane of least squares.
        uncertainty: that of a prediction; None if it is unknown.
        remarks: sentences on the training, such as samples that were not used.

    Raises:
        ArgumentError: the number of names does not match the expansion, or the uncertainty does not.

    >>> plane = Expansion(1.0, [0.5], [], np.zeros((0, 1)), np.zeros((0, 1)))
    >>> StaticSurrogate("half", ("Speed",), "y", ("rpm", "-"), plane)(np.array([[4.0]]))
    array([3.])
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    units: tuple[str, ...]
    expansion: Expansion
    validity: Validity | None = None
    quality: tuple[SurrogateQuality, ...] = ()
    uncertainty: Uncertainty | None = None
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_names(self.name, self.inputs, self.output, self.units)
        if self.uncertainty is not None:
            self.uncertainty.check(self.expansion)
        if self.expansion.inputs != len(self.inputs):
            raise ArgumentError(
                f"surrogate {self.name} has {len(self.inputs)} inputs, its expansion {self.expansion.inputs}"
            )

    def __call__(self, x: Float) -> Float:
        """Return the output at points Float[..., inputs]."""
        return self.expansion(x)

    def deviation(self, x: Float) -> Float:
        """Return the standard deviation of a new measurement from the output: Float[..., inputs] -> Float[...].

        About 95 % of measurements are within two deviations. It is NaN if it is unknown.

        Args:
            x: points, in the units of the inputs.
        """
        if self.uncertainty is None:
            return np.full(np.shape(x)[:-1], np.nan)
        return Deviation(self.expansion, self.uncertainty)(x)

    def outside(self, x: Float) -> Bool:
        """Return whether points Float[..., inputs] are too far from the training data; never without a range."""
        return np.zeros(np.shape(x)[:-1], dtype=bool) if self.validity is None else self.validity.outside(x)


def check_names(name: str, inputs: tuple[str, ...], output: str, units: tuple[str, ...]) -> None:
    """Check the name, the output and the inputs of a surrogate."""
    if not inputs:
        raise ArgumentError(f"inputs=() of surrogate {name}: it needs at least one")
    duplicates = [channel for i, channel in enumerate(inputs) if channel in inputs[:i]]
    if duplicates:
        raise ArgumentError(f"surrogate {name} has input {duplicates[0]} twice")
    if output in inputs:
        raise ArgumentError(f"output={output!r} of surrogate {name} is one of its inputs")
    if units and len(units) != len(inputs) + 1:
        raise ArgumentError(f"units={units} of surrogate {name} must be one per input and one for the output, or none")


@dataclass(frozen=True, eq=False)
class DynamicSurrogate:
    """y_k = min(max(f(x_k), lower), upper), x_k = [y_{k-l} for l of output_lags, u_{j,k-l} for each j and l of lags_j].

    Attributes:
        name: its name in formula text.
        inputs: channels.
        lags: of each input, in samples; 0 is the present one.
        output: the channel that it was trained on.
        output_lags: of the output, in samples.
        step: time step in s.
        expansion: f, a function of the past outputs, then of the inputs with their lags.
        validity: the range of the training data; None if it is unknown.
        quality: errors on the data of the training.
        start: the output before the first sample if none is measured.
        limits: bounds of the output, and with it of what is fed back: a saturation that is part of the system.
        units: those of the inputs, then of the output; empty if none are known.
        stability: the text of the stability check.
        start_inputs: values of the inputs before the recording if a closed loop has none yet; otherwise those of its
            first sample are used.
        remarks: sentences on the training, such as limits that were recognised.
        uncertainty: that of a free run; None if it is unknown.

    Raises:
        ArgumentError: names, lags and expansion do not match, or the uncertainty does not.

    >>> half = Expansion(0.0, [0.5, 0.5], [], np.zeros((0, 2)), np.zeros((0, 2)))
    >>> lag = DynamicSurrogate("lag", ("u",), ((1,),), "y", (1,), 0.1, half)
    >>> lag.simulate(np.ones((4, 1)))
    array([0.5   , 0.75  , 0.875 , 0.9375])
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
    remarks: tuple[str, ...] = ()
    uncertainty: FreeRunUncertainty | None = None
    _lags: Lags = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_names(self.name, self.inputs, self.output, self.units)
        if len(self.lags) != len(self.inputs):
            raise ArgumentError(
                f"lags of surrogate {self.name} must be one tuple for each of {len(self.inputs)} inputs"
            )
        if self.expansion.kernel != "gaussian":
            raise ArgumentError(f"kernel={self.expansion.kernel!r} of dynamic surrogate {self.name} must be gaussian")
        if self.expansion.hinges:
            raise ArgumentError(f"the expansion of dynamic surrogate {self.name} has hinges; only a static one may")
        lags = Lags(self.output_lags, self.lags)
        if lags.size != self.expansion.inputs:
            raise ArgumentError(
                f"lags of surrogate {self.name} give {lags.size} inputs, its expansion has {self.expansion.inputs}"
            )
        if (lags.output, lags.inputs) != (tuple(self.output_lags), tuple(map(tuple, self.lags))):
            raise ArgumentError(f"lags of surrogate {self.name} must increase strictly")
        object.__setattr__(self, "start_inputs", tuple(self.start_inputs) or (0.0,) * len(self.inputs))
        if len(self.start_inputs) != len(self.inputs):
            raise ArgumentError(f"start_inputs={self.start_inputs} of surrogate {self.name} must be one per input")
        if self.uncertainty is not None:
            self.uncertainty.check(self.expansion)
        if not 0 < self.step < np.inf:
            raise ArgumentError(f"step={self.step} of surrogate {self.name} must be a time in s > 0")
        if not self.limits[0] < self.limits[1]:
            raise ArgumentError(f"limits={self.limits} of surrogate {self.name} must increase")
        if not np.isfinite(self.start):
            raise ArgumentError(f"start={self.start} of surrogate {self.name} must be a finite number")
        object.__setattr__(self, "_lags", lags)

    @property
    def longest(self) -> int:
        """The longest of all lags, in samples."""
        return self._lags.longest

    def simulate(self, u: Float, y0: Float | Sequence[float] | None = None) -> Float:
        """Return the free run, Float[samples], over inputs Float[samples, inputs].

        The run begins after the measured outputs `y0`, Float[count], which are returned unchanged. If they are fewer
        than the longest output lag, the first one is extended back in time; without any the run begins at sample 0
        from `start`.
        """
        inputs = self._inputs(u)
        first = self._measured(y0, len(inputs))
        runs = self._runs(inputs, first)
        if runs is None:
            return first.copy()
        return np.concatenate([first, simulate(self.expansion, runs, self.limits).y[:, 0]])

    def deviation(self, u: Float, y0: Float | Sequence[float] | None = None) -> Float:
        """Return the standard deviation of new measurements from the free run, Float[samples].

        About 95 % of measurements are within two deviations of `simulate(u, y0)`. The deviation grows from that of the
        first free sample on, since errors are fed back; it is 0 at the measured outputs, and NaN if it is unknown.
        Outputs before the recording that are not measured have a deviation, too.

        Args:
            u: inputs, Float[samples, inputs], in their units.
            y0: the measured outputs after which the run begins, as in `simulate`.
        """
        inputs = self._inputs(u)
        first = self._measured(y0, len(inputs))
        runs = self._runs(inputs, first)
        if runs is None or self.uncertainty is None:
            return np.full(len(inputs), np.nan if self.uncertainty is None else 0.0)
        points = runs.visited(simulate(self.expansion, runs, self.limits).y)
        back = max(self.output_lags)
        # by sample number, oldest first: those before sample 0 were extended, not measured
        unmeasured = np.arange(first.size - back, first.size)[:, None] < 0
        deviation = self._linearised(points).deviation(self.uncertainty, unmeasured)
        return np.concatenate([np.zeros(first.size), deviation[:, 0]])

    def deviation_along(self, points: Float, *, measured: bool = True, repeats: int = 1) -> Float:
        """Return the same along points of free runs side by side: Float[steps, runs, numbers] -> Float[steps, runs].

        `measured` states whether the outputs before the first step are. Each point counts as so many steps.
        """
        if self.uncertainty is None:
            return np.full(points.shape[:-1], np.nan)
        unmeasured = np.full((max(self.output_lags), points.shape[1]), not measured)
        return self._linearised(points).repeated(repeats).deviation(self.uncertainty, unmeasured)

    def _linearised(self, points: Float) -> LinearisedRun:
        shares = self.uncertainty is not None and self.uncertainty.signal > 0
        return LinearisedRun.along(self.expansion, points, self.output_lags, self.limits, shares=shares)

    def _measured(self, y0: Float | Sequence[float] | None, most: int) -> Float:
        first = np.zeros(0) if y0 is None else np.asarray(y0, dtype=np.float64).reshape(-1)[:most]
        if not np.isfinite(first).all():
            raise ArgumentError(f"y0 of surrogate {self.name} has values that are not finite")
        return first

    def _runs(self, inputs: Float, first: Float) -> Runs | None:
        """Return the free run after measured outputs; None if there is nothing to run."""
        back = max(self.output_lags)
        # `back` outputs and inputs are put before the recording, so that a run may begin at its sample 0
        known = np.concatenate([np.full(back, first[0] if first.size else self.start), first])
        padded = np.concatenate([np.repeat(inputs[:1], back, axis=0), inputs])
        if known.size == len(padded):
            return None
        # the zeros are never read: the run begins after the known outputs
        recording = Recording(padded, np.concatenate([known, np.zeros(len(padded) - known.size)]))
        return Runs.of([recording], self._lags, known.size)

    def predict(self, u: Float, y: Float) -> Float:
        """Return one step ahead from measured outputs: u Float[samples, inputs], y Float[samples] -> Float[samples].

        The samples that look back to before the recording are NaN.
        """
        inputs, back = self._inputs(u), self.longest
        predicted = np.full(len(inputs), np.nan)
        if len(inputs) > back:
            predicted[back:] = np.clip(self.expansion(self.points(inputs, y)[back:]), *self.limits)
        return predicted

    def points(self, u: Float, y: Float) -> Float:
        """Return the points x_k along a recording or a run: Float[samples, numbers]; held back in time before it."""
        back = max(self.output_lags)
        padded = np.concatenate([np.full(back, y[0]), y])
        return np.column_stack([self._lags.of_outputs(padded, back), self._lags.of_inputs(self._inputs(u), 0)])

    def outside(self, u: Float, y: Float) -> Bool:
        """Return the samples at which a recording or a run leaves the range of the training data, Bool[samples]."""
        if self.validity is None:
            return np.zeros(len(y), dtype=bool)
        return self.validity.outside(self.points(u, y))

    def _inputs(self, u: Float) -> Float:
        inputs = np.asarray(u, dtype=np.float64)
        if inputs.ndim != 2 or inputs.shape[1] != len(self.inputs) or not len(inputs):
            raise ArgumentError(
                f"u of shape {inputs.shape} must be [samples, {len(self.inputs)}], one column per input"
            )
        return inputs
