"""Two sets of values side by side, and what is taken of the second one into the present values."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.questions.parameters import AxisPoints, describe_axes
from kennfeld.app.session.calibration_source import SourceName
from kennfeld.app.session.live_model import Evaluation
from kennfeld.app.session.runs import Run, ValidationRun
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.app.session.taking import evaluate_with, find_belonging, take, values_of
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.traversal import coordinates_of
from kennfeld.optimize.quality.quality import Quality

MAX_CHANGES = 400  # grid points of a table that are listed


@dataclass(frozen=True)
class SetScore:
    """RMSE of a criterion on training data and on test data; of a cross-validation, on data that were held out."""

    criterion: str
    unit: str
    training: float | None
    test: float | None


@dataclass(frozen=True)
class SetRow:
    """An entry of the history.

    Attributes:
        key: `now`, `start`, the number of a run, or empty for a cross-validation, which has no values.
        detail: in a few words.
        ended: when it ended, in s since 1970; 0 if it did not run.
        spread: of a cross-validation: standard deviation of the RMSE over the folds, by criterion.
        remark: what a cross-validation says about overfitting.
    """

    key: str
    title: str
    detail: str
    ended: float
    scores: Sequence[SetScore]
    spread: Sequence[float | None] = ()
    remark: str = ""


@dataclass(frozen=True)
class SetHistory:
    """The sets that can be compared: present values, runs and cross-validations, the last one first, and the start."""

    rows: Sequence[SetRow]


@dataclass(frozen=True)
class ComparedValues:
    """Two sets of values."""

    first: SourceName
    second: SourceName


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
    """Values of a set: numbers of the values to take by parameter, null for all; what is not named stays as it is."""

    source: SourceName
    cells: Mapping[str, Sequence[int] | None]


@dataclass(frozen=True)
class AcceptedChoice:
    """Values of a set that are taken, see `AskedChoice`."""

    source: SourceName
    cells: Mapping[str, Sequence[int] | None]
    title: str


@dataclass(frozen=True)
class ChoiceScore:
    """The error of a criterion now, and with the chosen values."""

    use: str
    criterion: str
    unit: str
    now: float | None
    then: float | None


@dataclass(frozen=True)
class MovedTogether:
    """Tables that have to be taken together.

    Attributes:
        names: the chosen ones first.
        count: number of values that change if these are taken.
        alone: error of the first criterion with the chosen tables only.
        together: with all of these.
        unit: of both.
    """

    names: Sequence[str]
    count: int
    alone: float | None
    together: float | None
    unit: str


@dataclass(frozen=True)
class ChoiceScores:
    """The errors with the chosen values, number of values that change, and the tables that belong together, if any."""

    scores: Sequence[ChoiceScore]
    count: int
    together: MovedTogether | None


def sets(session: Session) -> SetHistory:
    """Return what can be compared, each with its errors."""
    view = session.require_view()
    now = SetRow("now", "now", _since(session), 0.0, _scores(session, view.now))
    start = SetRow("start", "start", "the initial values", 0.0, _scores(session, view.start))
    ended = [
        *(_run_row(session, each) for each in session.runs),
        *(_validation_row(session, each) for each in session.validations),
    ]
    return SetHistory([now, *sorted(ended, key=lambda row: -row.ended), start])


def _since(session: Session) -> str:
    """Return in words where the present values come from."""
    now = session.parameters
    for run in reversed(session.runs):
        fitted = run.result.parameters
        if all(name in fitted and np.array_equal(fitted[name].values, now[name].values) for name in _free(session)):
            return f"run {run.number}, no edits since"
    return f"last edit: {session.history.undoable}" if session.history.undoable else "as read from the files"


def _free(session: Session) -> Sequence[str]:
    return session.require_view().model.problem.free_names


def _scores(session: Session, evaluation: Evaluation) -> list[SetScore]:
    model = session.require_view().model
    by_use = {(score.criterion, score.use): finite(score.rmse) for score in evaluation.scores}
    return [
        SetScore(each.node, model.unit(k), by_use.get((k, "training")), by_use.get((k, "test")))
        for k, each in enumerate(model.problem.criteria)
    ]


def _run_row(session: Session, run: Run) -> SetRow:
    result = run.result
    names = dict.fromkeys(row.criterion for row in result.quality)
    scores = [
        SetScore(name, _unit(session, name), *(_rmse(result.quality, name, use) for use in ("training", "test")))
        for name in names
    ]
    part = f"{run.part} only · " if run.part else ""
    detail = f"{part}{result.status} · {result.iterations} it. · {run.elapsed:.2f} s"
    return SetRow(str(run.number), f"run {run.number}", detail, run.ended, scores)


def _rmse(quality: Sequence[Quality], criterion: str, use: str) -> float | None:
    """Return the RMSE over the datasets of a use."""
    own = [row for row in quality if row.criterion == criterion and row.use == use and row.samples]
    squares = sum(row.samples * row.rmse_after**2 for row in own)
    return finite(math.sqrt(squares / sum(row.samples for row in own))) if own else None


def _unit(session: Session, criterion: str) -> str:
    model = session.require_view().model
    return next((model.unit(k) for k, each in enumerate(model.problem.criteria) if each.node == criterion), "")


def _validation_row(session: Session, own: ValidationRun) -> SetRow:
    result, folds = own.result, len({row.fold for row in own.result.folds})
    scores = [
        SetScore(name, _unit(session, name), finite(result.training(name)), finite(result.mean(name)))
        for name in result.criteria
    ]
    spread = [finite(result.spread(name)) for name in result.criteria]
    remark = " ".join(result.conclusions())
    return SetRow("", "cross-validation", f"{folds} folds", own.ended, scores, spread, remark)


def compare(session: Session, asked: ComparedValues) -> ValueChanges:
    """Return the differences of two sets of values."""
    view = session.require_view()
    first, second = _evaluate(session, asked.first), _evaluate(session, asked.second)
    graph = view.model.problem.model.graph
    rows = [
        _change(first.parameters[name], second.parameters[name], coordinates_of(graph, name))
        for name in graph.parameters
    ]
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


def _evaluate(session: Session, which: SourceName) -> Evaluation:
    """Return the model with the values of a set."""
    view = session.require_view()
    if which.from_ in ("start", "now"):
        return view.start if which.from_ == "start" else view.now
    return view.model.evaluate(values_of(session, which))


def _change(a: Parameter, b: Parameter, inputs: Sequence[str]) -> ComparedTable:
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
        axes=describe_axes(b, inputs),
        first=a.values.ravel().tolist(),
        second=b.values.ravel().tolist(),
        biggest=order.tolist(),
        bound=np.flatnonzero(b.at_bound).tolist(),
    )


def accept(session: Session, asked: AcceptedChoice) -> None:
    """Take the chosen values of a set; the others stay as they are."""
    if session.is_calibrating:
        raise ArgumentError("a calibration is running, whose values would replace these; take them at its end")
    taking = take(session, asked.source, asked.cells)
    if not taking.count:
        raise ArgumentError("the chosen values are those of now")
    session.do(SetTables(asked.title, taking.tables))


def choice(session: Session, asked: AskedChoice) -> ChoiceScores:
    """Return the errors that `accept` would lead to."""
    view, taking = session.require_view(), take(session, asked.source, asked.cells)
    then = evaluate_with(session, taking.tables) if taking.count else view.now
    problem = view.model.problem
    rows = [
        ChoiceScore(
            use=after.use,
            criterion=problem.criteria[after.criterion].node,
            unit=view.model.unit(after.criterion),
            now=finite(before.rmse),
            then=finite(after.rmse),
        )
        for before, after in zip(view.now.scores, then.scores, strict=True)
        if after.samples
    ]
    return ChoiceScores(rows, taking.count, _together(session, asked) if taking.count else None)


def _together(session: Session, asked: AskedChoice) -> MovedTogether | None:
    found = find_belonging(session, asked.source, asked.cells)
    if found is None:
        return None
    unit = session.require_view().model.unit(0)
    alone, together = (
        next((finite(score.rmse) for score in each.scores if score.use == "training"), None)
        for each in (found.alone, found.evaluation)
    )
    count = take(session, asked.source, dict.fromkeys(found.names)).count
    return MovedTogether(found.names, count, alone, together, unit)
