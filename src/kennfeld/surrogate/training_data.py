"""Training data from datasets: complete points, or recordings with a fixed step, and their scaling to unit spread."""

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.file_spans import short_names
from kennfeld.domain.rbf import Expansion, Hinge, Kernel
from kennfeld.measurement.resampling import even_grid, is_stepped, resample
from kennfeld.surrogate.recursion import Recording

EVEN = 1e-3  # share of a step by which time stamps may be off
SHORTEST = 8  # samples of a run


def missing_channels(datasets: Sequence[Dataset], names: Sequence[str]) -> list[Finding]:
    """Return a finding for each channel that a dataset does not have."""
    return [
        Finding(_location(data), f"channel {name} is missing", nearest(name, data) or "Name another file.")
        for data in datasets
        for name in names
        if name not in data
    ]


def _location(dataset: Dataset) -> Location:
    return Location(f"dataset {dataset.name}")


def extract_points(dataset: Dataset, inputs: Sequence[str], output: str) -> tuple[Float, Float, Int]:
    """Extract points Float[points, inputs], values Float[points] and sample numbers Int[points], the first being 0.

    They are the scored samples without missing values.
    """
    x = np.column_stack([dataset[name].values for name in inputs])
    y = dataset[output].values
    usable = np.isfinite(x).all(axis=1) & np.isfinite(y) & dataset.counting
    if not usable.any():
        raise InputError.of(_location(dataset), "no sample has all inputs and the output", "Check its channels.")
    return x[usable], y[usable], np.flatnonzero(usable)


def listed_twice(datasets: Sequence[Dataset]) -> Iterator[Finding]:
    """Yield a warning for each file that belongs to datasets several times."""
    users: dict[str, list[str]] = {}
    for data in datasets:
        for name in data.files.names if data.files is not None else ():
            users.setdefault(name, []).append(data.name)
    short = short_names(list(users))
    for name, named in users.items():
        if len(named) > 1:
            message = f"file {short[name]} is used {len(named)} times, by {join_names(list(dict.fromkeys(named)))}"
            yield Finding(Location("dataset"), message, "List it once.", severity="warning")


def repeated_rows(tables: Sequence[Float]) -> Iterator[Finding]:
    """Yield a warning if training points have the same inputs, each table Float[points, inputs]."""
    if not tables:
        return
    rows = np.concatenate(tables)
    repeated = len(rows) - len(np.unique(rows, axis=0))
    if repeated:
        message = f"{repeated} of {len(rows)} training rows repeat the inputs of another row"
        remedy = "They count as one point with less noise; check that no recording is copied."
        yield Finding(Location("dataset"), message, remedy, severity="warning")


def raster_of(datasets: Sequence[Dataset], step: float | None) -> float:
    """Return the step of the model in s: `step` if given, or the median step of the first recording.

    Raises `InputError` for each dataset without time stamps.
    """
    findings = Findings()
    for dataset in datasets:
        if dataset.time is None:
            remedy = "Name the time channel `time`, or set `raster`."
            findings.error(_location(dataset), "a dynamic model requires time stamps", remedy)
    findings.finish()
    if step is not None:
        return step
    time = datasets[0].time
    assert time is not None
    steps = np.concatenate([np.diff(time[piece]) for piece in datasets[0].pieces])
    if not steps.size:
        raise InputError.of(_location(datasets[0]), "its pieces have one sample each", "Give longer recordings.")
    return float(f"{np.median(steps):.9g}")


def split_recordings(
    dataset: Dataset, inputs: Sequence[str], output: str, step: float, held: Collection[str] = ()
) -> list[Recording]:
    """Return the pieces on the model's raster, split where values are missing for longer than `max_gap`.

    Channels of `held` keep their value until the next sample; of the others, those that are stepped do.
    """
    stepped = {name for name in inputs if name in held or is_stepped(dataset[name].values)}
    recordings = []
    for piece in dataset.pieces:
        assert dataset.time is not None
        time = dataset.time[piece]
        # samples that are on the raster already are taken as they are, without interpolation
        even = time.size < 2 or bool(np.abs(np.diff(time) - step).max() <= EVEN * step)
        at = time if even else even_grid(time, step)
        columns = [
            _resample(dataset[name].values[piece], time, at, dataset.max_gap, name in stepped)
            for name in (*inputs, output)
        ]
        scored = np.ones(at.size, dtype=bool)
        if dataset.scored is not None:
            scored = dataset.scored[piece][_nearest_samples(time, at)]
        table = np.column_stack(columns)
        complete = np.isfinite(table).all(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], complete.astype(int), [0]])))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            if end - first >= SHORTEST:
                recordings.append(Recording(table[first:end, :-1], table[first:end, -1], scored[first:end]))
    return recordings


