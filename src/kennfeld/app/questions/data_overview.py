"""The data as a whole: errors by file, signals over all files, and the shift of a channel."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.session.distributions import common_bins, histogram
from kennfeld.app.session.file_lines import MAX_GAPS, FileSpan, file_line, file_spans, file_values, find_gaps
from kennfeld.app.session.session import Session
from kennfeld.app.session.shift_scan import scan_shift
from kennfeld.app.session.signals import SignalName
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, KennfeldError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.quality.recording_quality import RecordingQuality

MAX_SIGNALS = 100  # that are drawn at once
MAX_PIXELS = 4096  # of a file
BINS = 40


@dataclass(frozen=True)
class AskedErrors:
    """The errors of a criterion by file, as lines of a number of pixels."""

    criterion: int = 0
    pixels: int = 80


@dataclass(frozen=True)
class FileRow:
    """A file of a dataset that is used, with the errors of a criterion.

    Attributes:
        dataset: number of the dataset among those that are used; the first is 0.
        begin: time stamp of the first sample in s, as recorded; of data without time 0.
        samples: that are scored.
        rmse: now; `before` with the initial values.
        worst: begin, end and RMSE of the worst stretch, in s, of data without time in samples from 1 on.
        gaps: number of stretches in which a channel that the function reads is missing, and their length together.
    """

    dataset: int
    name: str
    use: str
    timed: bool
    begin: float
    end: float
    samples: int
    rmse: float | None
    before: float | None
    largest: float | None
    worst: tuple[float, float, float] | None
    gaps: tuple[int, float]


@dataclass(frozen=True)
class EstimatedShift:
    """The shift of a channel that the last run has estimated."""

    dataset: int
    channel: str
    shift: float


@dataclass(frozen=True, eq=False)
class FileErrors:
    """The errors by file.

    Attributes:
        reach: largest error of the bins of the histograms, to either side.
        lines: by number of the file least and greatest error of each pixel in turn, and `bins N` its histogram.
    """

    criterion: str
    unit: str
    files: Sequence[FileRow]
    reach: float
    shifts: Sequence[EstimatedShift]
    lines: Mapping[str, Float]


@dataclass(frozen=True)
class AskedFileLines:
    """Signals over all files, as lines of a number of pixels."""

    signals: Sequence[SignalName]
    pixels: int = 80


@dataclass(frozen=True)
class SignalFacts:
    """A signal over all files.

    Attributes:
        missing: why it cannot be drawn; empty if it can.
        gaps: by number of the file begin and end of its longest stretches without values.
    """

    name: str
    unit: str
    least: float | None
    greatest: float | None
    missing: str
    gaps: Mapping[int, Sequence[tuple[float, float]]]


@dataclass(frozen=True, eq=False)
class FileLines:
    """Signals over all files; `lines` are called `SIGNAL FILE` by their numbers."""

    signals: Sequence[SignalFacts]
    lines: Mapping[str, Float]


@dataclass(frozen=True)
class AskedScan:
    """A channel, and the criterion whose error tells its shift."""

    channel: str
    criterion: int = 0


@dataclass(frozen=True, eq=False)
class ScanReply:
    """The error over a shift of a channel beyond that of the project file, see `ShiftScan`."""

    channel: str
    criterion: str
    unit: str
    best: float
    deviation: float | None
    seen: bool
    at_the_end: bool
    samples: int
    shifts: Float
    rmse: Float


def file_errors(session: Session, asked: AskedErrors) -> FileErrors:
    """Return the errors of a criterion by file, as a run reports them, with their course and their distribution."""
    view = session.require_view()
    problem = view.model.problem
    if not 0 <= asked.criterion < len(problem.criteria):
        raise ArgumentError(f"there is no criterion {asked.criterion + 1}")
    files, node = file_spans(view), problem.criteria[asked.criterion].node
    errors = list(file_values(view, SignalName("error", str(asked.criterion)), files))
    edges, pixels = common_bins(errors, BINS), _pixels(asked.pixels)
    lines: dict[str, Float] = {}
    for number, (file, values) in enumerate(zip(files, errors, strict=True)):
        lines[str(number)] = file_line(view, file, values, pixels)
        lines[f"bins {number}"] = histogram(values, edges).astype(np.float64)
    quality = _quality(view, asked.criterion)
    return FileErrors(
        criterion=node,
        unit=view.model.unit(asked.criterion),
        files=[_row(view, file, quality.get((file.recording, file.path))) for file in files],
        reach=float(edges[-1]),
        shifts=_shifts(session, view),
        lines=lines,
    )


def _quality(view: View, criterion: int) -> dict[tuple[int, str], RecordingQuality]:
    """Return the errors that a run reports, by dataset and path; of data in partitions, those of the excerpt."""
    problem = view.model.problem
    node = problem.criteria[criterion].node
    return {
        (number, file.name): file.quality(criterion, node, data, None)
        for number, (data, sums) in enumerate(zip(problem.datasets, view.file_sums, strict=True))
        for file in sums.files
    }


def _row(view: View, file: FileSpan, row: RecordingQuality | None) -> FileRow:
    recording, problem = view.model.recordings[file.recording], view.model.problem
    dataset = recording.bound.dataset
    read = [problem.channels.get(name, name) for name in problem.model.graph.inputs]
    missing = np.zeros(file.last - file.first, dtype=bool)
    for name in read:
        if name in dataset:
            missing |= np.isnan(dataset[name].values[file.first : file.last])
    gaps = find_gaps(view, file, missing)
    worst = None if row is None else row.worst
    return FileRow(
        dataset=file.recording,
        name=file.name or recording.name,
        use=recording.use,
        timed=file.timed,
        begin=file.begin,
        end=file.end,
        samples=0 if row is None else row.samples,
        rmse=None if row is None else finite(row.rmse_after),
        before=None if row is None else finite(row.rmse_before),
        largest=None if row is None else finite(row.max_abs_after),
        worst=None if worst is None or not np.isfinite(worst.rmse) else (worst.begin, worst.end, worst.rmse),
        gaps=(len(gaps), float(sum(gap.end - gap.begin for gap in gaps))),
    )


def _shifts(session: Session, view: View) -> list[EstimatedShift]:
    last = session.last_whole_run
    shifts = {} if last is None else last.result.shifts
    return [
        EstimatedShift(recording.number, channel, shift)
        for recording in view.model.recordings
        for channel, shift in shifts.get(recording.name, {}).items()
    ]


def file_lines(session: Session, asked: AskedFileLines) -> FileLines:
    """Return signals over all files. Channels that the project does not use are read when they are first drawn."""
    view = session.require_view()
    if len(asked.signals) > MAX_SIGNALS:
        raise ArgumentError(f"{len(asked.signals)} signals at once; at most {MAX_SIGNALS} are drawn")
    files, pixels = file_spans(view), _pixels(asked.pixels)
    for recording in view.model.recordings:
        with suppress(KennfeldError):  # said of each signal below
            view.signals.prepare(recording, asked.signals)
    facts, lines = [], dict[str, Float]()
    for number, signal in enumerate(asked.signals):
        try:
            values = list(file_values(view, signal, files))
        except KennfeldError as error:
            facts.append(SignalFacts(signal.name, signal.unit, None, None, str(error), {}))
            continue
        if not any(np.isfinite(part).any() for part in values):
            facts.append(SignalFacts(signal.name, signal.unit, None, None, f"{signal.name} has no values", {}))
            continue
        for which, (file, own) in enumerate(zip(files, values, strict=True)):
            lines[f"{number} {which}"] = file_line(view, file, own, pixels)
        facts.append(_facts(view, signal, files, values))
    return FileLines(facts, lines)


def _facts(view: View, signal: SignalName, files: Sequence[FileSpan], values: Sequence[Float]) -> SignalFacts:
    known = [part[np.isfinite(part)] for part in values]
    ends = [(float(part.min()), float(part.max())) for part in known if part.size]
    gaps = {}
    for number, (file, own) in enumerate(zip(files, values, strict=True)):
        # a file without the channel has no gap in it
        is_recorded = signal.kind == "channel" and np.isfinite(own).any()
        missing = find_gaps(view, file, np.isnan(own)) if is_recorded else []
        if missing:
            gaps[number] = [(gap.begin, gap.end) for gap in missing[:MAX_GAPS]]
    return SignalFacts(
        name=signal.name,
        unit=_unit(view, signal),
        least=finite(min(low for low, _ in ends)) if ends else None,
        greatest=finite(max(high for _, high in ends)) if ends else None,
        missing="",
        gaps=gaps,
    )


def _unit(view: View, signal: SignalName) -> str:
    datasets = (recording.bound.dataset for recording in view.model.recordings)
    return next((data[signal.name].unit for data in datasets if signal.name in data), signal.unit)


def _pixels(asked: int) -> int:
    if not 2 <= asked <= MAX_PIXELS:
        raise ArgumentError(f"pixels must be from 2 to {MAX_PIXELS}, got {asked}")
    return asked


def shift_scan(session: Session, asked: AskedScan) -> ScanReply:
    """Return the error over the shift of a channel, in addition to that of the project file."""
    view = session.require_view()
    scan = scan_shift(view, asked.channel, asked.criterion)
    return ScanReply(
        channel=asked.channel,
        criterion=view.model.problem.criteria[asked.criterion].node,
        unit=view.model.unit(asked.criterion),
        best=scan.best,
        deviation=finite(scan.deviation),
        seen=scan.seen,
        at_the_end=scan.at_the_end,
        samples=scan.samples,
        shifts=scan.shifts,
        rmse=scan.rmse,
    )
