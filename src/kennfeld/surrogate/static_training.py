"""Training of a static data-driven model from datasets."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import baselines
from kennfeld.surrogate.gaussian_process import GaussianProcess, gaussian_process
from kennfeld.surrogate.rbf_fit import expand_data
from kennfeld.surrogate.stopping import Stopped
from kennfeld.surrogate.surrogate_models import Mode, StaticSurrogate, SurrogateQuality, quality_of
from kennfeld.surrogate.training_data import extract_points
from kennfeld.surrogate.training_points import TrainingPoints
from kennfeld.surrogate.validity import Validity

if TYPE_CHECKING:
    from kennfeld.surrogate.training import SurrogateSettings

BLOCKS = 20  # of recordings, left out in turn
MOST_NAMED = 5  # outliers that are named one by one


@dataclass(frozen=True, eq=False)
class _UsableSamples:
    """The usable samples of a dataset: inputs Float[rows, inputs], output Float[rows], sample numbers Int[rows]."""

    dataset: Dataset
    x: Float
    y: Float
    samples: Int

    @property
    def training(self) -> bool:
        return self.dataset.use == "training"


def train_static(
    datasets: Sequence[Dataset], settings: "SurrogateSettings", units: tuple[str, ...], stopped: Stopped
) -> StaticSurrogate:
    """Train a static model on the datasets for training, and score it and the plane on all of them.

    Raises:
        InputError: a dataset has no usable sample.
        ArgumentError: the points cannot be used for training.
    """
    parts = [_UsableSamples(data, *extract_points(data, settings.inputs, settings.output)) for data in datasets]
    training = [part for part in parts if part.training]
    x, y = np.concatenate([part.x for part in training]), np.concatenate([part.y for part in training])
    left_out: list[SurrogateQuality] = []
    wrong, uncertainty, remarks = np.zeros(len(y), dtype=bool), None, []
    if settings.method == "expansion":
        expansion = expand_data(x, y, min(settings.most_centres, max(len(x), 1)), seed=settings.seed)
        validity, plane = Validity.around(x, x.std(0), settings.seed), baselines.plane(x, y)
        repeated = int(TrainingPoints.of(x, y).repeats.sum())
    else:
        blocks = recording_blocks(training, settings.seed)
        process = gaussian_process(
            x,
            y,
            method=settings.method,
            kernel=settings.kernel,
            noise=settings.noise,
            centres=settings.centres,
            starts=settings.starts,
            seed=settings.seed,
            names=settings.inputs,
            blocks=blocks,
            kinks=settings.kinks,
            stopped=stopped,
        )
        expansion, validity, plane = process.expansion, process.validity, process.plane
        wrong, uncertainty, repeated = process.outliers, process.uncertainty, process.repeated
        left_out = _left_out_scores(process, y, blocks is not None)
        remarks = [*_outlier_remarks(training, wrong, expansion, settings.output), *process.remarks]
    if repeated:
        remarks.append(
            f"{repeated} of {len(y)} rows repeat the inputs of another row; they count as one point with less noise"
        )
    quality = _scores(parts, wrong, expansion, "static") + _scores(parts, wrong, plane, "plane")
    return StaticSurrogate(
        settings.name,
        settings.inputs,
        settings.output,
        units,
        expansion,
        validity,
        (*quality, *left_out),
        uncertainty,
        tuple(remarks),
    )


def recording_blocks(training: Sequence[_UsableSamples], seed: int) -> Int | None:
    """Number the block of each row; None for steady-state points, each of which is left out alone.

    Neighbouring samples of a recording are nearly the same, so that leaving out one of them says nothing. Rows of
    steady-state points beside a recording are distributed over the blocks by chance.
    """
    if all(part.dataset.time is None for part in training):
        return None
    count = sum(len(part.y) for part in training if part.dataset.time is not None)
    rng, first, blocks = np.random.default_rng(seed), 0, []
    for part in training:
        if part.dataset.time is None:
            blocks.append(rng.integers(BLOCKS, size=len(part.y)))
        else:
            # blocks of equal size along all recordings one after another, whatever the lengths of these
            blocks.append((first + np.arange(len(part.y))) * min(BLOCKS, count) // count)
            first += len(part.y)
    return np.concatenate(blocks).astype(np.int64)


def _left_out_scores(process: GaussianProcess, y: Float, blocks: bool) -> list[SurrogateQuality]:
    used = ~process.outliers
    rows: tuple[tuple[Mode, Float], ...] = (
        ("blocks left out" if blocks else "leave one out", process.left_out),
        ("plane left out", process.plane_left_out),
    )
    return [quality_of("all", "training", mode, residual[used], y[used]) for mode, residual in rows]


def _scores(parts: Sequence[_UsableSamples], wrong: Bool, model: Expansion, mode: Mode) -> list[SurrogateQuality]:
    """Return the errors over each dataset, without the training rows that are outliers."""
    lines, first = [], 0
    for part in parts:
        kept = np.ones(len(part.y), dtype=bool)
        if part.training:
            kept = ~wrong[first : first + len(part.y)]
            first += len(part.y)
        x, y = part.x[kept], part.y[kept]
        lines.append(quality_of(part.dataset.name, part.dataset.use, mode, model(x) - y, y))
    return lines


def _outlier_remarks(training: Sequence[_UsableSamples], wrong: Bool, model: Expansion, output: str) -> Iterator[str]:
    """Yield a sentence for each of the first outliers, and one for the others."""
    names = [(part, row) for part in training for row in range(len(part.y))] if wrong.any() else []
    listed = [names[at] for at in np.flatnonzero(wrong)]
    for part, row in listed[:MOST_NAMED]:
        value, expected = part.y[row], float(model(part.x[row]))
        yield (
            f"sample {part.samples[row] + 1} of {part.dataset.name} is an outlier and was not used: {output} is "
            f"{value:.6g}, its neighbours suggest {expected:.4g}"
        )
    if len(listed) > MOST_NAMED:
        yield f"{count_noun(len(listed) - MOST_NAMED, 'further sample')} are outliers and were not used"
