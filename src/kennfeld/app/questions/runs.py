"""Calibration runs: start and stop, their progress, and what their results say."""

import re
from collections.abc import Mapping, Sequence
from typing import Literal, cast, get_args

import numpy as np

from kennfeld.analysis.extrapolation import Extrapolation, find_extrapolation
from kennfeld.analysis.validation_result import CrossValidation, Kind
from kennfeld.app.answer import finite
from kennfeld.app.questions.pictures import thumbnail
from kennfeld.app.session.part_fit import FittedPart
from kennfeld.app.session.run_job import Validation
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.fit.result import Result, TraceLine
from kennfeld.optimize.quality.recording_quality import of_several_files, recordings_table

FOLD = re.compile(r"fold (\d+) ")  # of a cross-validation, whose folds are drawn apart
MAX_RECORDINGS = 500  # rows that are listed


@dataclass(frozen=True)
class RunCommand:
    """A calibration from the present values.

    Attributes:
        resume: continue an interrupted run from its checkpoints.
        workers: number of processes for several starts.
        folds: cross-validate with this number of parts of the data instead.
        parts: kind of the parts.
        only: fit these values alone, with all others held.
    """

    resume: bool = False
    workers: int | None = None
    folds: int | None = None
    parts: str = "auto"
    only: FittedPart | None = None


@dataclass(frozen=True)
class StageRow:
    """A stage of a search, and the number of steps before it."""

    name: str
    begin: int


@dataclass(frozen=True)
class StartRow:
    """The search from one start: its last accepted step, or its end; and the stages that it went through."""

    start: int
    state: str
    stage: str
    iterations: int
    before: float | None
    cost: float | None
    rmse: float | None
    seconds: float
    stages: Sequence[StageRow]


@dataclass(frozen=True)
class CoarseTable:
    """A coarse picture of a table; `start` are the initial values of a curve."""

    name: str
    unit: str
    ends: Sequence[tuple[float, float]]
    values: Sequence[Sequence[float]]
    start: Sequence[Sequence[float]]


@dataclass(frozen=True)
class StepRow:
    """A step of the sequence, with the last accepted step of the search in it."""

    name: str
    state: Literal["running", "done", "waiting"]
    iterations: int
    cost: float | None
    rmse: float | None


@dataclass(frozen=True, eq=False)
class RunProgress:
    """The course of the running or last calibration; `lines` are called `rmse 0`, `cost 0`, by start."""

    starts: Sequence[StartRow]
    tables: Sequence[CoarseTable]
    steps: Sequence[StepRow]
    lines: Mapping[str, Float]


@dataclass(frozen=True)
class ShiftRow:
    """The time shift of a channel that a run has estimated."""

    dataset: str
    channel: str
    shift: float


@dataclass(frozen=True)
class SmoothnessRow:
    """Smoothness of a parameter by axis, chosen from the data."""

    parameter: str
    factors: Mapping[str, float]


@dataclass(frozen=True)
class MovedAxis:
    """Breakpoints of a free axis before and after a run."""

    axis: str
    before: Sequence[float]
    after: Sequence[float]


@dataclass(frozen=True)
class RunResult:
    """The result of a run, and its remarks.

    Attributes:
        quality: rows of text, the heading first.
        distances: start, and distance of its end from the best one.
        extrapolations: sentences on surrogates that are used outside of their data.
        seconds: by phase.
        resumed: checkpoints from which it was continued.
    """

    run: int
    status: str
    message: str
    quality: Sequence[Sequence[str]]
    distances: Sequence[tuple[int, float | None]]
    warnings: Sequence[str]
    shifts: Sequence[ShiftRow]
    smoothness: Sequence[SmoothnessRow]
    breakpoints: Sequence[MovedAxis]
    extrapolations: Sequence[str]
    free: int
    fixed: int
    iterations: int
    evaluations: int
    seconds: Mapping[str, float | None]
    resumed: Sequence[str]


