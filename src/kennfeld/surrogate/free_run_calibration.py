"""Calibration of the predictive deviation of a dynamic model on free runs over blocks that are left out.

For each block, a model is trained without it. Its errors over the block are larger than those of the model that has
seen all blocks, errors of the training are smaller: they are weighted 0.632 to 0.368 (B. Efron: Estimating the Error
Rate of a Prediction Rule, 1983). The deviations of process and measurement are those of the narrowest band of two
deviations that covers 95.45 % of them.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import compress, product

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.lazy_dataclass import dataclass
from kennfeld.rbf import Expansion
from kennfeld.surrogate.baselines import plane
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty, RunPath
from kennfeld.surrogate.gp_kernel import JITTER
from kennfeld.surrogate.model_selection import BLOCKS, CENTRES, SAMPLES, HoldoutFold, folds
from kennfeld.surrogate.narx_training import TrainingSettings, free_run_rmse, one_step_expansion, train_free_run
from kennfeld.surrogate.recursion import Lags, Recording, Runs, simulate
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.uncertainty import TWO_DEVIATIONS

MOST = 100_000  # samples of the recordings that models are trained on without a block
FEW_ITERATIONS = 3  # of these models, if there are more samples than the regularisation is chosen on
COMPARED = 4000  # errors that trials are compared on
LEFT_OUT = 0.632  # weight of errors over blocks that are left out; errors of the training have the others
PROCESS_NOISES = (0.0, 0.01, 0.03, 0.1, 0.3)  # that are tried, in units of the error
SIGNALS = (0.1, 0.3, 1.0)  # that are tried, in units of the spread of the bells
NOISES = tuple(np.geomspace(0.05, 1.5, 12).tolist())  # that are tried, in units of the error


@dataclass(frozen=True, eq=False)
class _FreeRunErrors:
    """Errors of free runs Float[errors], their weights, and variances that are propagated Float[trials, errors]."""

    size: Float
    weight: Float
    variance: Float

    @classmethod
    def joined(cls, parts: "Sequence[_FreeRunErrors]") -> "_FreeRunErrors":
        size, weight = (np.concatenate([getattr(part, name) for part in parts]) for name in ("size", "weight"))
        return cls(size, weight, np.concatenate([part.variance for part in parts], axis=1))

    def calibrated(self, trial: int, noise: float) -> tuple[float, float]:
        """Return the score of a band of two deviations that covers 95.45 % of the weight, and its scale.

        The score is that of intervals, width plus excess, of T. Gneiting, A. E. Raftery: Strictly Proper Scoring Rules,
        2007, equation 43.
        """
        deviation = np.sqrt(self.variance[trial] + noise**2)
        ratio = self.size / deviation
        order = np.argsort(ratio)
        share = np.cumsum(self.weight[order]) / self.weight.sum()
        scale = float(ratio[order[min(np.searchsorted(share, TWO_DEVIATIONS), share.size - 1)]]) / 2
        half = 2 * scale * deviation
        excess = np.maximum(self.size - half, 0.0)
        return float(np.average(2 * half + 2 / (1 - TWO_DEVIATIONS) * excess, weights=self.weight)), scale


def calibrated_uncertainty(
    pieces: Sequence[Recording],
    lags: Lags,
    model: Expansion,
    lengths: Float,
    settings: TrainingSettings,
    *,
    trains: bool = True,
    stopped: Stopped = never,
) -> FreeRunUncertainty | None:
    """Return the uncertainty of a model, calibrated on free runs over blocks that are left out.

    For each block, a model with the same length scales and regularisation is trained without it.

    Args:
        pieces: the recordings of the training.
        lags: of the model.
        model: the model that was trained on all of them.
        lengths: length scales of the model, in units of spread.
        settings: of its training for free run.
        trains: whether it was trained for free run, and not only one step ahead.
        stopped: asked between blocks; once it returns true, there is no uncertainty.

    Returns:
        The uncertainty; None if the recordings are too short for blocks, if no model runs freely without one, or if the
        widths differ between centres.
    """
    if model.size and not np.all(model.widths == model.widths[0]):
        return None
    large = sum(map(len, pieces)) > SAMPLES
    divisions = folds(pieces, lags, 2 * BLOCKS if large else BLOCKS, MOST, few=large)
    iterations = min(settings.iterations, FEW_ITERATIONS) if large else settings.iterations
    few = replace(settings, iterations=iterations if trains else 0, moves_centres=False)
    models, trained_folds = [], []
    for fold in divisions:
        if stopped():
            return None
        # without the block, a channel may be constant
        with suppress(ArgumentError):
            models.append(_trained_without(fold, model, lengths, few))
            trained_folds.append(fold)
    points = Runs.of(pieces, lags).points
    # a small model that leaves the range of the outputs far behind tells nothing of one that does not
    most = float(np.ptp(points[:, 0]))
    stays = [
        free_run_rmse(m, fold.held_out, settings.limits) <= most for m, fold in zip(models, trained_folds, strict=True)
    ]
    models, runs = list(compress(models, stays)), [fold.held_out for fold in compress(trained_folds, stays)]
    if not runs:
        return None
    unit = _unit(models, runs, settings.limits)
    nugget = np.full(model.size, JITTER)
    if unit == 0:
        return FreeRunUncertainty(0.0, 0.0, 0.0, nugget)
    spread = float(np.std(model(points) - points @ model.slopes)) if model.size else 0.0
    trials = [(unit * noise, spread * signal) for noise in PROCESS_NOISES for signal in (SIGNALS if spread else (0.0,))]
    errors = _FreeRunErrors.joined(
        [
            *_errors(models, runs, trials, settings.limits, LEFT_OUT),
            *_errors([model] * len(runs), runs, trials, settings.limits, 1 - LEFT_OUT),
        ]
    )
    best, noise = min(
        product(range(len(trials)), unit * np.array(NOISES)), key=lambda trial: errors.calibrated(*trial)[0]
    )
    process_noise, signal = trials[best]
    return FreeRunUncertainty(signal, noise, process_noise, nugget).scaled(errors.calibrated(best, noise)[1])


def _unit(models: Sequence[Expansion], runs: Sequence[Runs], limits: tuple[float, float]) -> float:
    """Return the RMSE of models over their runs."""
    squares = [free_run_rmse(model, run, limits) ** 2 for model, run in zip(models, runs, strict=True)]
    return float(np.sqrt(np.mean(squares)))


def _errors(
    models: Sequence[Expansion],
    runs: Sequence[Runs],
    trials: Sequence[tuple[float, float]],
    limits: tuple[float, float],
    weight: float,
) -> Iterator[_FreeRunErrors]:
    """Yield the errors of each model over a run, thinned evenly, unless it diverges."""
    every = max(sum(run.target.size for run in runs) // COMPARED, 1)
    process_noise, signal = (np.array(column)[:, None, None] for column in zip(*trials, strict=True))
    for model, run in zip(models, runs, strict=True):
        y = simulate(model, run, limits).y
        if not np.isfinite(y).all():
            continue
        path = RunPath.of(model, np.full(model.size, JITTER), run.visited(y), len(run.lags.output))
        variance = path.variance(process_noise**2 + (signal * path.shares) ** 2, run.lags.output, limits)
        size, used = np.abs(y - run.target)[:, 0], run.scored[:, 0]
        yield _FreeRunErrors(
            size[used][::every], np.full(used.sum(), weight)[::every], variance[:, used, 0][:, ::every]
        )


def _trained_without(fold: HoldoutFold, model: Expansion, lengths: Float, settings: TrainingSettings) -> Expansion:
    """Return a model like `model`, trained without the held-out block of a fold."""
    if not model.size:
        target = fold.training.one_step_target
        inside = (target > settings.limits[0]) & (target < settings.limits[1])
        return plane(fold.training.points[inside], target[inside])
    start = one_step_expansion(fold.training, lengths, min(model.size, CENTRES), settings.limits)
    return train_free_run(start, fold.training, settings)
