"""Stability of a dynamic surrogate in free run, checked by simulation and by linearisation."""

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.recursion import Recording, Runs, simulate

RUNS = 24  # of each kind
STEPS = 1000
HOLD = (5, 100)  # samples that a random input is held at least and at most


@dataclass(frozen=True)
class Stability:
    """Result of the stability check.

    `bounded` of `runs` free runs stayed within the range of the training output, widened by its own width to each side:
    with constant and with random inputs of the training data, from its minimum, mean and maximum output. `stable` is
    the share of the training samples at which the linearised recursion has its eigenvalues within the unit circle,
    `largest` the largest absolute eigenvalue.
    """

    bounded: int
    runs: int
    stable: float
    largest: float

    def __str__(self) -> str:
        share = "All" if self.bounded == self.runs else f"{self.bounded} of"
        text = (
            f"{share} {self.runs} free runs with constant and random inputs stayed bounded."
            f" The linearised recursion is stable at {100 * self.stable:.1f} % of the training samples"
            f" (largest eigenvalue {self.largest:.4f})."
        )
        if self.bounded < self.runs:
            text += " Record more data where it diverged, set limits, or use fewer lags or centres."
        return text


def check_stability(expansion: Expansion, runs: Runs, limits: tuple[float, float], seed: int = 0) -> Stability:
    """Run the model from several starts and linearise it along the training data."""
    rng = np.random.default_rng(seed)
    target = runs.one_step_target
    trials = _trials(runs, target, rng)
    y = simulate(expansion, trials, limits).y
    low, high = float(target.min()), float(target.max())
    slack = 1e-3 * (high - low)  # limits at the ends of that range are rounded
    with np.errstate(invalid="ignore"):
        inside = (y >= 2 * low - high - slack) & (y <= 2 * high - low + slack)
    sizes = _eigenvalues(expansion, runs, limits)
    bounded = int(inside.all(axis=0).sum())
    return Stability(bounded, y.shape[1], float(np.mean(sizes < 1)), float(sizes.max(initial=0.0)))


def _trials(runs: Runs, target: Float, rng: np.random.Generator) -> Runs:
    """Return constant inputs, then random steps between inputs that occur together in the training data."""
    lags = runs.lags
    samples = STEPS + lags.longest
    # lags increase, so that the first coordinate of each input is its latest sample
    heads = np.cumsum([len(lags.output), *map(len, lags.inputs)])[:-1]
    present = np.zeros((len(runs.points), len(lags.inputs)))  # the latest sample of each input that the model reads
    for j, (head, own) in enumerate(zip(heads, lags.inputs, strict=True)):
        if own:
            present[:, j] = runs.points[:, head]
    begins = (target.min(), target.mean(), target.max())
    recordings = []
    for i in range(2 * RUNS):
        picked = np.full(samples, rng.integers(len(present)))
        if i >= RUNS:
            lengths = rng.integers(*HOLD, size=samples, endpoint=True)
            picked = np.repeat(rng.integers(len(present), size=samples), lengths)[:samples]
        recordings.append(Recording(present[picked], np.full(samples, begins[i % len(begins)])))
    return Runs.of(recordings, lags)


def _eigenvalues(expansion: Expansion, runs: Runs, limits: tuple[float, float], most: int = 2000) -> Float:
    """Return the largest absolute eigenvalue of the linearised recursion at (at most so many) training samples."""
    lags = runs.lags.output
    points = runs.points[:: max(len(runs.points) // most, 1)]
    slopes = expansion.gradient(points)[:, : len(lags)]
    value = expansion(points)
    # at a limit, nothing of an earlier error passes on
    slopes[(value <= limits[0]) | (value >= limits[1])] = 0.0
    companion = np.zeros((len(points), max(lags), max(lags)))
    # companion matrix of e_k = sum over lags l of df/dy_{k-l} e_{k-l}: slopes in row 0, ones below the diagonal
    companion[:, np.arange(1, max(lags)), np.arange(max(lags) - 1)] = 1.0
    companion[:, 0, np.array(lags) - 1] = slopes
    largest: Float = np.abs(np.linalg.eigvals(companion)).max(axis=1)
    return largest
