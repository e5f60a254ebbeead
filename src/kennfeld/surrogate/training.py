"""Training of a data-driven model from datasets, as `kennfeld surrogate train` does it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import Literal

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, Findings, InputError, Location
from kennfeld.formatting import nearest
from kennfeld.lazy_dataclass import dataclass
from kennfeld.surrogate.gaussian_process import CENTRES, KernelChoice, NoiseChoice
from kennfeld.surrogate.model_selection import MIDDLE, ModelChoice, choose_regularisation, folds, select_lags
from kennfeld.surrogate.narx_training import TrainingSettings, one_step_expansion, one_step_lengths, train_over_horizons
from kennfeld.surrogate.recursion import UNLIMITED, Lags, Recording, Runs
from kennfeld.surrogate.stability import check_stability
from kennfeld.surrogate.static_training import train_static
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, Mode, StaticSurrogate, SurrogateQuality, quality_of
from kennfeld.surrogate.training_data import missing_channels, raster_of, split_recordings
from kennfeld.surrogate.validity import Validity
from kennfeld.threads import blas_threads

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
        noise: "gaussian" or "student", whose large errors count less; "auto" takes the latter if residuals of points
            left out have wide tails and become smaller but for these. Static only.
        centres: maximum number; by default one per point up to 1000 points, else 300.
        seed: of the search for length scales.
        starts: number of starts of that search.
        step: of a dynamic model in s, by default that of the recordings.
        lags: by input, in samples; or "auto".
        output_lags: of the output, in samples; or "auto".
        longest_lag: maximum for automatic lags, in samples.
        limits: lower and upper limit of the output.
        free_run: whether a dynamic model is trained for free run.
        moves_centres: whether that training refines centres and widths.
        hold: regularisation of that training; by default chosen on held-out blocks.
        iterations: maximum of that training.

    Raises:
        ArgumentError: a value cannot be used.

    >>> SurrogateSettings("engine", inputs=("throttle", "load"), output="n", kind="dynamic").longest_lag
    20
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    kind: Literal["static", "dynamic"] = "static"
    method: Literal["auto", "exact", "sparse", "expansion"] = "auto"
    centres: int | None = None
    seed: int = 0
    starts: int = 3
    step: float | None = None
    lags: Mapping[str, tuple[int, ...]] | Literal["auto"] = "auto"
    output_lags: tuple[int, ...] | Literal["auto"] = "auto"
    longest_lag: int = 20
    limits: tuple[float, float] = field(default=UNLIMITED)
    free_run: bool = True
    moves_centres: bool = False
    hold: float | None = None
    iterations: int = 10
    kernel: KernelChoice = "auto"
    noise: NoiseChoice = "auto"

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
        if not self.limits[0] < self.limits[1]:
            raise ArgumentError(f"limits={self.limits} of surrogate {self.name} must increase")

    def _check_choices(self) -> None:
        if self.kind not in ("static", "dynamic"):
            raise ArgumentError(f"kind={self.kind!r} of surrogate {self.name} must be static or dynamic")
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
    report: Report = lambda line: None,
    stopped: Stopped = never,
) -> StaticSurrogate | DynamicSurrogate:
    """Train a model on the datasets for training, and score it on all of them.

    Args:
        datasets: recordings for training and test; samples that are NaN or not scored are not used for training.
        settings: what to train.
        report: called with lines of text on the progress.
        stopped: asked between steps; once it returns true, the training ends at the best so far. A dynamic model is
            then perhaps not trained for free run.

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
    findings = Findings(missing_channels(datasets, (*settings.inputs, settings.output)))
    if not any(dataset.use == "training" for dataset in datasets):
        findings.error(Location(), "there is no training dataset", 'Set use = "training" for one.')
    findings.finish()
    import scipy.linalg  # noqa: F401  # its BLAS has threads of its own, which can be limited once it is there

    with blas_threads(settings.most_centres):
        if settings.kind == "dynamic":
            return _dynamic(datasets, settings, report, stopped)
        return train_static(datasets, settings, _units(datasets, settings), stopped)


def _units(datasets: Sequence[Dataset], settings: SurrogateSettings) -> tuple[str, ...]:
    units = tuple(datasets[0][name].unit for name in (*settings.inputs, settings.output))
    return units if any(units) else ()