@dataclass(frozen=True)
class FoldsTable:
    """A cross-validation: rows of text, the heading first, and sentences."""

    table: Sequence[Sequence[str]]
    summary: Sequence[str]


@dataclass(frozen=True)
class RunOutcome:
    """The end of the last run and of the last cross-validation.

    Attributes:
        resumable: a sentence on an interrupted run that can be resumed; empty if there is none.
        files: number of files with training data, which can be the folds of a cross-validation.
    """

    resumable: str
    result: RunResult | None
    validation: FoldsTable | None
    files: int


@dataclass(frozen=True)
class ErrorsByFile:
    """Errors of the last run by file.

    Attributes:
        rows: rows of text, the heading first.
        more: number of rows that are not listed.
        several: true if a dataset has several files.
    """

    run: int | None
    rows: Sequence[Sequence[str]]
    more: int
    several: bool


def run(session: Session, asked: RunCommand) -> None:
    """Start a calibration from the present values."""
    validation = None if asked.folds is None else _validation(asked.folds, asked.parts or "auto")
    if asked.workers is not None and asked.workers < 1:
        raise ArgumentError(f"the number of processes must be >= 1, got {asked.workers}")
    session.run(resume=asked.resume, workers=asked.workers, validation=validation, part=asked.only)


def _validation(folds: int, kind: str) -> Validation:
    if folds < 2:
        raise ArgumentError(f"the number of folds must be >= 2, got {folds}")
    if kind not in get_args(Kind):
        raise ArgumentError(f"unknown kind of folds {kind!r}")
    return Validation(folds, cast("Kind", kind))


def stop(session: Session) -> None:
    """Stop the running calibration and keep its best values."""
    session.stop()


def progress(session: Session) -> RunProgress:
    """Return the trace of the running or last calibration by start, and the tables of the best step so far."""
    view, job = session.require_view(), session.job
    lines: dict[int, list[TraceLine]] = {}
    for line in job.trace:
        fold = FOLD.match(line.stage) if job.validates else None
        lines.setdefault(line.start if fold is None else int(fold[1]), []).append(line)
    arrays = {}
    for number, own in lines.items():
        arrays[f"rmse {number}"] = np.array([line.rmse for line in own])
        arrays[f"cost {number}"] = np.array([line.cost for line in own])
    starts = [_start(session, number, own) for number, own in sorted(lines.items())]
    names = view.model.problem.free_names
    shown = {name: job.preview.get(name, view.now.parameters[name].values) for name in names}
    pictures = [_picture(view, name, values) for name, values in shown.items()]
    return RunProgress(starts, pictures, _steps(session), arrays)


def _steps(session: Session) -> list[StepRow]:
    """Return a row for each step of the sequence, with the last accepted step of the search in it."""
    job = session.job
    names = [] if session.project is None else [step.name for step in session.project.options.steps]
    titles = [name or f"step {number}" for number, name in enumerate(names, 1)]
    lines = {title: [line for line in job.trace if line.stage.startswith(f"{title}: ")] for title in titles}
    latest = job.trace[-1].stage.partition(": ")[0] if job.trace else ""
    running = job.state in ("running", "stopping")
    return [
        StepRow(
            name=title,
            state="running" if running and title == latest else "done" if lines[title] else "waiting",
            iterations=len(lines[title]),
            cost=finite(lines[title][-1].cost) if lines[title] else None,
            rmse=finite(lines[title][-1].rmse) if lines[title] else None,
        )
        for title in titles
    ]


def outcome(session: Session) -> RunOutcome:
    """Return what the command line says at the end of a run, and the last cross-validation."""
    idle = session.job.state not in ("running", "stopping")
    last = session.runs[-1].result if session.runs else None
    return RunOutcome(
        resumable=session.resumable if idle else "",
        result=None if last is None else _outcome(session, last),
        validation=None if session.validation is None else _folds(session.validation),
        files=_training_files(session),
    )


