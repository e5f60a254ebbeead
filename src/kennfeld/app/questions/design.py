"""Designs, what to measure next: the choices, the list of segments or points, the maps of deviations, and files."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.folders import writable
from kennfeld.app.questions.existing_files import ExistingFiles
from kennfeld.app.session.design_work import DesignedTable, DesignFindings, start_design
from kennfeld.app.session.session import Session
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location, Severity
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.api import Request
from kennfeld.design.design_result import Design

FILE = "measure-next"
MAX_POINTS = 2000  # rows that are listed

DesignFormat = Literal["csv", "xlsx", "mf4", "parquet", "json"]


@dataclass(frozen=True)
class DesignParameter:
    """A free parameter; `without_data` grid points have no samples."""

    name: str
    unit: str
    values: int
    without_data: int


@dataclass(frozen=True)
class SegmentRow:
    """A piece of a recording to drive.

    Attributes:
        begin: time stamp in the file at which it begins to count, in s.
        settles: the values that it determines and the others do not.
        left: mean variance over the use after it and those before it, relative to now.
    """

    file: str
    begin: float
    end: float
    settles: str
    left: float | None


@dataclass(frozen=True)
class PointRow:
    """A steady point, with its channels in the order of the list."""

    channels: Sequence[float]
    block: int
    kind: str


@dataclass(frozen=True)
class PlannedRow:
    """A planned manoeuvre, with its duration in s."""

    name: str
    duration: float
    channels: Sequence[str]


@dataclass(frozen=True)
class DesignTableRow:
    """The standard deviations of a table now and as predicted; null if one is undetermined.

    Attributes:
        axes: number of axes; tables with one or two can be drawn.
        settled: values whose deviation falls to less than a half.
    """

    name: str
    unit: str
    axes: int
    median: tuple[float | None, float | None]
    greatest: tuple[float | None, float | None]
    settled: int


@dataclass(frozen=True)
class Remark:
    """A warning or a remark, with what to do about it."""

    severity: Severity
    message: str
    remedy: str


@dataclass(frozen=True)
class FoundDesign:
    """The outcome.

    Attributes:
        old: true if values, function or data have changed since.
        channels: of the points.
        drop: recordings that can go, the first is missed least.
        warmup: time before each segment, in s.
        factor: predicted mean variance of prediction over the use, relative to now.
        duration: of all segments with their warm-up, or of the points on the bench, in s.
        unsettled: what the design leaves open, in sentences.
        remarks: warnings and remarks.
        stopped: how many were chosen, and how many would have been; empty for a choice that has ended.
    """

    old: bool
    segments: Sequence[SegmentRow]
    points: Sequence[PointRow]
    channels: Sequence[str]
    planned: Sequence[PlannedRow]
    drop: Sequence[str]
    warmup: float
    factor: float | None
    duration: float
    sentences: Sequence[str]
    unsettled: Sequence[str]
    remarks: Sequence[Remark]
    tables: Sequence[DesignTableRow]
    formats: Sequence[DesignFormat]
    seconds: float
    stopped: Sequence[int]


@dataclass(frozen=True)
class Designs:
    """The choices of a design, and the outcome of the last one.

    Attributes:
        timed: true if the training data are recordings over time.
        memory: true if the function remembers, so that a drive settles it and points do not.
        parameters: the free ones.
        directions: sentences on joint changes that the data of the last run hardly notice, in the order of their
            numbers, the undetermined ones first.
        found: null if there is none yet.
    """

    timed: bool
    memory: bool
    parameters: Sequence[DesignParameter]
    directions: Sequence[str]
    found: FoundDesign | None


@dataclass(frozen=True)
class DesignQuestion:
    """The question of a design; what is null is chosen from the data.

    Attributes:
        reduce: find recordings that add nothing.
        keep: with `reduce`: recordings that are kept.
        candidates: recordings or points to choose from, paths or patterns.
        names: parameters that points should determine.
        direction: number of the direction that points should determine, from 1.
    """

    points: int | None = None
    segments: int | None = None
    reduce: bool = False
    keep: int | None = None
    candidates: Sequence[str] = ()
    names: Sequence[str] = ()
    direction: int | None = None


@dataclass(frozen=True)
class AskedMap:
    """A table of the last design."""

    name: str


@dataclass(frozen=True)
class DesignAxis:
    """An axis of a table."""

    input: str
    unit: str
    points: Sequence[float]


@dataclass(frozen=True, eq=False)
class DesignMap:
    """A table of the last design, and the operation over its axes.

    Attributes:
        axes: of the table.
        empty: for each value, true if no sample informs it; empty if unknown.
        ways: where the steps of each segment begin in `way_x`, or points.
        is_drive: true if the ways are drives.
        values: at the fit, in C order.
        before: standard deviation now; infinite if undetermined.
        after: as predicted.
        x: of recorded samples.
        y: the same along the second axis.
        way_x: of the segments, one after the other, or of the points.
        way_y: the same along the second axis.
    """

    name: str
    unit: str
    axes: Sequence[DesignAxis]
    empty: Sequence[bool]
    ways: Sequence[int]
    is_drive: bool
    values: Float
    before: Float
    after: Float
    x: Float
    y: Float
    way_x: Float
    way_y: Float


@dataclass(frozen=True)
class DesignExport:
    """A file of the last design; `force` replaces another one."""

    format: DesignFormat
    force: bool = False


@dataclass(frozen=True)
class WrittenDesign:
    """The file that was written, relative to the folder of the project."""

    file: str


def designs(session: Session) -> Designs:
    """Return what can be asked, and the outcome of the last design."""
    work, view = session.design_work, session.view
    findings: DesignFindings | None = work.outcome
    problem = None if view is None else view.model.problem
    last = None if session.last_whole_run is None else session.last_whole_run.result.trust
    fitted = [] if problem is None else problem.fitted_datasets
    old = work.subject != session.subject
    return Designs(
        timed=bool(fitted) and all(data.time is not None for data in fitted),
        memory=problem is not None and bool(problem.model.graph.states),
        parameters=_parameters(session),
        directions=[] if last is None else [each.sentence for each in last.directions],
        found=None if findings is None else _found(findings, old=old, seconds=work.seconds),
    )


def _parameters(session: Session) -> list[DesignParameter]:
    view = session.view
    if view is None:
        return []
    rows = []
    for name in view.model.problem.free_names:
        if name in view.now.parameters:
            table, samples = view.now.parameters[name], view.samples.get(name)
            missing = 0 if samples is None else int(np.count_nonzero(samples == 0))
            rows.append(DesignParameter(name, table.unit, table.size, missing))
    return rows


def _found(findings: DesignFindings, *, old: bool, seconds: float) -> FoundDesign:
    design = findings.design
    run = design.run
    return FoundDesign(
        old=old,
        segments=_segments(design),
        points=[]
        if run is None
        else [
            PointRow([float(values[k]) for values in run.columns.values()], int(run.block[k]), kind)
            for k, kind in enumerate(run.kind[:MAX_POINTS])
        ],
        channels=[] if run is None else list(run.columns),
        planned=[PlannedRow(t.name, float(t.time[-1]) if t.time.size else 0.0, list(t.columns)) for t in design.tables],
        drop=design.drop,
        warmup=design.warmup,
        factor=finite(design.factor),
        duration=_duration(design),
        sentences=design.sentences,
        unsettled=design.unsettled,
        # the list itself says how many of how many there are, also while further ones are being chosen
        remarks=[_remark(finding) for finding in design.findings if finding != design.stop_warning],
        tables=[_table(own) for own in findings.tables],
        formats=_formats(design),
        seconds=seconds,
        stopped=design.stopped or (),
    )


def _segments(design: Design) -> list[SegmentRow]:
    course = [*design.course, *[float("nan")] * len(design.segments)]
    return [
        SegmentRow(each.file, each.begin, each.end, each.settles, finite(variance))
        for each, variance in zip(design.segments, course, strict=False)
    ]


def _duration(design: Design) -> float:
    if design.run is not None:
        return float(design.run.ramp.sum() + design.run.wait.sum())
    return sum(each.end - each.begin + design.warmup for each in design.segments)


def _formats(design: Design) -> list[DesignFormat]:
    planned: list[DesignFormat] = ["mf4"] if design.run is not None or design.tables else []
    return ["csv", "xlsx", *planned, "parquet", "json"]


def _table(own: DesignedTable) -> DesignTableRow:
    better = own.after < 0.5 * own.before
    return DesignTableRow(
        name=own.name,
        unit=own.unit,
        axes=len(own.axes),
        median=(_quantile(own.before, 0.5), _quantile(own.after, 0.5)),
        greatest=(_quantile(own.before, 1.0), _quantile(own.after, 1.0)),
        settled=int(np.count_nonzero(better)),
    )


def _quantile(deviations: Float, share: float) -> float | None:
    """Return a value of the sorted deviations, so that undetermined ones, which are infinite, need no difference."""
    known = np.sort(deviations[~np.isnan(deviations)])
    return finite(known[round(share * (known.size - 1))]) if known.size else None


def _remark(finding: Finding) -> Remark:
    return Remark(finding.severity, finding.message, finding.remedy)


def propose_design(session: Session, asked: DesignQuestion) -> None:
    """Find out what to measure next, in a process of its own."""
    request = Request(
        n=asked.points,
        segments=asked.segments,
        reduce=asked.reduce,
        keep=asked.keep,
        names=tuple(asked.names),
        direction=asked.direction,
    )
    start_design(session, request, [name.strip() for name in asked.candidates if name.strip()])


def stop_design(session: Session) -> None:
    """Stop the work; the outcome before stays."""
    session.design_work.stop()


def design_map(session: Session, asked: AskedMap) -> DesignMap:
    """Return a table of the last design with its deviations."""
    findings = _findings(session)
    own = next((table for table in findings.tables if table.name == asked.name), None)
    if own is None:
        raise ArgumentError(f"{asked.name[:100]} is not a parameter of the design")
    lengths = [way.shape[1] for way in own.ways]
    ways = np.concatenate([_two(way) for way in own.ways], axis=1) if own.ways else np.zeros((2, 0))
    places = _two(own.places)
    return DesignMap(
        name=own.name,
        unit=own.unit,
        axes=[
            DesignAxis(name, unit, points.tolist())
            for name, unit, points in zip(own.inputs, own.units, own.axes, strict=False)
        ],
        empty=(own.samples == 0).tolist(),
        ways=np.cumsum([0, *lengths[:-1]]).tolist() if lengths else [],
        is_drive=bool(findings.design.segments),
        values=own.values,
        before=own.before,
        after=own.after,
        x=places[0],
        y=places[1],
        way_x=ways[0],
        way_y=ways[1],
    )


def _two(columns: Float) -> Float:
    """Return two rows of coordinates, those along an axis that a curve does not have being 0."""
    rows = np.zeros((2, columns.shape[1]))
    rows[: min(len(columns), 2)] = columns[:2]
    return rows


def _findings(session: Session) -> DesignFindings:
    findings: DesignFindings | None = session.design_work.outcome
    if findings is None:
        raise InputError.of(Location("design"), "nothing has been proposed yet", "Propose first.")
    return findings


def export_design(session: Session, asked: DesignExport) -> WrittenDesign | ExistingFiles:
    """Write the last design into the folder of the project; another file is replaced only with `force`."""
    design = _findings(session).design
    path = writable(session.path.parent, f"{FILE}.{asked.format}")
    if path.exists() and not asked.force:
        return ExistingFiles([path.name])
    design.save(path)
    return WrittenDesign(path.name)