def _dynamic(
    datasets: Sequence[Dataset], settings: SurrogateSettings, report: Report, stopped: Stopped
) -> DynamicSurrogate:
    step = raster_of(datasets, settings.step)
    pieces = [split_recordings(dataset, settings.inputs, settings.output, step) for dataset in datasets]
    training = [run for data, runs in zip(datasets, pieces, strict=True) if data.use == "training" for run in runs]
    if not training:
        message = "the training data have no piece without gaps that is long enough"
        raise InputError.of(Location(), message, "Increase max_gap, or use other files.")
    _check_changing(training, settings)
    lags = _lags(training, settings, report, stopped)
    runs = Runs.of(training, lags)
    lengths = one_step_lengths(runs, settings.most_centres, settings.limits, settings.starts, settings.seed, stopped)
    choice = _choice(training, lags, lengths, settings, report, stopped)
    start = one_step_expansion(runs, choice.lengths, settings.most_centres, settings.limits, settings.seed)
    expansion = start
    if settings.free_run and stopped():
        report("stopped before the training for free run; the model predicts one step ahead")
    elif settings.free_run:
        expansion = train_over_horizons(
            start,
            training,
            lags,
            choice.settings,
            lambda horizon, k, rmse: report(f"free run over {horizon} samples, step {k + 1}: RMSE {rmse:.4g}"),
            stopped,
        )
    surrogate = DynamicSurrogate(
        settings.name,
        settings.inputs,
        lags.inputs,
        settings.output,
        lags.output,
        step,
        expansion,
        Validity.around(runs.points, runs.points.std(0) * choice.lengths, settings.seed),
        start=float(np.mean([run.y[0] for run in training])),
        start_inputs=tuple(np.mean([run.u[0] for run in training], axis=0).tolist()),
        limits=settings.limits,
        units=_units(datasets, settings),
        stability=str(check_stability(expansion, runs, settings.limits, settings.seed)),
    )
    lines = [line for data, own in zip(datasets, pieces, strict=True) for line in _scores(surrogate, data, own)]
    return replace(surrogate, quality=tuple(lines))


def _check_changing(training: Sequence[Recording], settings: SurrogateSettings) -> None:
    table = np.concatenate([np.column_stack([run.u, run.y]) for run in training])
    findings = Findings()
    for name, column in zip((*settings.inputs, settings.output), table.T, strict=True):
        if np.ptp(column) == 0:
            remedy = "Remove it: a constant channel carries no information."
            findings.error(Location(f"channel {name}"), f"is {column[0]:g} in all training data", remedy)
    findings.finish()


def _lags(training: Sequence[Recording], settings: SurrogateSettings, report: Report, stopped: Stopped) -> Lags:
    own = None if settings.output_lags == "auto" else settings.output_lags
    of_inputs = None if settings.lags == "auto" else [settings.lags[name] for name in settings.inputs]
    if own is not None and of_inputs is not None:
        return Lags(own, tuple(of_inputs))
    return select_lags(
        training,
        len(settings.inputs),
        TrainingSettings(limits=settings.limits),
        longest=settings.longest_lag,
        output_lags=own,
        input_lags=of_inputs,
        report=report,
        stopped=stopped,
    )


def _choice(
    training: Sequence[Recording],
    lags: Lags,
    lengths: Float,
    settings: SurrogateSettings,
    report: Report,
    stopped: Stopped,
) -> ModelChoice:
    """Choose length scales and regularisation: as given, or by a search."""
    stated = TrainingSettings(
        limits=settings.limits, moves_centres=settings.moves_centres, iterations=settings.iterations
    )
    if settings.hold is not None:
        return ModelChoice(np.minimum(lengths, MIDDLE), replace(stated, hold=settings.hold), np.nan)
    divisions = folds(training, lags) if settings.free_run else []
    if not divisions:
        return ModelChoice(lengths, stated, np.nan)
    return choose_regularisation(divisions, lengths, settings.most_centres, stated, report, stopped)


def _scores(surrogate: DynamicSurrogate, dataset: Dataset, pieces: Sequence[Recording]) -> list[SurrogateQuality]:
    """Return one step ahead and in free run, from the first measured outputs of each piece on."""
    back = max(surrogate.output_lags)
    ahead, free = [], []  # (residual, target) of each piece
    for run in pieces:
        if len(run) <= back:
            continue
        predicted = surrogate.predict(run.u, run.y)
        known = np.isfinite(predicted) & run.scored
        ahead.append(((predicted - run.y)[known], run.y[known]))
        scored = run.scored & (np.arange(len(run)) >= back)
        free.append(((surrogate.simulate(run.u, run.y[:back]) - run.y)[scored], run.y[scored]))
    modes: tuple[tuple[Mode, list[tuple[Float, Float]]], ...] = (("one step", ahead), ("free run", free))
    return [
        quality_of(dataset.name, dataset.use, mode, *(np.concatenate(parts) for parts in zip(*pairs, strict=True)))
        for mode, pairs in modes
        if pairs
    ]
