"""The error over the time shift of a channel, with the present values.

Nothing is fitted: values that were fitted with a wrong shift make up for some of it, so that the true shift may be
larger. An estimate that fits the values at each shift is `shift = "auto"`, see `optimize.tuning.shift_estimation`.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.tuning.shift_estimation import (
    EDGE_DISTANCE,
    MIN_LIKELIHOOD_RATIO,
    NEIGHBOURHOOD,
    exclude_ends,
    half_width,
    sample_time,
)
from kennfeld.preprocessing.time_shift import shift_channels

MAX_SAMPLES = 100_000  # that are simulated for each shift


@dataclass(frozen=True, eq=False)
class ShiftScan:
    """The error of a criterion by the shift of a channel.

    Attributes:
        shifts: in s, rising, Float[lags].
        rmse: in the unit of the criterion, Float[lags].
        best: the vertex of the parabola through the least errors, in s.
        deviation: standard deviation of `best` in s, from the curvature of the likelihood, for as many independent
            errors as the neighbours in time let them count; NaN if the error does not bend there.
        seen: True if the data rule out the other shifts.
        at_the_end: True if the best shift is at the edge of the window: the true one may be beyond it.
        samples: number of samples that were scored.
    """

    shifts: Float
    rmse: Float
    best: float
    deviation: float
    seen: bool
    at_the_end: bool
    samples: int


def scan_shift(view: View, channel: str, criterion: int) -> ShiftScan:
    """Return the error of a criterion for shifts of a channel in all training data that have it.

    Raises:
        ArgumentError: it is in no training data with time stamps, or no sample is scored.
    """
    problem = view.model.problem
    datasets = [data for data in problem.fitted_datasets if data.time is not None and channel in data]
    if not datasets:
        raise ArgumentError(f"{channel[:100]} is in no training data with time stamps")
    if not 0 <= criterion < len(problem.criteria):
        raise ArgumentError(f"there is no criterion {criterion + 1}")
    step = min(sample_time(data) for data in datasets)
    most = max(half_width(data) for data in datasets)
    lags = np.arange(-most, most + 1, dtype=np.float64)
    # scored only where every shift leaves samples available
    scored = [exclude_ends(data, most) for data in _some(datasets)]
    scorer = Scorer(problem.over(scored))
    errors = [_errors(view, scorer, scored, {channel: float(lag * step)}, criterion) for lag in lags]
    known = np.isfinite(errors).all(axis=0)
    if not known.any():
        raise ArgumentError(f"no sample is scored at all shifts of {channel[:100]}")
    kept = np.array(errors)[:, known]
    return _judge(lags, step, np.mean(kept**2, axis=1), kept)


def _some(datasets: Sequence[Dataset]) -> Iterator[Dataset]:
    """Yield datasets up to the number of samples that are simulated; the first one in any case."""
    count = 0
    for data in datasets:
        count += data.samples
        if count > MAX_SAMPLES and count > data.samples:
            return
        yield data


def _errors(view: View, scorer: Scorer, datasets: Sequence[Dataset], shift: dict[str, float], criterion: int) -> Float:
    """Return the errors of a criterion over all samples of the datasets, Float[samples]; NaN where it is not scored."""
    parts = []
    for data in datasets:
        bound = view.model.problem.bind(shift_channels(data, shift))
        values = np.full(data.samples, np.nan)
        if bound.hold is None:
            values[bound.kept] = scorer.errors(bound, view.now.parameters)[criterion]
        parts.append(values)
    return np.concatenate(parts)


def _judge(lags: Float, step: float, costs: Float, errors: Float) -> ShiftScan:
    """Return the scan with its minimum; `errors` are Float[lags, samples]."""
    at = int(np.argmin(costs))
    count = errors.shape[1]
    lag, deviation = float(lags[at]), float("nan")
    independent = count * _independent_share(errors[at])
    if 0 < at < lags.size - 1:
        before, here, after = costs[at - 1 : at + 2]
        bend = before - 2 * here + after
        if bend > 0:
            lag += float(np.clip((before - after) / (2 * bend), -0.5, 0.5))
        # -2 log L = n log(mean square); its curvature is 2 over the variance
        curve = independent * float(np.log(before) - 2 * np.log(here) + np.log(after)) if here > 0 else np.inf
        deviation = float(np.sqrt(2 / curve)) if curve > 0 else float("nan")
    far = np.abs(lags - lag) > NEIGHBOURHOOD
    rival = float(costs[far].min()) if far.any() else float(costs.max())
    best = float(costs[at])
    seen = rival > 0 if best <= 0 else independent * float(np.log(rival / best)) > MIN_LIKELIHOOD_RATIO
    return ShiftScan(
        shifts=lags * step,
        rmse=np.sqrt(costs),
        best=lag * step,
        deviation=deviation * step,
        seen=bool(seen),
        at_the_end=abs(lag) > float(lags[-1]) - EDGE_DISTANCE,
        samples=count,
    )


def _independent_share(errors: Float) -> float:
    """Return the share of errors that count as independent, (1 - r) / (1 + r) with the correlation r of neighbours.

    That of a process of first order (Bartlett 1946).
    """
    centred = errors - errors.mean()
    total = float(np.einsum("i,i", centred, centred))  # without the threads of BLAS
    if total <= 0:
        return 1.0
    r = float(np.clip(float(np.einsum("i,i", centred[1:], centred[:-1])) / total, 0.0, 0.999))
    return (1 - r) / (1 + r)
