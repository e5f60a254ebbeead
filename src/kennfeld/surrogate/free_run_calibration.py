"""Calibration of the predictive deviation of a recursion on free runs over blocks that are left out.

For each block, a model is trained without it. Its errors over the block are larger than those of the model that has
seen all blocks, and the errors of the latter over the same block are too small: they have the weights 0.632 and 0.368
(B. Efron: Estimating the Error Rate of a Prediction Rule, Journal of the American Statistical Association, 1983), and
each block has the same weight. A few ratios of the deviations are tried. Each is scaled so that two deviations cover
95.45 % of the weighted errors, and the one with the least interval score is taken (T. Gneiting, A. E. Raftery: Strictly
Proper Scoring Rules, Prediction, and Estimation, Journal of the American Statistical Association, 2007, equation 43).
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.baselines import one_step_plane
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty, LinearisedRun
from kennfeld.surrogate.model_selection import BLOCKS, CENTRES, SAMPLES, HoldoutFold, folds
from kennfeld.surrogate.narx_training import TrainingSettings, one_step_expansion, train_free_run
from kennfeld.surrogate.recursion import Lags, Recording, Runs, simulate
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.uncertainty import TWO_DEVIATIONS, has_equal_widths

MOST = 100_000  # samples of the recordings that models are trained on without a block
FEW_ITERATIONS = 3  # of these models, if there are more samples than the regularisation is chosen on
LONGEST = 4000  # steps of a block that errors are compared over
LEFT_OUT = 0.632  # weight of errors over blocks that are left out; errors of the training have the others
RATIOS = ((0.0, 1.0), (0.05, 1.0), (0.2, 1.0), (1.0, 0.05))  # process noise and noise > 0, in units of the error
SIGNALS = (0.3, 1.0, 3.0, 10.0)  # in units of the spread of the model about its plane
ROUNDS = 6  # in which deviations are scaled: limits bound them, so that one round need not suffice
CLOSE = 0.01  # relative change of the scale with which the rounds end


@dataclass(frozen=True, eq=False)
class _BlockRun:
    """Free run of a model over a block: errors Float[steps], the steps that count, and the weight of all of them."""

    error: Float
    counted: Bool
    weight: float
    linearised: LinearisedRun

    @classmethod
    def of(cls, model: Expansion, block: Runs, limits: tuple[float, float], weight: float) -> "_BlockRun | None":
        """Run a model over the first steps of a block; None if it leaves the range of the outputs far behind."""
        y = simulate(model, block, limits).y
        error, counted = np.abs(y - block.target)[:LONGEST, 0], block.scored[:LONGEST, 0]
        if not np.isfinite(y).all() or not counted.any():
            return None
        # shares come from one kernel matrix for all centres, which needs equal widths
        points, shares = block.visited(y)[:LONGEST], has_equal_widths(model)
        return cls(error, counted, weight, LinearisedRun.along(model, points, block.lags.output, limits, shares=shares))


@dataclass(frozen=True, eq=False)
class _WeightedErrors:
    """Errors of free runs, their weights, and their deviations, all Float[errors]."""

    error: Float
    weight: Float
    deviation: Float

    @classmethod
    def of(cls, runs: Sequence[_BlockRun], uncertainty: FreeRunUncertainty) -> "_WeightedErrors":
        parts = [
            # the weight of a block is spread over its errors, so that a long block counts as much as a short one
            (run.error[run.counted], np.full(run.counted.sum(), run.weight / run.counted.sum()), deviation[run.counted])
            for run in runs
            for deviation in [run.linearised.deviation(uncertainty)[:, 0]]
        ]
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    @property
    def scale(self) -> float:
        """The factor of the deviations with which two of them cover 95.45 % of the weight."""
        ratio = self.error / self.deviation
        order = np.argsort(ratio)
        share = np.cumsum(self.weight[order]) / self.weight.sum()
        return float(ratio[order[min(np.searchsorted(share, TWO_DEVIATIONS), share.size - 1)]]) / 2

    @property
    def score(self) -> float:
        """The mean interval score of two deviations: the width, and what errors exceed it by, times 2 / 0.0455."""
        excess = np.maximum(self.error - 2 * self.deviation, 0.0)
        return float(np.average(4 * self.deviation + 2 / (1 - TWO_DEVIATIONS) * excess, weights=self.weight))


def calibrated_uncertainty(
    pieces: Sequence[Recording],
    lags: Lags,
    model: Expansion,
    lengths: Float,
    settings: TrainingSettings,
    *,
    start: float = 0.0,
    trains: bool = True,
    stopped: Stopped = never,
) -> FreeRunUncertainty | None:
    """Calibrate the uncertainty of a model on free runs over blocks that are left out.

    For each block, a model with the same length scales and regularisation is trained without it.

    Args:
        pieces: the recordings of the training.
        lags: of the model.
        model: the model that was trained on all of them.
        lengths: length scales of the model, in units of spread.
        settings: of its training for free run.
        start: the output from which it runs if none is measured.
        trains: whether it was trained for free run, and not only one step ahead.
        stopped: asked between blocks; once it returns true, there is no uncertainty.

    Returns:
        The uncertainty; None if the recordings are too short for blocks, or if no model runs freely without one.
    """
    runs = _block_runs(pieces, lags, model, lengths, settings, trains, stopped)
    if not runs or stopped():
        return None
    errors = np.concatenate([run.error[run.counted] for run in runs])
    unit = float(np.sqrt(np.mean(errors**2)))
    # an output before the run that is not measured may be any of the recorded ones, while the run begins at `start`
    unmeasured = float(np.sqrt(np.mean(np.concatenate([(piece.y - start)[piece.scored] for piece in pieces]) ** 2)))
    if unit == 0:
        return FreeRunUncertainty(0.0, 0.0, 0.0, unmeasured)
    signals = [signal * _nonlinear_spread(model, Runs.of(pieces, lags).points) for signal in SIGNALS]
    trials = [
        _scaled(FreeRunUncertainty(signal, unit * noise, unit * process_noise, unmeasured), runs)
        for (process_noise, noise), signal in product(RATIOS, signals if any(signals) else (0.0,))
    ]
    return min(trials, key=lambda trial: _WeightedErrors.of(runs, trial).score)


def _nonlinear_spread(model: Expansion, points: Float) -> float:
    if not model.size or not has_equal_widths(model):
        return 0.0
    return float(np.std(model(points) - points @ model.slopes))


def _scaled(uncertainty: FreeRunUncertainty, runs: Sequence[_BlockRun]) -> FreeRunUncertainty:
    """Return the uncertainty with a common factor of what each step adds, such that two deviations cover 95.45 %."""
    for _ in range(ROUNDS):
        scale = _WeightedErrors.of(runs, uncertainty).scale
        if scale == 0:  # nearly all errors are 0, as they are at a limit
            break
        scaled = {name: scale * getattr(uncertainty, name) for name in ("signal", "noise", "process_noise")}
        uncertainty = replace(uncertainty, **scaled)
        if abs(scale - 1) < CLOSE:
            break
    return uncertainty


def _block_runs(
    pieces: Sequence[Recording],
    lags: Lags,
    model: Expansion,
    lengths: Float,
    settings: TrainingSettings,
    trains: bool,
    stopped: Stopped,
) -> list[_BlockRun]:
    """Return the runs over each block of a model that is trained without it, and of the model itself."""
    # the models without a block cost most: many samples get fewer iterations, and more blocks of which few are run
    large = sum(map(len, pieces)) > SAMPLES
    iterations = min(settings.iterations, FEW_ITERATIONS) if large else settings.iterations
    few = replace(settings, iterations=iterations if trains else 0, moves_centres=False)
    result: list[_BlockRun] = []
    for fold in folds(pieces, lags, 2 * BLOCKS if large else BLOCKS, MOST, few=large):
        if stopped():
            break
        with suppress(ArgumentError):  # without the block, a channel may be constant
            result += _runs_over(fold, model, _trained_without(fold, model, lengths, few), settings.limits)
    return result


def _runs_over(
    fold: HoldoutFold, model: Expansion, without: Expansion, limits: tuple[float, float]
) -> Iterator[_BlockRun]:
    """Yield the runs over the held-out block, unless one leaves the range of the outputs of the training far behind.

    A model of a part of the data that does so tells nothing of one that does not.
    """
    runs = [
        _BlockRun.of(model, fold.held_out, limits, 1 - LEFT_OUT),
        _BlockRun.of(without, fold.held_out, limits, LEFT_OUT),
    ]
    most = float(np.ptp(fold.training.one_step_target))
    # the full range of the output as RMSE is worse than any constant within it
    for run in runs:
        if run is None or np.sqrt(np.mean(run.error[run.counted] ** 2)) > most:
            return
    yield from (run for run in runs if run is not None)


def _trained_without(fold: HoldoutFold, model: Expansion, lengths: Float, settings: TrainingSettings) -> Expansion:
    """Return a model like `model`, trained without the held-out block of a fold."""
    if not model.size:
        return one_step_plane(fold.training, settings.limits)
    start = one_step_expansion(fold.training, lengths, min(model.size, CENTRES), settings.limits)
    return train_free_run(start, fold.training, settings)
