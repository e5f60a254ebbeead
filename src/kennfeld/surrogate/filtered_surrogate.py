"""Dynamic models without feedback: a static function of inputs and of the same inputs through first-order filters."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.input_filters import filtered_points
from kennfeld.surrogate.recursion import UNLIMITED
from kennfeld.surrogate.surrogate_models import SurrogateQuality, check_names
from kennfeld.surrogate.uncertainty import Deviation, Uncertainty
from kennfeld.surrogate.validity import Validity

STABILITY = "The output does not feed back: it stays bounded for bounded inputs."


@dataclass(frozen=True, eq=False)
class FilteredSurrogate:
    """y_k = min(max(f(x_k), lower), upper), x_k = [u_{k-d}, then u_{k-d} filtered by each time constant].

    A filter with the time constant T is x_k = x_{k-1} + (1 - exp(-step / T)) (u_{k-d} - x_{k-1}) and begins at the
    first u. Without feedback, errors do not accumulate: any run is bounded.

    Attributes:
        name: its name in formula text.
        inputs: channels.
        output: the channel that it was trained on.
        step: time step in s.
        time_constants: of the filters, in s, each applied to all inputs.
        expansion: f, a function of the inputs, then of the inputs filtered by each time constant.
        delay: of all inputs, d, in samples.
        validity: the range of the training data; None if it is unknown.
        quality: errors on the data of the training.
        limits: bounds of the output.
        units: those of the inputs, then of the output; empty if none are known.
        start_inputs: values of the inputs before the recording if a closed loop has none yet; otherwise those of its
            first sample are used.
        remarks: sentences on the training, such as limits that were recognised.
        uncertainty: that of the output; None if it is unknown.

    Raises:
        ArgumentError: names, time constants and expansion do not match, or the uncertainty does not.

    >>> slow = Expansion(0.0, [0.0, 1.0], [], np.zeros((0, 2)), np.zeros((0, 2)))
    >>> model = FilteredSurrogate("slow", ("u",), "y", 0.1, (1.0,), slow)
    >>> model.simulate(np.array([[0.0], [1.0], [1.0]])).round(4)
    array([0.    , 0.0952, 0.1813])
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    step: float
    time_constants: tuple[float, ...]
    expansion: Expansion
    delay: int = 0
    validity: Validity | None = None
    quality: tuple[SurrogateQuality, ...] = ()
    limits: tuple[float, float] = UNLIMITED
    units: tuple[str, ...] = ()
    start_inputs: tuple[float, ...] = ()
    remarks: tuple[str, ...] = ()
    uncertainty: Uncertainty | None = None

    def __post_init__(self) -> None:
        check_names(self.name, self.inputs, self.output, self.units)
        numbers = len(self.inputs) * (1 + len(self.time_constants))
        if self.expansion.inputs != numbers:
            raise ArgumentError(
                f"surrogate {self.name} has {numbers} inputs and filtered inputs, its expansion {self.expansion.inputs}"
            )
        if not all(0 < T < np.inf for T in self.time_constants):
            raise ArgumentError(f"time_constants={self.time_constants} of surrogate {self.name} must be times in s > 0")
        if isinstance(self.delay, bool) or int(self.delay) != self.delay or self.delay < 0:
            raise ArgumentError(f"delay={self.delay} of surrogate {self.name} must be an integer >= 0, in samples")
        object.__setattr__(self, "start_inputs", tuple(self.start_inputs) or (0.0,) * len(self.inputs))
        if len(self.start_inputs) != len(self.inputs):
            raise ArgumentError(f"start_inputs={self.start_inputs} of surrogate {self.name} must be one per input")
        if self.uncertainty is not None:
            self.uncertainty.check(self.expansion)
        if not 0 < self.step < np.inf:
            raise ArgumentError(f"step={self.step} of surrogate {self.name} must be a time in s > 0")
        if not self.limits[0] < self.limits[1]:
            raise ArgumentError(f"limits={self.limits} of surrogate {self.name} must increase")

    @property
    def stability(self) -> str:
        """A sentence on the stability of its free run."""
        return STABILITY

    def simulate(self, u: Float, y0: Float | Sequence[float] | None = None) -> Float:
        """Return the output, Float[samples], over inputs Float[samples, inputs]; the first ones are `y0` if given."""
        y = np.clip(self.expansion(self.points(u)), *self.limits)
        known = np.zeros(0) if y0 is None else np.asarray(y0, dtype=np.float64).reshape(-1)[: y.size]
        # without feedback, measured outputs do not change the others
        y[: known.size] = known
        return y

    def points(self, u: Float) -> Float:
        """Return the points x_k along inputs Float[samples, inputs]: Float[samples, numbers]."""
        inputs = np.asarray(u, dtype=np.float64)
        if inputs.ndim != 2 or inputs.shape[1] != len(self.inputs) or not len(inputs):
            raise ArgumentError(
                f"u of shape {inputs.shape} must be [samples, {len(self.inputs)}], one column per input"
            )
        return filtered_points(inputs, self.delay, self.step, self.time_constants)

    def outside(self, u: Float) -> Bool:
        """Return the samples at which inputs leave the range of the training data, Bool[samples]."""
        if self.validity is None:
            return np.zeros(len(u), dtype=bool)
        return self.validity.outside(self.points(u))

    def deviation(self, u: Float, y0: Float | Sequence[float] | None = None) -> Float:
        """Return the standard deviation of new measurements from the output, Float[samples]; NaN if it is unknown.

        About 95 % of measurements are within two deviations of `simulate(u, y0)`. It is 0 at the measured outputs.

        Args:
            u: inputs, Float[samples, inputs], in their units.
            y0: the measured outputs of the first samples, as in `simulate`.
        """
        deviation = self.deviation_at(self.points(u))
        if y0 is not None and self.uncertainty is not None:
            deviation[: np.size(y0)] = 0.0
        return deviation

    def deviation_at(self, points: Float) -> Float:
        """Return the same at points Float[..., numbers] of inputs and filtered inputs."""
        if self.uncertainty is None:
            return np.full(np.shape(points)[:-1], np.nan)
        return Deviation(self.expansion, self.uncertainty)(points)
