"""The function of the project: formula text or a file of another tool, and the way from one to the other."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.app.folders import free_path
from kennfeld.app.questions.imported import converted
from kennfeld.app.questions.recordings import channel_ranges
from kennfeld.app.session.function_source import completed_reference, read_called
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import Command, SetKeys, SetText, Several
from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import most_similar, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import write as write_parameters
from kennfeld.files.file_format import Role, call
from kennfeld.files.formats import endings_of
from kennfeld.graph.traversal import named_lookups, named_sources
from kennfeld.models.formula import expression
from kennfeld.models.formula.functions import FUNCTIONS as FUNCTION_NAMES
from kennfeld.models.function_files import split_reference
from kennfeld.models.importer_registry import importer_of, importers
from kennfeld.project.forms import keys_of
from kennfeld.project.model_schema import ModelEntry

FUNCTIONS = endings_of(Role.FUNCTION)
_WORD = re.compile(r"[A-Za-z_][\w.]*")
NEW_FUNCTION = "# A line a node: name[unit] = expression\n"


@dataclass(frozen=True)
class KnownFunctions:
    """The files that can be the function, and the one that is."""

    files: Sequence[str]
    chosen: str


@dataclass(frozen=True)
class ChosenFunction:
    """A file of the folder that becomes the function."""

    file: str


@dataclass(frozen=True)
class AllowedCode:
    """Digests of files whose code may run, and of addresses that may be read."""

    digests: Sequence[str]


@dataclass(frozen=True)
class NewFormula:
    """Name and text of new formula text; empty ones are chosen."""

    name: str = ""
    text: str = ""


@dataclass(frozen=True)
class WrittenFormula:
    """The file of new formula text."""

    file: str


@dataclass(frozen=True)
class SpellingRow:
    """A word at a character of the formula text, and a known name like it."""

    line: int
    column: int
    word: str
    similar: str


@dataclass(frozen=True)
class SpellingRows:
    """Words that messages are about."""

    spellings: Sequence[SpellingRow]


@dataclass(frozen=True)
class FlowNode:
    """A node with what computes it; `kind` is that of its table, or its operation."""

    name: str
    sources: Sequence[str]
    tables: Sequence[str]
    kind: str


@dataclass(frozen=True)
class FunctionFlow:
    """The nodes of the function from inputs to outputs."""

    inputs: Sequence[str]
    nodes: Sequence[FlowNode]
    outputs: Sequence[str]


@dataclass(frozen=True)
class AskedFormula:
    """A formula over channels."""

    text: str


@dataclass(frozen=True)
class ReadChannel:
    """A channel that a formula reads, with its range if the recordings have it, else a question that offers another."""

    name: str
    least: float | None
    greatest: float | None
    known: bool
    guess: str


@dataclass(frozen=True)
class FormulaReads:
    """The channels that a formula reads, and what is wrong with it."""

    channels: Sequence[ReadChannel]
    problem: str


def functions(session: Session) -> KnownFunctions:
    """Return the files that can be the function: those of the project's folder, and ASCET models within it."""
    folder = session.path.parent
    known = {path.name for path in folder.iterdir() if path.suffix.lower() in FUNCTIONS}
    known |= {name for each in importers() if each.dropped for name in call(each.dropped.search, folder)}
    known |= {name for name in session.state.texts if name.lower().endswith(".kf")}
    return KnownFunctions(sorted(known), _model(session).get("file", ""))


def _model(session: Session) -> Mapping[str, Any]:
    model = session.settings.get("model")
    return model if isinstance(model, dict) else {}


def choose_function(session: Session, asked: ChosenFunction) -> None:
    """Use a file as the function; keys for the import of another model are removed."""
    session.do(_choice(session, completed_reference(session.path.parent, asked.file)))


def _choice(session: Session, file: str, *further: tuple[tuple[str, ...], Any]) -> SetKeys:
    before = str(_model(session).get("file", ""))
    importer = importer_of(split_reference(file)[0])
    remaining: Sequence[str] = ()
    if importer is not None and importer is importer_of(split_reference(before)[0]):
        remaining = importer.keys if file == before else importer.shared_keys
    known = keys_of(ModelEntry)
    taken = {name for each in importers() for name in each.keys if name not in remaining}
    obsolete = (name for name, part in known.items() if part.name in taken and name in _model(session))
    changes = [(("model", "file"), file), *((("model", name), None) for name in obsolete), *further]
    return SetKeys(f"The function is {file}", session.path.name, changes)


def reread_function(session: Session) -> None:
    """Read the function again, with libraries and files of values that have changed or come to its folder."""
    session.refresh()


