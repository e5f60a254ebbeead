"""The function of a project that an importer reads: what a page shows of it, and its parts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import Any, Literal

from kennfeld.app.questions import recordings
from kennfeld.app.questions.overview import NamedUnit
from kennfeld.app.session.function_source import ImportSource
from kennfeld.app.session.session import Session
from kennfeld.app.wire import ABSENT, Absent, from_json
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.file_format import call
from kennfeld.models.import_view import problem_views
from kennfeld.models.importer import FormulaLine
from kennfeld.models.model import Model
from kennfeld.models.model_export import formula_lines, is_formula
from kennfeld.models.quantities import CalibratableParameter


@dataclass(frozen=True)
class ImportChoice:
    """The part of an ASCET model that the project chooses: a class with its methods, or tasks."""

    class_: str
    methods: Sequence[str]
    tasks: Sequence[str]


@dataclass(frozen=True)
class SourceText:
    """A file of source text."""

    file: str
    text: str


@dataclass(frozen=True)
class ImportProblem:
    """A problem of an import.

    Attributes:
        source: number of the file that it is about; -1 for none.
        line: line of the file; 0 for none.
        place: place within the file, such as a block.
        text: the whole message.
    """

    source: int
    line: int
    place: str
    message: str
    remedy: str
    text: str


@dataclass(frozen=True)
class BlockRow:
    """A block of the tree; the blocks of a subsystem follow it, one level deeper.

    Attributes:
        path: path from the imported system; a slash within a name is doubled.
        inner: number of blocks directly within it.
        field: the field that says most about it, empty if there is none.
        detail: that field as written.
    """

    path: str
    name: str
    type: str
    depth: int
    inner: int
    field: str
    detail: str
    state: Literal["supported", "bound", "undefined", "unsupported", "unused", "unreached"]


@dataclass(frozen=True)
class BlockingBlock:
    """A block that is not supported; `undefined` are variables that it lacks.

    Attributes:
        needs_step: a fixed step of the function is what it lacks.
    """

    path: str
    type: str
    why: str
    remedy: str
    stops: bool
    undefined: Sequence[str]
    needs_step: bool = False


@dataclass(frozen=True)
class UndefinedVariable:
    """A variable without a value, and the blocks that use it."""

    name: str
    paths: Sequence[str]
    reason: str


@dataclass(frozen=True)
class FileProposal:
    """A file or folder that supplies what is missing, with the key of `[model]` that takes it; one of the values."""

    key: Literal["parameters", "folders"]
    values: Sequence[str]
    text: str


@dataclass(frozen=True)
class ClassChoice:
    """A class with the methods that a step can call."""

    name: str
    methods: Sequence[str]


@dataclass(frozen=True)
class TaskRow:
    """A task with its period in s and its methods."""

    name: str
    period: float | None
    methods: Sequence[str]


@dataclass(frozen=True)
class ScheduleRow:
    """A task that is imported, with its period and delay in s."""

    name: str
    period: float
    delay: float
    methods: Sequence[str]


@dataclass(frozen=True)
class StateRow:
    """A state with its first value; null if that is calculated."""

    name: str
    initial: float | None


@dataclass(frozen=True)
class SourcePlace:
    """The line at which a node or a parameter is declared, with the number of its file."""

    name: str
    source: int
    line: int


@dataclass(frozen=True)
class ImportedFunction:
    """The function of the project as its importer shows it: blocks or source text, and as far as it can be imported.

    Attributes:
        bind: channels or formulas in place of blocks.
        files: with values of variables.
        lines: formula text.
        whole: true if all of it can be imported.
        step: in s.
        total: number of blocks.
        unreached: number of blocks that no output depends on.
        proposals: files that supply what is missing.
        loops: paths of blocks that depend on each other.
        missing: names that are not declared.
        calls: methods in the order of their calls.
        data_step: of the recordings in s, if a block needs a fixed step of the function.
    """

    file: str
    subsystem: str
    bind: Mapping[str, str]
    files: Sequence[str]
    chosen: ImportChoice
    problems: Sequence[ImportProblem]
    sources: Sequence[SourceText] | Absent = ABSENT
    name: str | Absent = ABSENT
    version: str | Absent = ABSENT
    blocks: Sequence[BlockRow] | Absent = ABSENT
    subsystems: Sequence[str] | Absent = ABSENT
    lines: Sequence[FormulaLine] | Absent = ABSENT
    whole: bool | Absent = ABSENT
    step: float | Absent | None = ABSENT
    inputs: Sequence[NamedUnit] | Absent = ABSENT
    outputs: Sequence[NamedUnit] | Absent = ABSENT
    parameters: Sequence[CalibratableParameter] | Absent = ABSENT
    notes: Sequence[str] | Absent = ABSENT
    total: int | Absent = ABSENT
    supported: int | Absent = ABSENT
    unreached: int | Absent = ABSENT
    solver: str | Absent = ABSENT
    blocking: Sequence[BlockingBlock] | Absent = ABSENT
    undefined: Sequence[UndefinedVariable] | Absent = ABSENT
    proposals: Sequence[FileProposal] | Absent = ABSENT
    loops: Sequence[Sequence[str]] | Absent = ABSENT
    stopped: Sequence[ImportProblem] | Absent = ABSENT
    classes: Sequence[ClassChoice] | Absent = ABSENT
    tasks: Sequence[TaskRow] | Absent = ABSENT
    missing: Sequence[str] | Absent = ABSENT
    calls: Sequence[str] | Absent = ABSENT
    startup: Sequence[str] | Absent = ABSENT
    schedule: Sequence[ScheduleRow] | Absent = ABSENT
    states: Sequence[StateRow] | Absent = ABSENT
    places: Sequence[SourcePlace] | Absent = ABSENT
    data_step: float | Absent | None = ABSENT


@dataclass(frozen=True)
class ImportablePart:
    """A part of the file that can be imported by itself."""

    path: str
    blocks: int
    inputs: Sequence[str]
    outputs: Sequence[str]


@dataclass(frozen=True)
class ImportableParts:
    """The parts of the file that can be imported by themselves, largest first."""

    parts: Sequence[ImportablePart]


def require_import(session: Session) -> ImportSource:
    """Return the function of the project. Raises `ArgumentError` if it is formula text."""
    initial = None if session.view is None or session.stale else session.view.start.parameters
    source = ImportSource.of(session.settings, session.path, initial)
    if source is None:
        raise ArgumentError("the function of the project is not in a file of another tool")
    return source


def imported(session: Session) -> ImportedFunction:
    """Return the function of the project as its importer shows it: the source, its formula text, what stops it."""
    source = require_import(session)
    if not source.importer.view:
        raise ArgumentError(f"{source.importer.label} has no screen of its own")
    head = _head(source)
    refused = [f for f in session.findings if f.location.path == "[model] file" and f.severity == "error"]
    if refused:
        return _imported({**head, "sources": [], "problems": problem_views(refused)})
    try:
        own = _imported({**head, **call(source.importer.view, source.request, session.path.parent)})
        blocking = () if isinstance(own.blocking, Absent) else own.blocking
        return replace(own, data_step=data_step(session)) if any(each.needs_step for each in blocking) else own
    except InputError as error:
        return _imported({**head, "sources": [], "problems": problem_views(error.findings)})


def data_step(session: Session) -> float | None:
    """Return the median of the steps of the recordings in s; None if none has time stamps."""
    files = (file for entry in recordings.files(session).datasets for file in entry.files)
    steps = [file.step for file in files if isinstance(file.step, float) and file.step > 0]
    return float(f"{median(steps):.6g}") if steps else None


def _imported(view: Mapping[str, Any]) -> ImportedFunction:
    """Return the view of an importer, which may be one of another package."""
    function: ImportedFunction = from_json(ImportedFunction, view, "view")
    return function


def _head(source: ImportSource) -> dict[str, Any]:
    """Return what the project says of the import."""
    model = source.project.model
    return {
        "file": model.file,
        "subsystem": model.subsystem,
        "bind": dict(model.bind),
        "files": list(model.parameters),
        "chosen": {"class": model.class_name, "methods": list(model.methods), "tasks": list(model.task)},
    }


def parts(session: Session) -> ImportableParts:
    """Return the parts of the file that can be imported by themselves, largest first."""
    source = require_import(session)
    if not source.importer.parts:
        raise ArgumentError(f"{source.importer.label} has no parts")
    own: ImportableParts = from_json(
        ImportableParts, {"parts": call(source.importer.parts, source.request, session.path.parent)}, "view"
    )
    return own


def converted(session: Session) -> tuple[str, Model, list[FormulaLine]]:
    """Return the file of the function, its model, and its formula text; raises `InputError` with what stops it."""
    source = require_import(session)
    model = source.importer.model(source.request)
    if not is_formula(model.graph):
        raise ArgumentError(f"{source.project.model.file} cannot be written as formula text")
    return source.request.path.name, model, formula_lines(source.importer, model)
