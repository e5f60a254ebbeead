"""The state that every page shows."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.questions.fixes import FixRow, fix_rows
from kennfeld.app.questions.pictures import thumbnail
from kennfeld.app.questions.recordings import used_entries
from kennfeld.app.recent import project_id
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.project_function import function_reference
from kennfeld.app.session.reference import (
    deviation_of,
    reference_set,
    reference_table,
    relative_change,
    relative_deviation,
)
from kennfeld.app.session.reference_set import ReferenceSet
from kennfeld.app.session.session import Session
from kennfeld.app.session.side_work import SideWork
from kennfeld.app.session.view import View
from kennfeld.app.wire import ABSENT, Absent
from kennfeld.base.errors import Finding, Location, Severity
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.file_format import Role
from kennfeld.files.formats import endings_of
from kennfeld.graph import Graph
from kennfeld.models.function_files import importer_of_function, split_reference
from kennfeld.models.importer_registry import importer_of

MAX_PIECES = 200  # of a dataset whose begins are drawn

Screen = Literal["data", "function", "parameters", "optimization", "results", "design"]


@dataclass(frozen=True)
class OpenProject:
    """The open project.

    Attributes:
        id: by which addresses of the page name it, and by which answers say what they are about.
        name: as the project file says it.
        path: the project file.
    """

    id: str
    name: str
    path: str


@dataclass(frozen=True)
class FindingRow:
    """A message about the project.

    Attributes:
        text: the message with its location.
        message: the message alone.
        path: place within the file: `[model] step`.
        screen: the screen on which it is solved.
        fixes: changes of the project file that solve it.
    """

    severity: Severity
    text: str
    message: str
    file: str
    line: int
    column: int
    path: str
    screen: Screen
    fixes: Sequence[FixRow]


@dataclass(frozen=True)
class UndecidedCode:
    """A file whose code, or an address that, has not been allowed."""

    file: str
    digest: str
    text: str


@dataclass(frozen=True)
class JobState:
    """The running or last calibration, or cross-validation if it `validates`."""

    state: str
    message: str
    seconds: float
    run: int
    iterations: int
    validates: bool


@dataclass(frozen=True)
class TrainingState:
    """The running or last training of a surrogate: idle, running, trained, failed or stopped."""

    state: str
    file: str
    seconds: float
    lines: Sequence[str]


@dataclass(frozen=True)
class SearchState:
    """The running or last search beside the calibration: idle, running, ended, failed or stopped.

    Attributes:
        text: what it does; why it failed.
        done: parts that are done, of `parts`; 0 if their number is not known.
        detail: what it has found, in a few words.
    """

    state: str
    text: str
    done: int
    parts: int
    seconds: float
    detail: str


@dataclass(frozen=True)
class RunRow:
    """A calibration of this session; `part` are the values that it fitted, in words, empty if all."""

    number: int
    status: str
    part: str


@dataclass(frozen=True)
class ReferenceRow:
    """The set that present values are compared with: "start", the number of a run or "file:NAME", and in words."""

    key: str
    title: str
    chosen: bool


@dataclass(frozen=True)
class ScoreRow:
    """Errors of a criterion over the datasets of a use: now, at the start, and before the last change."""

    criterion: str
    use: str
    unit: str
    samples: int
    rmse: float | None
    before: float | None
    last: float | None
    mean: float | None
    largest: float | None


@dataclass(frozen=True)
class ParameterRow:
    """A parameter of the function, with numbers of its values.

    Attributes:
        change: largest change against the reference, relative to the largest value.
        deviation: median standard deviation after the last run, relative to the span of the values; null if it is not
            known, or if most values are undetermined, which `undetermined` says.
        unused: true if no criterion depends on it, or no training sample looks it up.
    """

    name: str
    kind: str
    unit: str
    description: str
    shape: Sequence[int]
    free: bool
    changed: int
    at_bound: int
    without_data: int
    change: float | None
    deviation: float | None
    undetermined: bool
    unused: bool
    thumbnail: Sequence[Sequence[float]]


@dataclass(frozen=True)
class NamedUnit:
    """A node, channel or port with its unit."""

    name: str
    unit: str


@dataclass(frozen=True)
class DatasetRow:
    """A dataset.

    Attributes:
        number: in the project file, from 1 on; those that are off count there.
        pieces: the positions at which its pieces but the first begin.
    """

    number: int
    name: str
    use: str
    samples: int
    timed: bool
    begin: float
    end: float
    pieces: Sequence[float]
    channels: Sequence[NamedUnit]


@dataclass(frozen=True)
class CriterionRow:
    """A criterion: its node, and what that is to follow."""

    node: str
    target: str
    unit: str


@dataclass(frozen=True)
class ShownFunction:
    """The file of the function, and the screen that shows it: `formula`, or the one of its importer."""

    file: str
    screen: str


@dataclass(frozen=True)
class AppState:
    """The open project as all pages show it; numbers follow once it can be evaluated.

    Attributes:
        revision: changes with what the model shows, not with the progress of a run.
        changed_on_disk: files of the project that another program has changed, each with how.
        waiting: titles of edits that wait for the end of the run.
        text_revision: changes with the project file and the function.
        interrupted: the user has stopped the reading of the recordings, which are missing.
        excerpt: of data in partitions: samples that the screens show, and all samples; null if all are shown.
    """

    project: OpenProject
    revision: int
    text_revision: int
    unsaved: Sequence[str]
    undo: str
    redo: str
    findings: Sequence[FindingRow]
    code: Sequence[UndecidedCode]
    job: JobState
    waiting: Sequence[str]
    training: TrainingState
    terms: SearchState
    design: SearchState
    runs: Sequence[RunRow]
    seconds: float
    changed_on_disk: Sequence[str]
    recoverable: bool
    interrupted: bool
    function: ShownFunction
    nodes: Sequence[NamedUnit] | Absent = ABSENT
    inputs: Sequence[str] | Absent = ABSENT
    scores: Sequence[ScoreRow] | Absent = ABSENT
    parameters: Sequence[ParameterRow] | Absent = ABSENT
    free_values: int | Absent = ABSENT
    datasets: Sequence[DatasetRow] | Absent = ABSENT
    criteria: Sequence[CriterionRow] | Absent = ABSENT
    excerpt: tuple[int, int] | Absent | None = ABSENT
    reference: ReferenceRow | Absent = ABSENT


@dataclass(frozen=True)
class NoProject:
    """The state without an open project."""

    project: None = None


@dataclass(frozen=True)
class StateNews:
    """The state, as sent to all pages after every change."""

    state: AppState | NoProject


def overview(session: Session) -> AppState:
    """Return what all pages show of a session."""
    project, job, training = session.project, session.job, session.training
    state = AppState(
        OpenProject(project_id(session.path), project.name if project else session.path.parent.name, str(session.path)),
        session.revision,
        session.text_revision,
        session.history.titles_since(session.saved),
        session.history.undoable,
        session.history.redoable,
        [_finding(finding) for finding in session.findings],
        [UndecidedCode(each.file, each.digest, each.text) for each in session.undecided],
        JobState(job.state, job.message, round(job.seconds, 2), len(session.runs), len(job.trace), job.validates),
        [edit.title for edit in session.waiting],
        TrainingState(training.state, training.file, round(training.seconds, 1), training.lines[-12:]),
        _search(session.term_search),
        _search(session.design_work),
        [RunRow(run.number, run.result.status, run.part) for run in session.runs],
        session.seconds,
        list(map(str, session.disk_changes)),
        session.recoverable,
        session.interrupted,
        _function(session),
    )
    if session.view is not None:
        return _with_view(state, session, session.view)
    function = session.function  # is parsed each time
    if function is None:
        return state
    return replace(state, nodes=_nodes(function.graph), inputs=function.graph.inputs)


def _search(work: SideWork[Any]) -> SearchState:
    step, detail = work.step, "" if work.outcome is None else work.outcome.detail
    return SearchState(
        work.state, step.text or work.reason, step.done, step.parts, round(work.seconds, 1), detail or "not asked yet"
    )


def _function(session: Session) -> ShownFunction:
    file = function_reference(session.settings)
    importer = importer_of(split_reference(file)[0])
    return ShownFunction(file, "formula" if importer is None else importer.screen)


def _nodes(graph: Graph) -> list[NamedUnit]:
    return [NamedUnit(name, graph.units.get(name, "")) for name in graph.names]


def _with_view(state: AppState, session: Session, view: View) -> AppState:
    """Return the state of a project that can be evaluated."""
    problem = view.model.problem
    graph, reference = problem.model.graph, reference_set(session)
    return replace(
        state,
        reference=ReferenceRow(reference.key, reference.title, session.chosen_reference is not None),
        scores=_scores(session, view),
        parameters=[_parameter(session, view, name, reference) for name in graph.parameters],
        free_values=problem.free_size,
        datasets=[_dataset(*each) for each in zip(_numbers(session, view), view.model.recordings, strict=True)],
        nodes=_nodes(graph),
        criteria=[CriterionRow(c.node, str(c.target), view.model.unit(i)) for i, c in enumerate(problem.criteria)],
        inputs=[problem.channels.get(name, name) for name in graph.inputs],
        excerpt=session.excerpt,
    )


def _numbers(session: Session, view: View) -> Sequence[int]:
    """Return the numbers of the datasets in the project file, which may have other ones since it has errors."""
    numbers, count = [*used_entries(session)], len(view.model.recordings)
    return numbers if len(numbers) == count else range(1, count + 1)


def _dataset(number: int, recording: LiveDataset) -> DatasetRow:
    position = recording.position
    return DatasetRow(
        number=number,
        name=recording.name,
        use=recording.use,
        samples=recording.count,
        timed=recording.timed,
        begin=float(position[0]) if position.size else 0.0,
        end=float(position[-1]) if position.size else 1.0,
        pieces=[float(position[start]) for start in recording.starts.tolist()[1:MAX_PIECES]],
        channels=[NamedUnit(channel.name, channel.unit) for channel in recording.bound.dataset.channels],
    )


def _finding(finding: Finding) -> FindingRow:
    location = finding.location
    return FindingRow(
        severity=finding.severity,
        text=str(finding),
        message=str(replace(finding, location=Location())),
        file=location.file,
        line=location.line,
        column=location.column,
        path=location.path,
        screen=_screen_of(location),
        fixes=fix_rows(finding),
    )


RECORDINGS = endings_of(Role.RECORDING)
FUNCTIONS = (*endings_of(Role.FUNCTION), *endings_of(Role.PROGRAM))
SCREENS: Mapping[str, Screen] = {
    "dataset": "data",
    "channels": "data",
    "calculated": "data",
    "units": "data",
    "model": "function",
    "surrogates": "function",
    "functions": "function",
    "criterion": "optimization",
    "limit": "optimization",
    "equality": "optimization",
    "step": "optimization",
    "optimizer": "optimization",
    "cluster": "optimization",
    "report": "results",
    "design": "design",
}


def _screen_of(location: Location) -> Screen:
    """Return the screen on which a problem is solved."""
    if location.file.lower().endswith(FUNCTIONS) or importer_of_function(location.file) is not None:
        return "function"
    if location.file.lower().endswith(RECORDINGS) and not location.path:
        return "data"
    section = location.path.strip("[").partition("]")[0].partition(".")[0]
    return SCREENS.get(section, "parameters")


def _scores(session: Session, view: View) -> list[ScoreRow]:
    problem = view.model.problem
    # criteria or datasets may have changed since
    last = {(score.criterion, score.use): score.rmse for score in session.last if score.samples}
    comparable = len(session.last) == len(view.now.scores)
    return [
        ScoreRow(
            criterion=problem.criteria[score.criterion].node,
            use=score.use,
            unit=view.model.unit(score.criterion),
            samples=score.samples,
            rmse=finite(score.rmse),
            before=finite(view.start.scores[i].rmse),
            last=finite(last.get((score.criterion, score.use), np.nan)) if comparable else None,
            mean=finite(score.mean),
            largest=finite(score.largest),
        )
        for i, score in enumerate(view.now.scores)
    ]


def _parameter(session: Session, view: View, name: str, reference: ReferenceSet) -> ParameterRow:
    table, initial = view.now.parameters[name], reference_table(session, name, reference).values
    samples, problem = view.samples.get(name), view.model.problem
    deviation = relative_deviation(table, deviation_of(session, name))
    return ParameterRow(
        name=name,
        kind=table.kind,
        unit=table.unit,
        description=table.description,
        shape=table.values.shape,
        free=name in problem.free_names,
        changed=int(np.count_nonzero(table.values != initial)),
        at_bound=int(np.count_nonzero(table.at_bound)),
        without_data=0 if samples is None else int(np.count_nonzero(samples == 0)),
        change=finite(relative_change(table, initial)),
        deviation=None if deviation is None else finite(deviation),
        undetermined=deviation is not None and not np.isfinite(deviation),
        unused=name in problem.unscored_names or (samples is not None and not samples.any()),
        thumbnail=thumbnail(table.values),
    )
