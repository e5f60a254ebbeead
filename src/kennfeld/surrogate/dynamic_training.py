"""Training of a dynamic surrogate: lags, regularisation and free run, judged beside a plane and a linear ARX model."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import Findings, InputError, Location
from kennfeld.formatting import count_noun
from kennfeld.lazy_dataclass import dataclass
from kennfeld.rbf import Expansion
from kennfeld.surrogate.baselines import LinearRecursion, arx, free_run_residual, plane
from kennfeld.surrogate.model_selection import (
    MIDDLE,
    ModelChoice,
    choose_regularisation,
    folds,
    held_out_rmse,
    lag_error,
    select_lags,
)
from kennfeld.surrogate.narx_training import TrainingSettings, one_step_expansion, one_step_lengths, train_over_horizons
from kennfeld.surrogate.recursion import UNLIMITED, Lags, Recording, Runs
from kennfeld.surrogate.saturation import find_saturation, limits_of
from kennfeld.surrogate.stability import Stability, check_stability
from kennfeld.surrogate.stopping import Stopped
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, SurrogateQuality, quality_of
from kennfeld.surrogate.training_data import raster_of, split_recordings
from kennfeld.surrogate.validity import Validity

if TYPE_CHECKING:
    from kennfeld.surrogate.training import SurrogateSettings

Report = Callable[[str], None]

CONSTANT = 0.99  # share of the samples at one value from which a channel is remarked on


@dataclass(frozen=True, eq=False)
class _Recordings:
    """The datasets on the raster of the model."""

    datasets: Sequence[Dataset]
    pieces: Sequence[Sequence[Recording]]  # of each dataset
    step: float

    @classmethod
    def of(cls, datasets: Sequence[Dataset], settings: "SurrogateSettings") -> "_Recordings":
        step = raster_of(datasets, settings.step)
        arguments = settings.inputs, settings.output, step, settings.held
        result = cls(datasets, [split_recordings(dataset, *arguments) for dataset in datasets], step)
        if not result.training:
            message = "the training data have no piece without gaps that is long enough"
            raise InputError.of(Location(), message, "Increase max_gap, or use other files.")
        return result

    @property
    def training(self) -> list[Recording]:
        """The pieces for training."""
        pairs = zip(self.datasets, self.pieces, strict=True)
        return [run for data, runs in pairs if data.use == "training" for run in runs]


def train_dynamic(
    datasets: Sequence[Dataset], settings: "SurrogateSettings", units: tuple[str, ...], report: Report, stopped: Stopped
) -> DynamicSurrogate:
    """Train a dynamic surrogate on the datasets for training and score it on all, see `train_surrogate`."""
    recordings = _Recordings.of(datasets, settings)
    training = recordings.training
    _check_changing(training, settings)
    remarks = list(_nearly_constant(training, settings))
    limits, lags = _limits_and_lags(training, settings, report, stopped, remarks)
    linear = arx(training, limits, [lags])
    model = _choose(training, lags, limits, linear, settings, report, stopped)
    if model is None:
        remarks.append("a linear ARX model has the smallest error on held-out blocks, and is used")
        lags, expansion, lengths = linear.lags, linear.expansion, np.full(linear.lags.size, MIDDLE)
    else:
        expansion, lengths = model
    runs = Runs.of(training, lags)
    limits, stability = _bounded(expansion, runs, limits, settings, remarks)
    surrogate = DynamicSurrogate(
        settings.name,
        settings.inputs,
        lags.inputs,
        settings.output,
        lags.output,
        recordings.step,
        expansion,
        Validity.around(runs.points, runs.points.std(0) * lengths, settings.seed),
        start=float(np.mean([run.y[0] for run in training])),
        start_inputs=tuple(np.mean([run.u[0] for run in training], axis=0).tolist()),
        limits=limits,
        units=units,
        stability=str(stability),
    )
    quality = [*_scores(surrogate, recordings), *_baselines(recordings, linear, limits)]
    remarks += _lost(quality)
    for remark in remarks:
        report(f"Remark: {remark}")
    return replace(surrogate, quality=tuple(quality), remarks=tuple(remarks))


def _check_changing(training: Sequence[Recording], settings: "SurrogateSettings") -> None:
    table = np.concatenate([np.column_stack([run.u, run.y]) for run in training])
    findings = Findings()
    for name, column in zip((*settings.inputs, settings.output), table.T, strict=True):
        if np.ptp(column) == 0:
            remedy = "Remove it: a constant channel carries no information."
            findings.error(Location(f"channel {name}"), f"is {column[0]:g} in all training data", remedy)
    findings.finish()


def _nearly_constant(training: Sequence[Recording], settings: "SurrogateSettings") -> Iterator[str]:
    """Yield a remark on each channel that has one value nearly everywhere."""
    table = np.concatenate([np.column_stack([run.u, run.y]) for run in training])
    for name, column in zip((*settings.inputs, settings.output), table.T, strict=True):
        levels, counts = np.unique(column, return_counts=True)
        level, count = levels[counts.argmax()], counts.max()
        if count >= CONSTANT * column.size:
            changes = count_noun(int(column.size - count), "sample")
            yield f"{name} is {level:g} except at {changes} of {column.size}; the model can hardly know its effect"


def _limits_and_lags(
    training: Sequence[Recording], settings: "SurrogateSettings", report: Report, stopped: Stopped, remarks: list[str]
) -> tuple[tuple[float, float], Lags]:
    """Return the limits and lags as given, or as selected; limits must lower the error on held-out blocks."""
    if settings.limits != "auto":
        return settings.limits, _lags(training, settings, settings.limits, report, stopped)
    ends = find_saturation([run.y for run in training])
    limits = limits_of(ends)
    lags = _lags(training, settings, limits, report, stopped)
    if not ends:
        return UNLIMITED, lags
    samples = sum(map(len, training))
    seen = " and ".join(f"{settings.output} {end} of {samples}" for end in ends)
    lower, upper = limits
    shown = f"limits = [{lower:g}, {upper:g}]"
    with_limits, without = (lag_error(training, lags, TrainingSettings(limits=each)) for each in (limits, UNLIMITED))
    if with_limits <= without:
        remarks.append(f"{seen}; {shown} are used, write limits = [-inf, inf] for none")
        return limits, lags
    remarks.append(f"{seen}; {shown} do not lower the error on held-out blocks and are not used")
    return UNLIMITED, _lags(training, settings, UNLIMITED, report, stopped)


def _bounded(
    expansion: Expansion, runs: Runs, limits: tuple[float, float], settings: "SurrogateSettings", remarks: list[str]
) -> tuple[tuple[float, float], Stability]:
    """Return limits and stability; automatic limits are set beyond the training data if free runs leave them far."""
    stability = check_stability(expansion, runs, limits, settings.seed)
    if settings.limits != "auto" or stability.bounded == stability.runs:
        return limits, stability
    target = runs.one_step_target
    low, high = float(target.min()), float(target.max())
    wide = (float(f"{2 * low - high:.4g}"), float(f"{2 * high - low:.4g}"))
    limits = (max(limits[0], wide[0]), min(limits[1], wide[1]))
    left = f"{stability.runs - stability.bounded} of {stability.runs} free runs left the range of the training data"
    remarks.append(f"{left} far behind; limits = [{limits[0]:g}, {limits[1]:g}] are set")
    return limits, check_stability(expansion, runs, limits, settings.seed)


def _lags(
    training: Sequence[Recording],
    settings: "SurrogateSettings",
    limits: tuple[float, float],
    report: Report,
    stopped: Stopped,
) -> Lags:
    own = None if settings.output_lags == "auto" else settings.output_lags
    of_inputs = None if settings.lags == "auto" else [settings.lags[name] for name in settings.inputs]
    if own is not None and of_inputs is not None:
        return Lags(own, tuple(of_inputs))
    return select_lags(
        training,
        len(settings.inputs),
        TrainingSettings(limits=limits),
        longest=settings.longest_lag,
        output_lags=own,
        input_lags=of_inputs,
        report=report,
        stopped=stopped,
    )


def _choose(
    training: Sequence[Recording],
    lags: Lags,
    limits: tuple[float, float],
    linear: LinearRecursion,
    settings: "SurrogateSettings",
    report: Report,
    stopped: Stopped,
) -> tuple[Expansion, Float] | None:
    """Return the trained function and its length scales; None if the linear model is better on held-out blocks."""
    runs = Runs.of(training, lags)
    lengths = one_step_lengths(runs, settings.centres, limits, settings.starts, settings.seed, stopped)
    choice = _regularisation(training, lags, limits, lengths, settings, report, stopped)
    if settings.selects_all and choice.rmse > (error := _linear_error(training, linear, limits)):
        report(f"linear ARX model: {error:.4g} on the blocks left out, against {choice.rmse:.4g}")
        return None
    start = one_step_expansion(runs, choice.lengths, settings.centres, limits, settings.seed)
    if not settings.free_run:
        return start, choice.lengths
    if stopped():
        report("stopped before the training for free run; the model predicts one step ahead")
        return start, choice.lengths
    expansion = train_over_horizons(
        start,
        training,
        lags,
        choice.settings,
        lambda horizon, k, rmse: report(f"free run over {horizon} samples, step {k + 1}: RMSE {rmse:.4g}"),
        stopped,
    )
    return expansion, choice.lengths


def _regularisation(
    training: Sequence[Recording],
    lags: Lags,
    limits: tuple[float, float],
    lengths: Float,
    settings: "SurrogateSettings",
    report: Report,
    stopped: Stopped,
) -> ModelChoice:
    """Choose length scales and regularisation: as given, or by a search."""
    stated = TrainingSettings(limits=limits, moves_centres=settings.moves_centres, iterations=settings.iterations)
    if settings.hold is not None:
        return ModelChoice(np.minimum(lengths, MIDDLE), replace(stated, hold=settings.hold), np.nan)
    divisions = folds(training, lags) if settings.free_run else []
    if not divisions:
        return ModelChoice(lengths, stated, np.nan)
    return choose_regularisation(divisions, lengths, settings.centres, stated, report, stopped)


def _linear_error(training: Sequence[Recording], linear: LinearRecursion, limits: tuple[float, float]) -> float:
    """Return the RMSE of ARX models with these lags on the blocks that are held out of them."""
    divisions = folds(training, linear.lags)
    fits = []
    for fold in divisions:
        target = fold.training.one_step_target
        inside = (target > limits[0]) & (target < limits[1])
        fits.append(plane(fold.training.points[inside], target[inside]))
    return held_out_rmse(divisions, fits, TrainingSettings(limits=limits, iterations=0)) if divisions else np.inf


def _scores(surrogate: DynamicSurrogate, recordings: _Recordings) -> Iterator[SurrogateQuality]:
    """Yield one step ahead and in free run, from the first measured outputs of each piece on."""
    back = max(surrogate.output_lags)
    for data, pieces in zip(recordings.datasets, recordings.pieces, strict=True):
        ahead, free = [], []  # (residual, target) of each piece
        for run in pieces:
            if len(run) <= back:
                continue
            predicted = surrogate.predict(run.u, run.y)
            known = np.isfinite(predicted) & run.scored
            ahead.append(((predicted - run.y)[known], run.y[known]))
            scored = run.scored & (np.arange(len(run)) >= back)
            free.append(((surrogate.simulate(run.u, run.y[:back]) - run.y)[scored], run.y[scored]))
        if ahead:
            yield quality_of(data.name, data.use, "one step", *_joined(ahead))
            yield quality_of(data.name, data.use, "free run", *_joined(free))


def _joined(pairs: Sequence[tuple[Float, Float]]) -> list[Float]:
    return [np.concatenate(parts) for parts in zip(*pairs, strict=True)]


def _baselines(
    recordings: _Recordings, linear: LinearRecursion, limits: tuple[float, float]
) -> Iterator[SurrogateQuality]:
    """Yield the errors of the linear model in free run, and of a plane over the present inputs."""
    training = recordings.training
    flat = plane(
        *(
            np.concatenate(parts)
            for parts in zip(*((run.u[run.scored], run.y[run.scored]) for run in training), strict=True)
        )
    )
    back = max(linear.lags.output)
    for data, pieces in zip(recordings.datasets, recordings.pieces, strict=True):
        usable = [run for run in pieces if len(run) > back]
        if not usable:
            continue
        target = np.concatenate([run.y[back:][run.scored[back:]] for run in usable])
        yield quality_of(data.name, data.use, "ARX", free_run_residual(linear, usable, limits), target)
        pairs = [((flat(run.u) - run.y)[run.scored], run.y[run.scored]) for run in pieces]
        yield quality_of(data.name, data.use, "plane", *_joined(pairs))


def _lost(quality: Sequence[SurrogateQuality]) -> Iterator[str]:
    """Yield a remark on each test dataset on which a linear baseline is better in free run."""
    for own in quality:
        others = [q for q in quality if q.dataset == own.dataset and q.mode in ("ARX", "plane")]
        best = min(others, key=lambda q: q.rmse if np.isfinite(q.rmse) else np.inf, default=None)
        if own.mode == "free run" and own.use == "test" and best is not None and not own.rmse <= best.rmse:
            name = "a linear ARX model" if best.mode == "ARX" else "a plane"
            yield (
                f"the free run over {own.dataset} (test) has RMSE {own.rmse:.4g}, {name} has {best.rmse:.4g}; "
                "set limits or lags, or record more data"
            )