def _nearest_samples(time: Float, at: Float) -> Int:
    """Return the number of the sample nearest to each time.

    >>> _nearest_samples(np.array([0.0, 1.0, 2.0]), np.array([-1.0, 0.4, 0.6, 9.0])).tolist()
    [0, 0, 1, 2]
    """
    later = np.minimum(np.searchsorted(time, at), time.size - 1)
    before = np.maximum(later - 1, 0)
    return np.where(at - time[before] < time[later] - at, before, later)


def _resample(values: Float, time: Float, at: Float, max_gap: float, held: bool) -> Float:
    """Return a channel at the raster; NaN where it is missing for longer than `max_gap`."""
    known = np.isfinite(values)
    if known.all():
        return values if at is time else resample(time, values, at, held)
    if not known.any():
        return np.full(at.size, np.nan)
    filled = resample(time, values, at, held)
    stamps = time[known]
    after = np.searchsorted(stamps, at - 1e-9)
    before, later = stamps[np.maximum(after - 1, 0)], stamps[np.minimum(after, stamps.size - 1)]
    exact = np.abs(later - at) <= 1e-9
    # 1.5 usual steps between known samples do not count as a gap, even if max_gap is 0
    gap = later - before > max(max_gap, 1.5 * float(np.median(np.diff(time))))
    return np.where(gap & ~exact, np.nan, filled)


@dataclass(frozen=True, eq=False)
class Scaling:
    """Mean and standard deviation of each input and of the output over the training data."""

    centre: Float  # Float[inputs]
    spread: Float  # Float[inputs], > 0
    level: float
    height: float  # > 0

    @classmethod
    def of(cls, x: Float, y: Float) -> "Scaling":
        """Measure the scaling of points Float[points, inputs] and values Float[points]; 1 for a constant output."""
        height = float(y.std())
        return cls(x.mean(0), x.std(0), float(y.mean()), height if height > 0 else 1.0)

    def inward(self, x: Float) -> Float:
        """Return points in units of spread."""
        scaled: Float = (x - self.centre) / self.spread
        return scaled

    def outward(self, hinges: Sequence[Hinge]) -> tuple[Hinge, ...]:
        """Return hinges over scaled inputs in physical units."""
        return tuple(
            Hinge(d, float(self.centre[d] + self.spread[d] * position), self.height * height / float(self.spread[d]))
            for d, position, height in hinges
        )

    def expansion(
        self,
        offset: float,
        slopes: Float,
        weights: Float,
        centres: Float,
        lengths: Float,
        kernel: Kernel = "gaussian",
    ) -> Expansion:
        """Return an expansion over scaled inputs in physical units; `lengths` as `centres`, or one row."""
        steep = self.height * slopes / self.spread
        return Expansion(
            self.level + self.height * offset - float(steep @ self.centre),
            steep,
            self.height * weights,
            self.centre + self.spread * centres,
            np.broadcast_to(self.spread * lengths, centres.shape),
            kernel=kernel,
        )


def check_points(x: Float, y: Float, names: Sequence[str] = ()) -> tuple[Float, Float]:
    """Check points and values as every training needs, and return them as arrays.

    Args:
        x: Float[points, inputs].
        y: Float[points].
        names: of the inputs, for messages.

    Raises:
        ArgumentError: shapes differ, a number is not finite, an input is constant, or there are too few points.
    """
    points, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if points.ndim != 2 or values.shape != points.shape[:1]:
        raise ArgumentError(
            f"x of shape {points.shape} and y of shape {values.shape} must be [points, inputs], [points]"
        )
    count, inputs = points.shape
    named = list(names) or [f"input {d}" for d in range(inputs)]
    if not inputs or count < inputs + 3:
        raise ArgumentError(
            f"{count} points are too few for {inputs} inputs; at least {max(inputs, 1) + 3} are required"
        )
    bad = np.flatnonzero(~np.isfinite(points).all(0))
    if bad.size or not np.isfinite(values).all():
        message = named[bad[0]] if bad.size else "the output"
        raise ArgumentError(f"{message} has values that are not finite; remove these samples")
    # relative: the standard deviation of equal numbers need not be exactly 0
    constant = np.flatnonzero(~(points.std(0) > 1e-14 * np.abs(points).max(0)))
    if constant.size:
        first = int(constant[0])
        raise ArgumentError(
            f"{named[first]} is {points[0, first]:g} at every training sample; remove it from the inputs"
        )
    return points, values
