"""Strip charts, scatter plots and histograms."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.questions.error_split import nearest
from kennfeld.app.session.distributions import beyond, common_bins, drawn_samples, histogram
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SampleSelection, SignalName
from kennfeld.app.session.strips import Statistics, describe, statistics, strip
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import KennfeldError
from kennfeld.base.lazy_dataclass import dataclass

MAX_PIXELS = 8192  # of a screen
MAX_MATRIX_POINTS = 2500  # samples in each plot of a scatter matrix


@dataclass(frozen=True)
class AskedStrip:
    """Signals over a stretch of a dataset; `only` limits the samples, `brush` lights some of them."""

    dataset: int
    signals: Sequence[SignalName]
    begin: float
    end: float
    pixels: int
    only: SampleSelection | None = None
    brush: SampleSelection | None = None


@dataclass(frozen=True, eq=False)
class StripReply:
    """Signals over a stretch.

    Attributes:
        raw: true if every sample is drawn; else the least and the greatest value of each pixel.
        missing: the reason for each signal that the dataset lacks, by its number.
        x: positions, counted from `begin`.
        lit: above 0 where the brush selects a sample.
        lines: the signals that are present, by their numbers.
    """

    begin: float
    raw: bool
    missing: Mapping[int, str]
    x: Float
    lit: Float
    lines: Mapping[str, Float]


@dataclass(frozen=True)
class AskedStatistics:
    """Signals over the samples of a dataset that `brush` selects, or from `begin` to `end`."""

    dataset: int
    signals: Sequence[SignalName]
    begin: float = -np.inf
    end: float = np.inf
    brush: SampleSelection | None = None


@dataclass(frozen=True)
class StatisticsRow:
    """Numbers on a signal over a stretch."""

    samples: float | None
    least: float | None
    mean: float | None
    greatest: float | None
    rms: float | None


@dataclass(frozen=True)
class StatisticsReply:
    """Numbers on each signal."""

    statistics: Sequence[StatisticsRow]


@dataclass(frozen=True)
class AskedCursor:
    """The sample of a dataset nearest to a position, moved on by `step` samples."""

    dataset: int
    position: float
    signals: Sequence[SignalName]
    step: int = 0


@dataclass(frozen=True)
class CursorReply:
    """A sample with its position and the value of each signal."""

    sample: int
    position: float
    values: Sequence[float | None]


@dataclass(frozen=True)
class AskedScatter:
    """The errors of a criterion on a dataset; `both` fits the bins to those at the start, too."""

    dataset: int
    criterion: int = 0
    only: SampleSelection | None = None
    brush: SampleSelection | None = None
    both: bool = False


@dataclass(frozen=True, eq=False)
class ScatterReply:
    """Calculated and measured values at the drawn samples, and histograms of all errors between `edges`.

    The end bins hold those `beyond` the edges as well, of which there are so many below and above.
    """

    sample: Int
    position: Float
    measured: Float
    now: Float
    start: Float
    lit: Bool | Float
    edges: Float
    beyond: Int
    after: Int
    before: Int
    brushed: Int


@dataclass(frozen=True)
class AskedPoints:
    """Signals of a dataset at samples to draw over each other, `most` of them."""

    dataset: int
    signals: Sequence[SignalName]
    criterion: int = 0
    only: SampleSelection | None = None
    brush: SampleSelection | None = None
    most: int = MAX_MATRIX_POINTS


@dataclass(frozen=True, eq=False)
class PointsReply:
    """Signals at the same samples.

    Attributes:
        lit: 1 at samples that the brush selects.
        position: of the samples, counted from `begin`.
        lines: the signals that the dataset has, by their numbers.
    """

    begin: float
    lit: Bool | Float
    position: Float
    lines: Mapping[str, Float]


def strip_chart(session: Session, asked: AskedStrip) -> StripReply:
    """Return signals over a stretch of a dataset. Samples that `only` does not select are gaps."""
    view, recording = _dataset(session, asked.dataset)
    pixels = max(1, min(asked.pixels, MAX_PIXELS))
    stretch, wanted = (asked.begin, asked.end), asked.signals
    missing = _missing(view, recording, wanted)
    present = [number for number in range(len(wanted)) if number not in missing]
    drawn = strip(
        view.signals, recording, [wanted[number] for number in present], *stretch, pixels, asked.only, asked.brush
    )
    lines = {str(number): values for number, values in zip(present, drawn.lines, strict=True)}
    return StripReply(drawn.begin, drawn.raw, missing, drawn.positions, drawn.lit, lines)


def stretch_statistics(session: Session, asked: AskedStatistics) -> StatisticsReply:
    """Return statistics of signals over the samples of a dataset that are brushed, or over a stretch."""
    view, recording = _dataset(session, asked.dataset)
    chosen, wanted = _mask(view, recording, asked.brush), asked.signals
    missing = _missing(view, recording, wanted)

    def row(signal: SignalName) -> Statistics:
        if chosen is not None:
            return describe(view.signals.values(recording, signal)[chosen])
        return statistics(view.signals, recording, signal, asked.begin, asked.end)

    rows = [describe(np.zeros(0)) if number in missing else row(signal) for number, signal in enumerate(wanted)]
    return StatisticsReply([StatisticsRow(*map(finite, vars(row).values())) for row in rows])


def cursor(session: Session, asked: AskedCursor) -> CursorReply:
    """Return a sample of a dataset, and signals at it."""
    view, recording = _dataset(session, asked.dataset)
    at = nearest(recording, asked.position) + asked.step
    at = max(0, min(at, recording.count - 1))
    wanted = asked.signals
    missing = _missing(view, recording, wanted)
    values = [
        None if number in missing else finite(view.signals.values(recording, signal)[at])
        for number, signal in enumerate(wanted)
    ]
    return CursorReply(at, float(recording.position[at]), values)


def scatter(session: Session, asked: AskedScatter) -> ScatterReply:
    """Return calculated over measured values of a criterion on a dataset, and histograms of its errors."""
    view, recording = _dataset(session, asked.dataset)
    number = asked.criterion
    shown, lit = (_mask(view, recording, each) for each in (asked.only, asked.brush))
    errors, before = (each.errors[recording.number][number] for each in (view.now, view.start))
    measured = view.signals.values(recording, SignalName("target", str(number)))
    chosen = drawn_samples(errors, shown, lit)
    edges = common_bins([_of(errors, shown), _of(before, shown)] if asked.both else [_of(errors, shown)])
    return ScatterReply(
        sample=chosen,
        position=recording.position[chosen] - _begin(recording),
        measured=measured[chosen],
        now=measured[chosen] + errors[chosen],
        start=measured[chosen] + before[chosen],
        lit=np.zeros(chosen.size) if lit is None else lit[chosen],
        edges=edges,
        after=histogram(_of(errors, shown), edges),
        beyond=beyond(_of(errors, shown), edges),
        before=histogram(_of(before, shown), edges),
        brushed=np.zeros(0, dtype=np.int64) if lit is None else histogram(_of(errors, lit), edges),
    )


def points(session: Session, asked: AskedPoints) -> PointsReply:
    """Return signals of a dataset at samples to draw over each other."""
    view, recording = _dataset(session, asked.dataset)
    shown, lit = (_mask(view, recording, each) for each in (asked.only, asked.brush))
    errors = view.now.errors[recording.number][asked.criterion]
    most = min(asked.most, MAX_MATRIX_POINTS * 4)
    chosen = drawn_samples(errors, shown, lit, most)
    begin = _begin(recording)
    wanted = asked.signals
    missing = _missing(view, recording, wanted)
    lines = {
        str(number): view.signals.values(recording, signal)[chosen]
        for number, signal in enumerate(wanted)
        if number not in missing
    }
    flags = np.zeros(chosen.size) if lit is None else lit[chosen]
    return PointsReply(begin, flags, recording.position[chosen] - begin, lines)


def _dataset(session: Session, number: int) -> tuple[View, LiveDataset]:
    view = session.require_view()
    return view, view.model.recordings[number]


def _begin(recording: LiveDataset) -> float:
    return float(recording.position[0]) if recording.count else 0.0


def _mask(view: View, recording: LiveDataset, selection: SampleSelection | None) -> Bool | None:
    """Return the samples that a selection selects; None without one."""
    return None if selection is None else view.signals.selected(recording, selection)


def _missing(view: View, recording: LiveDataset, wanted: Sequence[SignalName]) -> dict[int, str]:
    """Return why a dataset lacks some of the signals, by their number."""
    missing = {}
    with suppress(KennfeldError):  # the reason is found again below
        view.signals.prepare(recording, wanted)
    for number, signal in enumerate(wanted):
        try:
            view.signals.envelope(recording, signal)
        except (KeyError, IndexError, ValueError):
            missing[number] = f"{recording.name} has no {signal.kind} {signal.name}"
        except KennfeldError as error:
            missing[number] = str(error)
    return missing


def _of(values: Float, chosen: Bool | None) -> Float:
    return values if chosen is None else values[chosen]
