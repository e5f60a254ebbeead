"""The function of the project: formula text or a file of another tool, and the way from one to the other."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.app.answer import Answer, Given
from kennfeld.app.folders import free_path
from kennfeld.app.questions.imported import converted
from kennfeld.app.questions.recordings import channel_ranges
from kennfeld.app.session.function_source import completed_reference, read_called
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import Command, SetKeys, SetText, Several
from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import most_similar, nearest
from kennfeld.calfiles import write as write_parameters
from kennfeld.files.file_format import Role, call
from kennfeld.files.formats import endings_of
from kennfeld.graph.traversal import named_lookups, named_sources
from kennfeld.models.formula import expression
from kennfeld.models.formula.functions import FUNCTIONS as FUNCTION_NAMES
from kennfeld.models.function_files import split_reference
from kennfeld.models.importer_registry import importer_of, importers
from kennfeld.project.forms import keys_of
from kennfeld.project.schema import ModelEntry

FUNCTIONS = endings_of(Role.FUNCTION)
_WORD = re.compile(r"[A-Za-z_][\w.]*")
NEW_FUNCTION = "# A line a node: name[unit] = expression\n"


def functions(session: Session, given: Given) -> Answer:
    """Return the files that can be the function: those of the project's folder, and ASCET models within it."""
    folder = session.path.parent
    known = {path.name for path in folder.iterdir() if path.suffix.lower() in FUNCTIONS}
    known |= {name for each in importers() if each.dropped for name in call(each.dropped.search, folder)}
    known |= {name for name in session.state.texts if name.lower().endswith(".kf")}
    return Answer({"files": sorted(known), "chosen": _model(session).get("file", "")})


def _model(session: Session) -> Mapping[str, Any]:
    model = session.settings.get("model")
    return model if isinstance(model, dict) else {}


def choose_function(session: Session, given: Given) -> Answer:
    """Use a `file` as the function; keys for the import of another model are removed."""
    session.do(_choice(session, completed_reference(session.path.parent, str(given["file"]))))
    return Answer()


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


def reread_function(session: Session, given: Given) -> Answer:
    """Read the function again, with libraries and files of values that have changed or come to its folder."""
    session.refresh()
    return Answer()


def allow_code(session: Session, given: Given) -> Answer:
    """Allow the code of files with these `digests` to run, now and later, and evaluate the project."""
    session.allow_code([str(digest) for digest in given["digests"]])
    return Answer()


def new_function(session: Session, given: Given) -> Answer:
    """Begin formula text in a new file `name`, and use it as the function."""
    file = _free_name(session, str(given.get("name") or "function.kf"))
    text = SetText("", file, str(given.get("text") or NEW_FUNCTION))
    session.do(Several(f"New formula {file}", [text, _choice(session, file)]))
    return Answer({"file": file})


def _free_name(session: Session, name: str) -> str:
    if not name.lower().endswith(".kf"):
        name += ".kf"
    while name in session.state.texts:
        name = f"{Path(name).stem}-2.kf"
    return free_path(session.path.parent, name).name


def convert_function(session: Session, given: Given) -> Answer:
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
    return Answer({"file": file})


def _initial_files(session: Session) -> list[Any]:
    calibration = session.settings.get("calibration")
    files = calibration.get("initial", []) if isinstance(calibration, dict) else []
    return files if isinstance(files, list) else [files]


def spellings(session: Session, given: Given) -> Answer:
    """Return for the messages about a character of the formula text the word there, and a known name like it."""
    file, known = session.formula_file, _known_names(session)
    rows, lines = [], session.text_of(file).splitlines() if file else []
    places = {(f.location.line, f.location.column) for f in session.findings if f.location.file == file}
    for line, column in sorted(places):
        match = _WORD.match(lines[line - 1], column - 1) if column and line <= len(lines) else None
        similar = most_similar(match[0], known - {match[0]}) if match else ""
        if match and similar:
            rows.append({"line": line, "column": column, "word": match[0], "similar": similar})
    return Answer({"spellings": rows})


def _known_names(session: Session) -> set[str]:
    """Return the names that formula text can use: of functions, parameters, and of what it defines itself."""
    function, view = session.function, session.view
    own = () if function is None else (*function.graph.names, *function.graph.inputs)
    last = () if view is None else (*view.model.problem.model.graph.inputs, *view.model.problem.model.graph.names)
    called = (name for each in read_called(session.settings, session.path) for name in each.calls)
    return {*FUNCTION_NAMES, *called, *session.initial_names, *session.settings.get("parameters", {}), *own, *last}


def flow(session: Session, given: Given) -> Answer:
    """Return the nodes of the function, each with what computes it: its operation or table, and its sources."""
    problem = session.require_view().model.problem
    graph, parameters = problem.model.graph, problem.parameters
    sources, lookups = named_sources(graph), named_lookups(graph)
    tables = {name: [table for table, users in lookups.items() if name in users] for name in graph.names}
    nodes = [
        {
            "name": name,
            "sources": sources[name],
            "tables": tables[name],
            "kind": parameters[tables[name][0]].kind if tables[name] else graph.nodes[at].op,
        }
        for name, at in graph.names.items()
    ]
    return Answer({"inputs": list(graph.inputs), "nodes": nodes, "outputs": list(graph.outputs)})


def formula_reads(session: Session, given: Given) -> Answer:
    """Return the channels that a formula `text` over channels reads, and what is wrong with it."""
    try:
        graph = expression(str(given["text"]), Location())
    except InputError as error:
        return Answer({"channels": [], "problem": " ".join(map(str, error.findings))})
    return Answer({"channels": list(_channels(session, graph.inputs)), "problem": ""})


def _channels(session: Session, names: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    ranges, mapped = channel_ranges(session), session.settings.get("channels", {})
    for name in names:
        channel = str(mapped.get(name, name))
        known = ranges.get(channel)
        yield {
            "name": channel,
            "least": known and known.least,
            "greatest": known and known.greatest,
            "known": known is not None,
            "guess": "" if known is not None else nearest(channel, ranges),
        }
