"""Functions in files of other tools: as the function of the project, and as functions that formula text calls."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.folders import confined
from kennfeld.app.session.function_source import FunctionSource, completed_reference, has_no_functions, read_called
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.base.errors import ArgumentError, Finding, InputError
from kennfeld.base.formatting import join_names
from kennfeld.files.file_format import call
from kennfeld.graph.external_function import is_sequential
from kennfeld.graph.node import CLOCK
from kennfeld.models import Model
from kennfeld.models.formula.functions import FUNCTIONS, BuiltinFunction, functions_of_files
from kennfeld.models.formula.lexer import is_plain
from kennfeld.models.function_files import callable_endings, importer_of_function
from kennfeld.models.import_view import problem_views
from kennfeld.models.importer import FileFacts
from kennfeld.models.model_export import formula_lines, is_formula
from kennfeld.models.model_function import ModelFunction, as_model
from kennfeld.models.quantities import calibratable

MAX_CHARACTERS = 2_000_000  # of a source text
_KINDS = ("scalar", "curve", "map")  # by number of axes


def function_file(session: Session, given: Given) -> Answer:
    """Return the function of the project in a file of another tool: its source, ports, parameters, states, problems."""
    source = require_function(session)
    head = {**_file_of(source), "source": _text(source), "facts": []}
    refused = [f for f in session.findings if f.location.path == "[model] file" and f.severity == "error"]
    try:
        function = source.read()
        model = as_model(function)
        head["facts"] = list(_facts(source).rows)
    except InputError as error:
        findings = [f for f in refused if not source.path.is_file()] or _reasons(source, error)
        return Answer({**head, "whole": False, "problems": problem_views(findings)})
    return Answer({**head, **_of_function(source, function, model), "whole": True, "problems": []})


def _reasons(source: FunctionSource, error: InputError) -> Sequence[Finding]:
    """Return what has to be solved so that a function can be read; empty if it has to be chosen only."""
    if source.importer is not None and source.importer.named and not source.function:
        return source.listing_problems
    return error.findings


def require_function(session: Session) -> FunctionSource:
    """Return the function of the project. Raises `ArgumentError` if it is not in a file of another tool."""
    source = FunctionSource.of(session.settings, session.path)
    if source is None:
        raise ArgumentError("the function of the project is not in a file of functions")
    return source


def _lines(source: FunctionSource, model: Model) -> list[dict[str, str]]:
    importer = source.importer
    return [] if importer is None else [asdict(line) for line in formula_lines(importer, model)]


def _file_of(source: FunctionSource) -> dict[str, Any]:
    importer = source.importer
    return {
        "file": source.file,
        "reference": source.reference,
        "kind": "" if importer is None else importer.name,
        "named": importer is not None and importer.named,
        "function": source.function,
        "functions": list(source.names),
        "choices": list(_facts(source).choices),
    }


def _facts(source: FunctionSource) -> FileFacts:
    """Return what the file says of itself; nothing if it cannot be read."""
    if source.importer is None or not source.importer.facts:
        return FileFacts()
    try:
        facts: FileFacts = call(source.importer.facts, source.path)
    except InputError:
        return FileFacts()
    return facts


def _text(source: FunctionSource) -> str:
    if source.importer is None or not source.importer.is_text:
        return ""
    try:
        text = source.path.read_text("utf-8-sig", errors="replace")
    except OSError:
        return ""
    return text if len(text) <= MAX_CHARACTERS else ""


def _of_function(source: FunctionSource, function: ModelFunction, model: Model) -> dict[str, Any]:
    return {
        "inputs": [x._asdict() for x in function.inputs if x.name not in CLOCK],
        "outputs": [y._asdict() for y in function.outputs],
        "parameters": [asdict(calibratable(p)) for p in function.values.parameters],
        "states": _states(source, model),
        "notes": [str(remark) for remark in function.remarks],
        "step": source.step or model.step,
        "solver": model.solver,
        "runs": source.runs,
        "lines": _lines(source, model) if is_formula(model.graph) else [],
    }


def _states(source: FunctionSource, model: Model) -> list[dict[str, Any]]:
    """Return the states with their names, as far as the file states them, and their first values.

    Functions that are called over a whole trajectory keep theirs to themselves.
    """
    graph = model.equations or model.graph
    if any(is_sequential(node) for node in graph.nodes):
        return []
    nodes = [graph.nodes[state.init] for state in graph.states]
    starts = [finite(float(node.payload)) if node.op == "const" else None for node in nodes]
    names = list(_facts(source).states)
    if len(names) != len(starts):
        names = [f"state {number}" for number in range(1, len(starts) + 1)]
    return [{"name": name, "initial": start} for name, start in zip(names, starts, strict=True)]


def called_functions(session: Session, given: Given) -> Answer:
    """Return the functions that formula text may call: how they are called, and what is wrong with them."""
    sources = FunctionSource.called(session.settings, session.path)
    return Answer({"functions": [{"name": source.name, **_file_of(source), **_calls(source)} for source in sources]})


def _calls(source: FunctionSource) -> dict[str, Any]:
    try:
        function = source.read()
    except InputError as error:
        findings = source.listing_problems or error.findings
        return {"calls": [], "parameters": [], "notes": [], "problems": problem_views(findings)}
    units = [output.unit for output in function.outputs]
    rules = _rules(function)
    return {
        "calls": [{"signature": rule.signature, "unit": units[function.calls[rule.name]]} for rule in rules],
        "memory": function.memory,
        "runs": source.runs,
        "parameters": [asdict(calibratable(p)) for p in function.values.parameters],
        "notes": [str(remark) for remark in function.remarks],
        "problems": [],
    }


def _rules(function: ModelFunction) -> Sequence[BuiltinFunction]:
    """Return how formula text calls the outputs; of the two names of a single output, the short one."""
    rules = list(functions_of_files([function]).values())
    return rules[-1:] if len(function.outputs) == 1 else rules


def add_functions(session: Session, given: Given) -> Answer:
    """Let formula text call the functions of `files` of the folder, each by a name like that of its file.

    Files of data that come with a function in C are no functions of their own.
    """
    folder = session.path.parent
    taken = {*FUNCTIONS, *_keys(session, "functions"), *_keys(session, "surrogates"), *_used(session)}
    changes: list[tuple[tuple[str, ...], Any]] = []
    files = [confined(folder, str(name)).relative_to(folder.resolve()).as_posix() for name in given["files"]]
    for file in files:
        if importer_of_function(file) is None:
            raise ArgumentError(f"{file} holds no functions; use {join_names(callable_endings(), 99, ' or ')}")
    for file in [each for each in files if not has_no_functions(folder / each)] or files:
        name = _free_name(file, taken)
        taken.add(name)
        changes.append((("functions", name), completed_reference(folder, file)))
    names = [path[-1] for path, _ in changes]
    if changes:
        session.do(SetKeys(f"{', '.join(names)} can be called", session.path.name, changes))
    return Answer({"names": names})


def _keys(session: Session, section: str) -> list[str]:
    table = session.settings.get(section)
    return list(table) if isinstance(table, dict) else []


def _used(session: Session) -> list[str]:
    """Return the names of nodes, inputs and parameters."""
    graph = None if session.function is None else session.function.graph
    return [] if graph is None else [*graph.names, *graph.inputs, *graph.parameters]


def _free_name(file: str, taken: set[str]) -> str:
    """Return a name for the function of a file that formula text can call and that is not taken."""
    stem = file.rpartition("/")[2].rpartition(".")[0]
    plain = "".join(letter if letter.isalnum() else "_" for letter in stem).strip("_")
    plain = plain if is_plain(plain) else f"f_{plain}".rstrip("_")
    name, number = plain, 2
    while name in taken:
        name, number = f"{plain}{number}", number + 1
    return name


def completions(session: Session, given: Given) -> Answer:
    """Return the names that formula text can use, each with its kind and how it is called or its unit."""
    return Answer({"completions": [{"label": n, "kind": k, "detail": d} for n, k, d in _completions(session)]})


def _completions(session: Session) -> Iterator[tuple[str, str, str]]:
    called = read_called(session.settings, session.path)
    calls = functions_of_files(called)
    for rule in (*FUNCTIONS.values(), *(rule for each in called for rule in _rules(each))):
        yield rule.name, "function", rule.signature
    for name in _keys(session, "surrogates"):
        yield name, "function", "surrogate"
    function = session.function
    if function is None:
        return
    graph = function.graph
    for name, axes in graph.parameters.items():
        if name not in calls:
            yield name, "parameter", _KINDS[axes] if axes < len(_KINDS) else f"{axes} axes"
    for kind, names in (("node", graph.names), ("input", graph.inputs)):
        for name in names:
            yield name, kind, graph.units.get(name, "")
