"""Training of a data-driven model from datasets, as `kennfeld surrogate train` does it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY
from typing import Literal

import numpy as np

from kennfeld.base.errors import ArgumentError, Findings, Location, renamed
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.domain.dataset import Dataset
from kennfeld.surrogate.dynamic_training import train_dynamic
from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
from kennfeld.surrogate.gaussian_process import CENTRES, KernelChoice, NoiseChoice
from kennfeld.surrogate.static_training import train_static
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, StaticSurrogate
from kennfeld.surrogate.training_data import missing_channels

Report = Callable[[str], None]


@dataclass(frozen=True)
class SurrogateSettings:
    """Settings of a training; the keys of a training file.

    Attributes:
        name: the surrogate's name in formula text.
        inputs: channels.
        output: the channel to reproduce.
        kind: "static" for points, "dynamic" for recordings over time.
        method: "auto", "exact" or "sparse" (Gaussian processes), or "expansion": few centres by k-means, static only.
        kernel: "gaussian" or "matern52"; by "auto" the one with the smaller residuals of points left out. Static only.
        noise: "gaussian" or "student", whose large errors count less; "auto" takes the latter for
            points without time if it is clearly more likely for residuals of points left out. Static only.
        kinks: whether the mean of a static Gaussian process may be kinked along single inputs, if residuals of points
            left out become smaller by more than chance.
        centres: maximum number; by default one per point up to 1000 points, else 300.
        seed: of the search for length scales.
        starts: number of starts of that search.
        step: of a dynamic model in s, by default that of the recordings.
        lags: by input, in samples; or "auto".
        output_lags: of the output, in samples; or "auto".
        longest_lag: maximum for automatic lags, in samples.
        limits: lower and upper limit of the output; "auto" recognises where the training output stays at its minimum
            or maximum.
        free_run: whether a dynamic model is trained for free run.
        moves_centres: whether that training refines centres and widths.
        hold: regularisation of that training; by default chosen on held-out blocks.
        iterations: maximum of that training.
        structure: of a dynamic model: "narx" feeds past outputs back, "filtered" is a static function of inputs and of
            filtered inputs; "auto" takes the one with the smallest error on held-out blocks, or "narx" if `lags`,
            `output_lags` or `hold` are given.
        held: input channels that are held between samples, not interpolated, on the raster of a dynamic model.

    Raises:
        ArgumentError: a value cannot be used.

    >>> SurrogateSettings("engine", inputs=("throttle", "load"), output="n", kind="dynamic").longest_lag
    20
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    kind: Literal["static", "dynamic"] = "static"
    _: KW_ONLY
    method: Literal["auto", "exact", "sparse", "expansion"] = "auto"
    centres: int | None = None
    seed: int = 0
    starts: int = 3
    step: float | None = None
    lags: Mapping[str, tuple[int, ...]] | Literal["auto"] = "auto"
    output_lags: tuple[int, ...] | Literal["auto"] = "auto"
    longest_lag: int = 20
    limits: tuple[float, float] | Literal["auto"] = "auto"
    free_run: bool = True
    moves_centres: bool = False
    hold: float | None = None
    iterations: int = 10
    kernel: KernelChoice = "auto"
    noise: NoiseChoice = "auto"
    held: tuple[str, ...] = ()
    structure: Literal["auto", "narx", "filtered"] = "auto"
    kinks: bool = True

    @property
    def most_centres(self) -> int:
        """The maximum number of centres of a model that has fewer than points."""
        return CENTRES if self.centres is None else self.centres

    def __post_init__(self) -> None:
        self._check_choices()
        for name in ("centres", "starts", "longest_lag", "iterations"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ArgumentError(f"{name}={value} of surrogate {self.name} must be >= 1")
        if not self.inputs or self.output in self.inputs:
            raise ArgumentError(f"inputs={self.inputs} of surrogate {self.name} must be channels other than the output")
        if self.step is not None and not 0 < self.step < np.inf:
            raise ArgumentError(f"step={self.step} of surrogate {self.name} must be a time in s > 0")
        if self.hold is not None and not 0 <= self.hold < np.inf:
            raise ArgumentError(f"hold={self.hold} of surrogate {self.name} must be >= 0")
        if self.limits != "auto" and not self.limits[0] < self.limits[1]:
            raise ArgumentError(f"limits={self.limits} of surrogate {self.name} must increase")
        for name in self.held:
            if name not in self.inputs:
                message = f"held={self.held} of surrogate {self.name}: {name} is not an input"
                raise ArgumentError(f"{message}. {nearest(name, self.inputs)}".strip())

    @property
    def selects_all(self) -> bool:
        """True if lags and regularisation are selected, for free run."""
        return self.free_run and self.lags == "auto" and self.output_lags == "auto" and self.hold is None

    def _check_choices(self) -> None:
        if self.kind not in ("static", "dynamic"):
            raise ArgumentError(f"kind={self.kind!r} of surrogate {self.name} must be static or dynamic")
        if self.structure not in ("auto", "narx", "filtered"):
            message = f"structure={self.structure!r} of surrogate {self.name} must be auto, narx or filtered"
            raise ArgumentError(message)
        known = ("auto", "exact", "sparse", "expansion") if self.kind == "static" else ("auto", "sparse")
        if self.method not in known:
            raise ArgumentError(
                f"method={self.method!r} of {self.kind} surrogate {self.name} must be {' or '.join(known)}"
            )
        kernels = ("auto", "gaussian", "matern52") if self.kind == "static" else ("auto", "gaussian")
        if self.kernel not in kernels:
            message = f"kernel={self.kernel!r} of {self.kind} surrogate {self.name} must be {' or '.join(kernels)}"
            raise ArgumentError(message)
        noises = ("auto", "gaussian", "student") if self.kind == "static" else ("auto", "gaussian")
        if self.noise not in noises:
            raise ArgumentError(
                f"noise={self.noise!r} of {self.kind} surrogate {self.name} must be {' or '.join(noises)}"
            )
        if self.method == "expansion" and (self.kernel == "matern52" or self.noise == "student"):
            key, value = ("kernel", self.kernel) if self.kernel == "matern52" else ("noise", self.noise)
            raise ArgumentError(f"{key}={value!r} of surrogate {self.name} is not possible with method='expansion'")
        for name in self.lags if self.lags != "auto" else ():
            if name not in self.inputs:
                message = f"lags of {name!r}, which is not an input of {self.name}. {nearest(name, self.inputs)}"
                raise ArgumentError(message.strip())
        missing = [name for name in self.inputs if self.lags != "auto" and name not in self.lags]
        if missing:
            raise ArgumentError(
                f"lags of input {missing[0]!r} of surrogate {self.name} are missing; 0 is the present sample"
            )


def train_surrogate(
    datasets: Sequence[Dataset],
    settings: SurrogateSettings,
    progress: Report = lambda line: None,
    stopped: Stopped = never,
    *,
    report: Report | None = None,
) -> StaticSurrogate | DynamicSurrogate | FilteredSurrogate:
    """Train a model on the datasets for training, and score it on all of them.

    Args:
        datasets: recordings for training and test; samples that are NaN or not scored are not used for training.
        settings: what to train.
        progress: called with lines of text.
        stopped: asked between steps; once it returns true, the training ends at the best so far. A dynamic model is
            then perhaps not trained for free run.
        report: former name of `progress`.

    Returns:
        The surrogate, with its range of validity and its errors.

    Raises:
        InputError: channels are missing (reports all of them), or there are too few samples.
        ArgumentError: the data cannot be used for training, such as a constant input.

    >>> x = np.linspace(0.0, 3.0, 40)
    >>> data = Dataset.of("bench", {"x": x, "y": np.sin(x)})
    >>> sine = train_surrogate([data], SurrogateSettings("sine", inputs=("x",), output="y"))
    >>> bool(abs(sine(np.array([1.5])) - np.sin(1.5)) < 1e-3)
    True
    """
    progress = renamed(progress, report, "progress", "report")
    findings = Findings(missing_channels(datasets, (*settings.inputs, settings.output)))
    if not any(dataset.use == "training" for dataset in datasets):
        findings.error(Location(), "there is no training dataset", 'Set use = "training" for one.')
    findings.finish()
    import scipy.linalg  # noqa: F401  # its BLAS has threads of its own, which can be limited once it is there

    with blas_threads(settings.most_centres):
        if settings.kind == "dynamic":
            return train_dynamic(datasets, settings, _units(datasets, settings), progress, stopped)
        return train_static(datasets, settings, _units(datasets, settings), stopped)


def _units(datasets: Sequence[Dataset], settings: SurrogateSettings) -> tuple[str, ...]:
    units = tuple(datasets[0][name].unit for name in (*settings.inputs, settings.output))
    return units if any(units) else ()