def _training_files(session: Session) -> int:
    datasets = [] if session.view is None else session.view.model.problem.datasets
    training = [data for data in datasets if data.use == "training"]
    return sum(1 if data.files is None else len(data.files.starts) for data in training)


def by_file(session: Session) -> ErrorsByFile:
    """Return the errors of the last run by file, the worst first."""
    last = session.runs[-1].result if session.runs else None
    recordings = () if last is None else last.recordings
    table = recordings_table(recordings)
    return ErrorsByFile(
        run=session.runs[-1].number if session.runs else None,
        rows=table[: 1 + MAX_RECORDINGS],
        more=max(len(table) - 1 - MAX_RECORDINGS, 0),
        several=bool(of_several_files(recordings)),
    )


def _outcome(session: Session, last: Result) -> RunResult:
    return RunResult(
        run=session.runs[-1].number,
        status=last.status,
        message=last.message,
        quality=last.table(),
        distances=[(row.start, finite(row.distance)) for row in last.starts],
        warnings=list(map(str, last.warnings)),
        shifts=[
            ShiftRow(name, channel, shift)
            for name, channels in last.shifts.items()
            for channel, shift in channels.items()
        ],
        smoothness=[SmoothnessRow(name, axes) for name, axes in last.smoothness.items()],
        breakpoints=[MovedAxis(name, old.tolist(), new.tolist()) for name, (old, new) in last.moved.items()],
        extrapolations=[str(row) for row in _extrapolation(session, session.runs[-1]) if row.worst is not None],
        free=last.free_values,
        fixed=last.fixed_values,
        iterations=last.iterations,
        evaluations=last.evaluations,
        seconds={name: finite(value) for name, value in vars(last.seconds).items()},
        resumed=last.resumed,
    )


def _extrapolation(session: Session, run: Run) -> Sequence[Extrapolation]:
    if run.extrapolation is not None:
        return run.extrapolation
    from kennfeld.optimize.tuning.shift_estimation import apply_shifts

    problem = apply_shifts(run.problem or session.require_view().model.problem, run.result.shifts)
    return find_extrapolation(problem, run.result.parameters)


def _folds(validation: CrossValidation) -> FoldsTable:
    return FoldsTable(validation.table(), [*validation.summary(), *validation.conclusions()])


def _start(session: Session, number: int, lines: Sequence[TraceLine]) -> StartRow:
    """Return a row of the table of starts; the end of a start is known from the result only."""
    ended = session.job.state not in ("running", "stopping")
    own = ended and session.runs and session.runs[-1].problem is session.job.problem
    rows = {row.start: row for row in session.runs[-1].result.starts} if own else {}
    row, last = rows.get(number), lines[-1]
    return StartRow(
        start=number,
        state=row.status if row is not None else session.job.state if ended else "running",
        stage=last.stage,
        iterations=len(lines) if row is None else row.iterations,
        before=finite(lines[0].cost if row is None else row.cost_before),
        cost=finite(last.cost if row is None else row.cost_after),
        rmse=finite(last.rmse),
        seconds=round(last.seconds, 2),
        stages=_stages(lines),
    )


def _stages(lines: Sequence[TraceLine]) -> list[StageRow]:
    """Return where the steps of a search change their stage; steps before the first change are of the first stage."""
    changes = [k for k, line in enumerate(lines) if not k or line.stage != lines[k - 1].stage]
    return [StageRow(lines[k].stage, k) for k in changes]


def _picture(view: View, name: str, values: Float) -> CoarseTable:
    table = view.start.parameters[name]
    return CoarseTable(
        name=name,
        unit=table.unit,
        ends=[(float(a.breakpoints[0]), float(a.breakpoints[-1])) for a in table.axes],
        values=thumbnail(np.asarray(values), 24),
        start=thumbnail(table.values, 24) if len(table.axes) == 1 else [],
    )
