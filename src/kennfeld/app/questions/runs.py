"""Calibration runs: start and stop, their progress, and what their results say."""

from collections.abc import Mapping, Sequence
from typing import Literal, cast, get_args

import numpy as np

from kennfeld.analysis.cross_validation import Kind
from kennfeld.analysis.extrapolation import Extrapolation, find_extrapolation
from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.app.answer import finite
from kennfeld.app.questions.parameters import AxisPoints, describe_axes
from kennfeld.app.questions.pictures import thumbnail
from kennfeld.app.session.edited_values import moved_breakpoints, with_edits
from kennfeld.app.session.live_model import Evaluation
from kennfeld.app.session.run_job import Validation
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import Result, TraceLine
from kennfeld.optimize.quality.recording_quality import of_several_files, recordings_table

MAX_CHANGES = 400  # grid points of a table that are listed
MAX_RECORDINGS = 500  # rows that are listed


@dataclass(frozen=True)
class RunCommand:
    """A calibration from the present values.

    Attributes:
        resume: continue an interrupted run from its checkpoints.
        workers: number of processes for several starts.
        folds: cross-validate with this number of parts of the data instead.
        parts: kind of the parts.
    """

    resume: bool = False
    workers: int | None = None
    folds: int | None = None
    parts: str = "auto"


