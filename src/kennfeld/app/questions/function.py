"""The function of the project: formula text or a file of another tool, and the way from one to the other."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.app.answer import Answer, Given
from kennfeld.app.folders import free_path
from kennfeld.app.questions.esdl_program import converted as converted_program
from kennfeld.app.questions.function_files import converted as converted_function
from kennfeld.app.questions.program_files import program_files
from kennfeld.app.questions.recordings import channel_ranges
from kennfeld.app.session.function_source import completed_reference, read_called
from kennfeld.app.session.session import Session
from kennfeld.app.session.simulink_source import SimulinkSource
from kennfeld.app.session.state import Command, SetKeys, SetText, Several
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.formatting import most_similar, nearest
from kennfeld.calfiles import write as write_parameters
from kennfeld.files.file_format import Role
from kennfeld.files.formats import endings_of
from kennfeld.graph.traversal import named_lookups, named_sources
from kennfeld.models.formula import expression
from kennfeld.models.formula.functions import FUNCTIONS as FUNCTION_NAMES
from kennfeld.models.function_files import kind_of
from kennfeld.project.schema import is_esdl_file, is_simulink_file

if TYPE_CHECKING:  # half a second, for Simulink models only
    from kennfeld.importers.simulink.diagram import Diagram
    from kennfeld.importers.simulink.import_report import ImportReport
    from kennfeld.models.model import Model

SIMULINK_KEYS = ("subsystem", "parameters", "bind")  # of [model], for Simulink models only
ESDL_KEYS = ("class", "methods", "startup", "task")  # for ASCET models only
FUNCTIONS = endings_of(Role.FUNCTION)
_WORD = re.compile(r"[A-Za-z_][\w.]*")
NEW_FUNCTION = "# A line a node: name[unit] = expression\n"


def functions(session: Session, given: Given) -> Answer:
    """Return the files that can be the function: those of the project's folder, and ASCET models within it."""
    folder = session.path.parent
    known = {path.name for path in folder.iterdir() if path.suffix.lower() in FUNCTIONS}
    known |= set(program_files(folder))
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
    same = file == before and (is_simulink_file(file) or is_esdl_file(file))
    folders = () if is_esdl_file(before) and is_esdl_file(file) else ("folders",)
    keys = () if same else (*SIMULINK_KEYS, *ESDL_KEYS, *folders)
    obsolete = (name for name in keys if name in _model(session))
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
    present = str(_model(session).get("file", ""))
    if is_esdl_file(present):
        name, model, text = converted_program(session)
    elif kind_of(present) is not None:
        name, model, text = converted_function(session)
    else:
        name, model, text = _converted_diagram(session)
    file = _free_name(session, f"{Path(name).stem}.kf")
    lines = [f"# {Path(name).name}, converted by Kennfeld", *text, ""]
    initial: list[tuple[tuple[str, ...], Any]] = []
    if model.values:
        values = free_path(session.path.parent, f"{Path(file).stem}.json")
        write_parameters(model.values, values)
        initial.append((("calibration", "initial"), [values.name, *_initial_files(session)]))
    commands: list[Command] = [SetText("", file, "\n".join(lines)), _choice(session, file, *initial)]
    session.do(Several(f"Converted {name} to {file}", commands))
    return Answer({"file": file})


def _converted_diagram(session: Session) -> tuple[str, "Model", list[str]]:
    """Return the name of the Simulink model, the model, and its formula text; raises `InputError` if it is stopped."""
    from kennfeld.importers.simulink.formula_export import formula_lines

    source = _require_source(session)
    diagram = source.diagram()
    if diagram.model is None:
        raise InputError(_reasons(diagram))
    return source.file, diagram.model, [line.text for line in formula_lines(diagram.model)]


def _initial_files(session: Session) -> list[Any]:
    calibration = session.settings.get("calibration")
    files = calibration.get("initial", []) if isinstance(calibration, dict) else []
    return files if isinstance(files, list) else [files]


def _require_source(session: Session) -> SimulinkSource:
    source = SimulinkSource.of(session.settings, session.path.parent)
    if source is None:
        raise ArgumentError("the function of the project is not a Simulink model")
    return source


def diagram(session: Session, given: Given) -> Answer:
    """Return the blocks of the imported part of the Simulink model, its formula text, and what stops it."""
    from kennfeld.importers.simulink.formula_export import formula_lines

    source = _require_source(session)
    files = list(source.parameters[: len(source.parameters) - len(_initial_files(session))])
    head = {"file": source.file, "subsystem": source.subsystem, "bind": dict(source.bind)}
    refused = tuple(
        each for each in session.findings if each.severity == "error" and each.location.path == "[model] file"
    )
    if refused:
        return Answer({**head, "problems": _problems(refused)})
    try:
        own = source.diagram()
    except InputError as error:
        return Answer({**head, "problems": _problems(error.findings)})
    lines = [] if own.model is None else [asdict(line) for line in formula_lines(own.model)]
    return Answer(
        {
            **head,
            "name": own.name,
            "version": own.version,
            "blocks": [asdict(block) for block in own.blocks],
            "subsystems": list(own.subsystems),
            "lines": lines,
            "problems": _problems(own.findings),
            "files": files,
            **({} if own.report is None else _of_report(own.report, own.model)),
        }
    )


def _of_report(report: "ImportReport", model: "Model | None") -> dict[str, Any]:
    integrates = model is None or model.equations is not None  # without continuous states, no solver is used
    return {
        "total": report.total,
        "supported": report.supported,
        "unreached": len(report.unreached),
        "whole": report.whole,
        "solver": report.solver if integrates else "",
        "step": report.step,
        "blocking": [asdict(block) for block in report.unsupported if not block.undefined],
        "undefined": [
            {"name": name, "paths": list(paths), "reason": report.reasons.get(name, "")}
            for name, paths in report.undefined.items()
        ],
        "loops": [list(loop) for loop in report.loops],
        "stopped": _problems((*report.stopped, *report.missing)),
        "parameters": [asdict(parameter) for parameter in report.parameters],
        "inputs": [asdict(port) for port in report.inputs],
        "outputs": [asdict(port) for port in report.outputs],
        "notes": [*report.substitutions, *report.fixed, *(str(remark) for remark in report.remarks)],
    }


def _problems(findings: tuple[Finding, ...]) -> list[dict[str, str]]:
    return [
        {"place": finding.location.path, "message": finding.message, "remedy": finding.remedy, "text": str(finding)}
        for finding in findings
    ]


def _reasons(own: "Diagram") -> tuple[Finding, ...]:
    reasons = own.findings if own.report is None else own.report.findings
    return reasons or (Finding(Location(own.name), "the model cannot be imported"),)


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
    called = (name for each in read_called(session.settings, session.path.parent) for name in each.calls)
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


def parts(session: Session, given: Given) -> Answer:
    """Return the subsystems of the Simulink model that can be imported by themselves, largest first."""
    return Answer({"parts": [asdict(part) for part in _require_source(session).parts()]})


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
