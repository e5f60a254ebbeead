"""Training of a dynamic surrogate: structure, lags, regularisation and free run, judged beside linear models.

Of a nonlinear recursion (NARX), a linear one (ARX), and a function of filtered inputs without feedback, the structure
with the smallest error on held-out blocks is trained in full.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.baselines import LinearRecursion, arx, free_run_residual, one_step_plane, plane
from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
from kennfeld.surrogate.filtered_training import FilteredModel, train_filtered
from kennfeld.surrogate.free_run_calibration import calibrated_uncertainty
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty
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
from kennfeld.surrogate.stability import check_stability
from kennfeld.surrogate.stopping import Stopped
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, SurrogateQuality, quality_of
from kennfeld.surrogate.training_data import raster_of, split_recordings
from kennfeld.surrogate.validity import Validity

if TYPE_CHECKING:
    from kennfeld.surrogate.training import SurrogateSettings

Report = Callable[[str], None]
Limits = tuple[float, float]

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

    def __iter__(self) -> Iterator[tuple[Dataset, Sequence[Recording]]]:
        return zip(self.datasets, self.pieces, strict=True)


def train_dynamic(
    datasets: Sequence[Dataset], settings: "SurrogateSettings", units: tuple[str, ...], report: Report, stopped: Stopped
) -> DynamicSurrogate | FilteredSurrogate:
    """Train a dynamic surrogate on the datasets for training and score it on all, see `train_surrogate`."""
    recordings = _Recordings.of(datasets, settings)
    _check_changing(recordings.training, settings)
    training = _DynamicTraining(recordings.training, recordings.step, settings, report, stopped)
    surrogate = training.filtered() if settings.structure == "filtered" else training.best()
    linear, limits = training.linear, training.limits
    quality = [*_scores(surrogate, recordings), *_baselines(recordings, linear, limits)]
    remarks = (*_nearly_constant(recordings.training, settings), *training.remarks, *_lost(quality))
    for remark in remarks:
        report(f"Remark: {remark}")
    starts = tuple(np.mean([run.u[0] for run in recordings.training], axis=0).tolist())
    return replace(surrogate, quality=tuple(quality), remarks=remarks, units=units, start_inputs=starts)


class _DynamicTraining:
    """One training. `limits` and `remarks` are known once a model is trained."""

    def __init__(
        self, pieces: list[Recording], step: float, settings: "SurrogateSettings", report: Report, stopped: Stopped
    ) -> None:
        self.pieces, self.step, self.settings = pieces, step, settings
        self.report, self.stopped = report, stopped
        self.remarks: list[str] = []
        self.limits: Limits = UNLIMITED
        self._lags: tuple[Lags, ...] = ()

    @cached_property
    def linear(self) -> LinearRecursion:
        """The linear model; its lags may be those of the nonlinear one."""
        return arx(self.pieces, self.limits, self._lags)

    def filtered(self) -> FilteredSurrogate:
        """Return the model of filtered inputs."""
        self.limits, self.remarks = self._saturation()
        model = self._filtered_model()
        if model is None:
            message = "the recordings are too short for a filtered model, or its training was stopped"
            raise InputError.of(Location(), message, 'Record more data, or set structure = "narx".')
        return self._of_filtered(model)

    def best(self) -> DynamicSurrogate | FilteredSurrogate:
        """Return the structure with the smallest error on held-out blocks, or the recursion that is asked for."""
        lags = self._limits_and_lags()
        self._lags = (lags,)
        choice = self._regularisation(lags)
        alternative = self._alternative(choice)
        if isinstance(alternative, FilteredModel):
            return self._of_filtered(alternative)
        if alternative is not None:
            self.remarks.append("a linear ARX model has the smallest error on held-out blocks, and is used")
            # without basis functions, the lengths only say how far the validity reaches
            lengths = np.full(alternative.lags.size, MIDDLE)
            linear = ModelChoice(lengths, TrainingSettings(), np.nan)
            return self._of_recursion(alternative.lags, alternative.expansion, linear)
        return self._of_recursion(lags, self._trained(lags, choice), choice)

    def _alternative(self, choice: ModelChoice) -> FilteredModel | LinearRecursion | None:
        """Return the model that is better than the nonlinear recursion on held-out blocks, if there is one."""
        settings = self.settings
        if not settings.selects_all or settings.structure != "auto" or np.isnan(choice.rmse) or self.stopped():
            return None
        error = _linear_error(self.pieces, self.linear, self.limits)
        self.report(f"linear ARX model: {error:.4g} on the blocks left out")
        filtered = self._filtered_model()
        if filtered is not None and filtered.rmse < min(choice.rmse, error):
            return filtered
        return self.linear if error < choice.rmse else None

    def _filtered_model(self) -> FilteredModel | None:
        centres, starts, seed = self.settings.most_centres, self.settings.starts, self.settings.seed
        return train_filtered(self.pieces, self.step, self.limits, centres, starts, seed, self.report, self.stopped)

    def _of_filtered(self, model: FilteredModel) -> FilteredSurrogate:
        settings = self.settings
        return FilteredSurrogate(
            settings.name,
            settings.inputs,
            settings.output,
            self.step,
            model.time_constants,
            model.expansion,
            model.delay,
            Validity.around(model.points, model.points.std(0) * model.lengths, settings.seed),
            limits=self.limits,
            uncertainty=model.uncertainty,
        )

    def _of_recursion(self, lags: Lags, expansion: Expansion, choice: ModelChoice) -> DynamicSurrogate:
        runs, settings = Runs.of(self.pieces, lags), self.settings
        stability = self._bounded(expansion, runs)
        start = float(np.mean([run.y[0] for run in self.pieces]))
        return DynamicSurrogate(
            settings.name,
            settings.inputs,
            lags.inputs,
            settings.output,
            lags.output,
            self.step,
            expansion,
            Validity.around(runs.points, runs.points.std(0) * choice.lengths, settings.seed),
            start=start,
            limits=self.limits,
            stability=stability,
            uncertainty=self._uncertainty(lags, expansion, choice, start),
        )

    def _uncertainty(
        self, lags: Lags, expansion: Expansion, choice: ModelChoice, start: float
    ) -> FreeRunUncertainty | None:
        """Return the uncertainty of free runs within the limits, which are those of the surrogate."""
        return calibrated_uncertainty(
            self.pieces,
            lags,
            expansion,
            choice.lengths,
            replace(choice.settings, limits=self.limits),
            start=start,
            trains=self.settings.free_run,
            stopped=self.stopped,
        )

    def _bounded(self, expansion: Expansion, runs: Runs) -> str:
        """Return the result of the stability check.

        Automatic limits are set beyond the training data if free runs leave them far behind.
        """
        stability = check_stability(expansion, runs, self.limits, self.settings.seed)
        if self.settings.limits != "auto" or stability.bounded == stability.runs:
            return str(stability)
        low, high = float(runs.one_step_target.min()), float(runs.one_step_target.max())
        # one range of the output beyond either end, as the check of stability allows
        lower, upper = (float(f"{end:.4g}") for end in (2 * low - high, 2 * high - low))
        self.limits = max(self.limits[0], lower), min(self.limits[1], upper)
        far = f"{stability.runs - stability.bounded} of {stability.runs} free runs left the training data far behind"
        self.remarks.append(f"{far}; limits = [{self.limits[0]:g}, {self.limits[1]:g}] are set")
        return str(check_stability(expansion, runs, self.limits, self.settings.seed))

    def _limits_and_lags(self) -> Lags:
        """Set the limits, and return lags; limits that are recognised must not raise the error on held-out blocks."""
        self.limits, remarks = self._saturation()
        lags = self._select_lags()
        if not remarks:
            return lags
        # with the same lags, so that the limits alone make the difference
        limited, free = (lag_error(self.pieces, lags, TrainingSettings(limits=e)) for e in (self.limits, UNLIMITED))
        if limited <= free:
            self.remarks = remarks
            return lags
        seen = remarks[0].split(";")[0]
        self.remarks = [f"{seen}; limits there raise the error on held-out blocks and are not used"]
        self.limits = UNLIMITED
        # again: the lags were selected with limits that are dropped
        return self._select_lags()

    def _saturation(self) -> tuple[Limits, list[str]]:
        """Return the limits as given, or those at which the output saturates, with a remark."""
        if self.settings.limits != "auto":
            return self.settings.limits, []
        ends = find_saturation([run.y for run in self.pieces])
        if not ends:
            return UNLIMITED, []
        lower, upper = limits_of(ends)
        seen = " and ".join(f"{self.settings.output} {end}" for end in ends)
        used = f"limits = [{lower:g}, {upper:g}] are used, write limits = [-inf, inf] for none"
        return (lower, upper), [f"{seen} of {sum(map(len, self.pieces))}; {used}"]

    def _select_lags(self) -> Lags:
        settings = self.settings
        own = None if settings.output_lags == "auto" else settings.output_lags
        of_inputs = None if settings.lags == "auto" else [settings.lags[name] for name in settings.inputs]
        if own is not None and of_inputs is not None:
            return Lags(own, tuple(of_inputs))
        return select_lags(
            self.pieces,
            len(settings.inputs),
            TrainingSettings(limits=self.limits),
            longest=settings.longest_lag,
            output_lags=own,
            input_lags=of_inputs,
            report=self.report,
            stopped=self.stopped,
        )

    def _regularisation(self, lags: Lags) -> ModelChoice:
        """Choose length scales and regularisation: as given, or by a search."""
        settings, runs = self.settings, Runs.of(self.pieces, lags)
        lengths = one_step_lengths(
            runs, settings.most_centres, self.limits, settings.starts, settings.seed, self.stopped
        )
        stated = TrainingSettings(
            limits=self.limits, moves_centres=settings.moves_centres, iterations=settings.iterations
        )
        if settings.hold is not None:
            # NaN: without an error on held-out blocks, no other structure is compared
            return ModelChoice(np.minimum(lengths, MIDDLE), replace(stated, hold=settings.hold), np.nan)
        divisions = folds(self.pieces, lags) if settings.free_run else []
        if not divisions:
            return ModelChoice(lengths, stated, np.nan)
        return choose_regularisation(divisions, lengths, settings.most_centres, stated, self.report, self.stopped)

    def _trained(self, lags: Lags, choice: ModelChoice) -> Expansion:
        """Return the function trained one step ahead, and then for free run unless that is not asked for."""
        settings, runs = self.settings, Runs.of(self.pieces, lags)
        start = one_step_expansion(runs, choice.lengths, settings.most_centres, self.limits, settings.seed)
        if not settings.free_run:
            return start
        if self.stopped():
            self.report("stopped before the training for free run; the model predicts one step ahead")
            return start
        return train_over_horizons(start, self.pieces, lags, choice.settings, self._report_step, self.stopped)

    def _report_step(self, horizon: int, step: int, rmse: float) -> None:
        self.report(f"free run over {horizon} samples, step {step + 1}: RMSE {rmse:.4g}")


def _table(training: Sequence[Recording], settings: "SurrogateSettings") -> Iterator[tuple[str, Float]]:
    """Yield each channel with all its training samples."""
    table = np.concatenate([np.column_stack([run.u, run.y]) for run in training])
    yield from zip((*settings.inputs, settings.output), table.T, strict=True)


def _check_changing(training: Sequence[Recording], settings: "SurrogateSettings") -> None:
    findings = Findings()
    for name, column in _table(training, settings):
        if np.ptp(column) == 0:
            remedy = "Remove it: a constant channel carries no information."
            findings.error(Location(f"channel {name}"), f"is {column[0]:g} in all training data", remedy)
    findings.finish()


def _nearly_constant(training: Sequence[Recording], settings: "SurrogateSettings") -> Iterator[str]:
    """Yield a remark on each channel that has one value nearly everywhere."""
    for name, column in _table(training, settings):
        levels, counts = np.unique(column, return_counts=True)
        count = int(counts.max())
        if count >= CONSTANT * column.size:
            others = count_noun(column.size - count, "sample")
            level = levels[counts.argmax()]
            yield f"{name} is {level:g} except at {others} of {column.size}; the model can hardly know its effect"


def _linear_error(training: Sequence[Recording], linear: LinearRecursion, limits: Limits) -> float:
    """Return the RMSE of ARX models with these lags on the blocks that are held out of them."""
    divisions = folds(training, linear.lags)
    fits = [one_step_plane(fold.training, limits) for fold in divisions]
    return held_out_rmse(divisions, fits, TrainingSettings(limits=limits, iterations=0)) if divisions else np.inf


def _scores(surrogate: DynamicSurrogate | FilteredSurrogate, recordings: _Recordings) -> Iterator[SurrogateQuality]:
    """Yield one step ahead and in free run, from the first measured outputs of each piece on."""
    # the measured outputs that start the run are not scored
    back = max(surrogate.output_lags) if isinstance(surrogate, DynamicSurrogate) else 0
    for data, pieces in recordings:
        ahead, free = [], []  # (residual, target) of each piece
        for run in pieces:
            if len(run) <= back:
                continue
            if isinstance(surrogate, DynamicSurrogate):
                predicted = surrogate.predict(run.u, run.y)
                known = np.isfinite(predicted) & run.scored
                ahead.append(((predicted - run.y)[known], run.y[known]))
            scored = run.scored & (np.arange(len(run)) >= back)
            free.append(((surrogate.simulate(run.u, run.y[:back]) - run.y)[scored], run.y[scored]))
        if ahead:
            yield quality_of(data.name, data.use, "one step", *_joined(ahead))
        if free:
            yield quality_of(data.name, data.use, "free run", *_joined(free))


def _joined(pairs: Sequence[tuple[Float, Float]]) -> list[Float]:
    return [np.concatenate(parts) for parts in zip(*pairs, strict=True)]


def _baselines(recordings: _Recordings, linear: LinearRecursion, limits: Limits) -> Iterator[SurrogateQuality]:
    """Yield the errors of the linear model in free run, and of a plane over the present inputs."""
    flat = plane(*_joined([(run.u[run.scored], run.y[run.scored]) for run in recordings.training]))
    back = max(linear.lags.output)
    for data, pieces in recordings:
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