@dataclass(frozen=True)
class StartRow:
    """The search from one start: its last accepted step, or its end."""

    start: int
    state: str
    stage: str
    iterations: int
    before: float | None
    cost: float | None
    rmse: float | None
    seconds: float


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
    """

    resumable: str
    result: RunResult | None
    validation: FoldsTable | None


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


@dataclass(frozen=True)
class ComparedValues:
    """Two sets of values: those of the start, of now, or of a run by its number."""

    first: str | int
    second: str | int


@dataclass(frozen=True)
class ComparedTable:
    """The difference of a table in two sets of values, in C order.

    Attributes:
        relative: largest difference, relative to the largest value.
        biggest: numbers of the values that differ, the largest difference first.
        bound: numbers of the values at a bound.
    """

    name: str
    kind: str
    unit: str
    description: str
    largest: float
    mean: float
    relative: float
    at_bound: int
    axes: Sequence[AxisPoints]
    first: Sequence[float]
    second: Sequence[float]
    biggest: Sequence[int]
    bound: Sequence[int]


@dataclass(frozen=True)
class ComparedScore:
    """Errors of a criterion with two sets of values."""

    use: str
    unit: str
    criterion: str
    first: float | None
    second: float | None
    largest: float | None


@dataclass(frozen=True)
class ValueChanges:
    """The differences of two sets of values, the relatively largest first."""

    changes: Sequence[ComparedTable]
    scores: Sequence[ComparedScore]


@dataclass(frozen=True)
class AskedChoice:
    """Values of a run: numbers of the values to take by parameter; null takes all."""

    run: int
    cells: Mapping[str, Sequence[int] | None]


@dataclass(frozen=True)
class AcceptedChoice:
    """Values of a run that are taken: their numbers by parameter; null takes all."""

    run: int
    cells: Mapping[str, Sequence[int] | None]
    title: str


@dataclass(frozen=True)
class ChoiceScore:
    """The error of a criterion with the chosen values."""

    use: str
    criterion: int
    rmse: float | None


@dataclass(frozen=True)
class ChoiceScores:
    """The errors with the chosen values; `unit` is that of the first criterion."""

    scores: Sequence[ChoiceScore]
    unit: str


def run(session: Session, asked: RunCommand) -> None:
    """Start a calibration from the present values."""
    validation = None if asked.folds is None else _validation(asked.folds, asked.parts or "auto")
    if asked.workers is not None and asked.workers < 1:
        raise ArgumentError(f"the number of processes must be >= 1, got {asked.workers}")
    session.run(resume=asked.resume, workers=asked.workers, validation=validation)


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
        lines.setdefault(line.start, []).append(line)
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
    )


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
    )


def _picture(view: View, name: str, values: Float) -> CoarseTable:
    table = view.start.parameters[name]
    return CoarseTable(
        name=name,
        unit=table.unit,
        ends=[(float(a.breakpoints[0]), float(a.breakpoints[-1])) for a in table.axes],
        values=thumbnail(np.asarray(values), 24),
        start=thumbnail(table.values, 24) if len(table.axes) == 1 else [],
    )


def compare(session: Session, asked: ComparedValues) -> ValueChanges:
    """Return the differences of two sets of values."""
    view = session.require_view()
    first, second = _evaluate(session, asked.first), _evaluate(session, asked.second)
    names = view.model.problem.model.graph.parameters
    rows = [_change(first.parameters[name], second.parameters[name]) for name in names]
    scores = [
        ComparedScore(
            use=b.use,
            unit=view.model.unit(b.criterion),
            criterion=view.model.problem.criteria[b.criterion].node,
            first=finite(a.rmse),
            second=finite(b.rmse),
            largest=finite(b.largest),
        )
        for a, b in zip(first.scores, second.scores, strict=True)
        if b.samples
    ]
    return ValueChanges(sorted(rows, key=lambda row: -row.relative), scores)


def _evaluate(session: Session, which: str | int) -> Evaluation:
    """Return the model with the values of the start, of now, or of a run."""
    view = session.require_view()
    if which == "start":
        return view.start
    return view.now if which == "now" else view.model.evaluate(_values_of_run(session, which))


def _values_of_run(session: Session, number: str | int, *, moved: bool = True) -> ParameterSet:
    """Return the parameters with the values of a run; without `moved`, interpolated to the initial breakpoints."""
    view = session.require_view()
    if not (str(number).isdigit() and 1 <= int(number) <= len(session.runs)):
        raise ArgumentError(f"there is no run {str(number)[:20]}")
    wanted = session.runs[int(number) - 1].result.parameters
    tables = {name: wanted[name] for name in view.model.problem.free_names if name in wanted}
    values = {name: table.values for name, table in tables.items()}
    own, _ = with_edits(view.start.parameters, values | (moved_breakpoints(wanted) if moved else {}), tables)
    return own


def _change(a: Parameter, b: Parameter) -> ComparedTable:
    difference = b.values - a.values
    size = np.abs(difference)
    scale = max(float(np.abs(a.values).max(initial=0.0)), float(np.abs(b.values).max(initial=0.0))) or 1.0
    order = np.argsort(-size, axis=None)[:MAX_CHANGES]
    order = order[size.ravel()[order] > 0]
    return ComparedTable(
        name=b.name,
        kind=b.kind,
        unit=b.unit,
        description=b.description,
        largest=float(size.max(initial=0.0)),
        mean=float(size.mean()),
        relative=float(size.max(initial=0.0)) / scale,
        at_bound=int(np.count_nonzero(b.at_bound)),
        axes=describe_axes(b),
        first=a.values.ravel().tolist(),
        second=b.values.ravel().tolist(),
        biggest=order.tolist(),
        bound=np.flatnonzero(b.at_bound).tolist(),
    )


def accept(session: Session, asked: AcceptedChoice) -> None:
    """Take the chosen values of a run, and those of the start elsewhere."""
    session.do(SetTables(asked.title, _chosen(session, asked)))


def choice(session: Session, asked: AskedChoice) -> ChoiceScores:
    """Return the errors that `accept` would lead to."""
    view, initial = session.require_view(), session.require_view().start.parameters
    tables = {name: values for name, values in _chosen(session, asked).items() if values is not None}
    scores = view.model.evaluate(with_edits(initial, tables, {})[0]).scores
    rows = [ChoiceScore(s.use, s.criterion, finite(s.rmse)) for s in scores if s.samples]
    return ChoiceScores(rows, view.model.unit(0))


def _chosen(session: Session, asked: AskedChoice | AcceptedChoice) -> dict[str, Float | None]:
    """Return the tables with the chosen values; None for tables that keep their start.

    Breakpoints that the run has moved are taken with all its values. Otherwise the tables keep theirs.
    """
    cells = asked.cells
    names, start = session.require_view().model.problem.free_names, session.require_view().start.parameters
    whole = all(name in cells and cells[name] is None for name in names)
    wanted = _values_of_run(session, asked.run, moved=whole)
    tables = session.values_of(wanted if whole else start, ())
    for name in names:
        if name not in cells:
            tables[name] = None
            continue
        values, chosen = start[name].values.ravel().copy(), cells[name]
        part = slice(None) if chosen is None else np.array(chosen, dtype=np.int64)
        values[part] = wanted[name].values.ravel()[part]
        tables[name] = values.reshape(start[name].values.shape)
    return tables