def allow_code(session: Session, asked: AllowedCode) -> None:
    """Allow the code of files to run, now and later, and evaluate the project."""
    session.allow_code(asked.digests)


def new_function(session: Session, asked: NewFormula) -> WrittenFormula:
    """Begin formula text in a new file, and use it as the function."""
    file = _free_name(session, asked.name or "function.kf")
    text = SetText("", file, asked.text or NEW_FUNCTION)
    session.do(Several(f"New formula {file}", [text, _choice(session, file)]))
    return WrittenFormula(file)


def _free_name(session: Session, name: str) -> str:
    if not name.lower().endswith(".kf"):
        name += ".kf"
    while name in session.state.texts:
        name = f"{Path(name).stem}-2.kf"
    return free_path(session.path.parent, name).name


def convert_function(session: Session) -> WrittenFormula:
    """Turn the model of the project into formula text, and use that as the function.

    The values of its parameters are written to a file that becomes the first of the initial files.
    """
    name, model, text = converted(session)
    file = _free_name(session, f"{Path(name).stem}.kf")
    lines = [f"# {name}, converted by Kennfeld", *(line.text for line in text), ""]
    initial: list[tuple[tuple[str, ...], Any]] = []
    if model.values:
        values = free_path(session.path.parent, f"{Path(file).stem}.json")
        write_parameters(model.values, values)
        initial.append((("calibration", "initial"), [values.name, *_initial_files(session)]))
    commands: list[Command] = [SetText("", file, "\n".join(lines)), _choice(session, file, *initial)]
    session.do(Several(f"Converted {name} to {file}", commands))
    return WrittenFormula(file)


def _initial_files(session: Session) -> list[Any]:
    calibration = session.settings.get("calibration")
    files = calibration.get("initial", []) if isinstance(calibration, dict) else []
    return files if isinstance(files, list) else [files]


def spellings(session: Session) -> SpellingRows:
    """Return for the messages about a character of the formula text the word there, and a known name like it."""
    file, known = session.formula_file, _known_names(session)
    rows, lines = [], session.text_of(file).splitlines() if file else []
    places = {(f.location.line, f.location.column) for f in session.findings if f.location.file == file}
    for line, column in sorted(places):
        match = _WORD.match(lines[line - 1], column - 1) if column and line <= len(lines) else None
        similar = most_similar(match[0], known - {match[0]}) if match else ""
        if match and similar:
            rows.append(SpellingRow(line, column, match[0], similar))
    return SpellingRows(rows)


def _known_names(session: Session) -> set[str]:
    """Return the names that formula text can use: of functions, parameters, and of what it defines itself."""
    function, view = session.function, session.view
    own = () if function is None else (*function.graph.names, *function.graph.inputs)
    last = () if view is None else (*view.model.problem.model.graph.inputs, *view.model.problem.model.graph.names)
    called = (name for each in read_called(session.settings, session.path) for name in each.calls)
    return {*FUNCTION_NAMES, *called, *session.initial_names, *session.settings.get("parameters", {}), *own, *last}


KINDS = {0: "scalar", 1: "curve", 2: "map"}  # of a parameter, by its number of axes


def flow(session: Session) -> FunctionFlow:
    """Return the nodes of the function, each with what computes it: its operation or table, and its sources.

    It needs neither data nor values.
    """
    function = session.function
    if function is None:
        raise InputError(session.findings)
    graph = function.graph
    sources, lookups = named_sources(graph), named_lookups(graph)
    tables = {name: [table for table, users in lookups.items() if name in users] for name in graph.names}
    nodes = [
        FlowNode(
            name=name,
            sources=sources[name],
            tables=tables[name],
            kind=KINDS.get(graph.parameters[tables[name][0]], "cube") if tables[name] else graph.nodes[at].op,
        )
        for name, at in graph.names.items()
    ]
    return FunctionFlow(graph.inputs, nodes, graph.outputs)


def formula_reads(session: Session, asked: AskedFormula) -> FormulaReads:
    """Return the channels that a formula over channels reads, and what is wrong with it."""
    try:
        graph = expression(asked.text, Location())
    except InputError as error:
        return FormulaReads([], " ".join(map(str, error.findings)))
    return FormulaReads(list(_channels(session, graph.inputs)), "")


def _channels(session: Session, names: tuple[str, ...]) -> Iterator[ReadChannel]:
    ranges, mapped = channel_ranges(session), session.settings.get("channels", {})
    for name in names:
        channel = str(mapped.get(name, name))
        known = ranges.get(channel)
        yield ReadChannel(
            name=channel,
            least=None if known is None else known.least,
            greatest=None if known is None else known.greatest,
            known=known is not None,
            guess="" if known is not None else nearest(channel, ranges),
        )
