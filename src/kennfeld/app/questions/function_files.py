"""Functions in files of other tools: as the function of the project, and as functions that formula text calls."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

from kennfeld.app.answer import finite
from kennfeld.app.folders import confined
from kennfeld.app.questions.imported import ImportProblem, StateRow
from kennfeld.app.questions.overview import NamedUnit
from kennfeld.app.session.function_source import FunctionSource, completed_reference, has_no_functions, read_called
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.app.wire import ABSENT, Absent
from kennfeld.base.errors import ArgumentError, Finding, InputError
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.file_format import call
from kennfeld.graph.external_function import is_sequential
from kennfeld.graph.node import CLOCK
from kennfeld.models import Model
from kennfeld.models.formula.functions import FUNCTIONS, BuiltinFunction, functions_of_files
from kennfeld.models.formula.lexer import is_plain
from kennfeld.models.function_files import callable_endings, importer_of_function
from kennfeld.models.import_view import problem_views
from kennfeld.models.importer import FileFacts, FormulaLine
from kennfeld.models.model_export import formula_lines, is_formula
from kennfeld.models.model_function import ModelFunction, as_model
from kennfeld.models.quantities import CalibratableParameter, calibratable

MAX_CHARACTERS = 2_000_000  # of a source text
_KINDS = ("scalar", "curve", "map")  # by number of axes


@dataclass(frozen=True)
class NamedFunction:
    """A function in a file.

    Attributes:
        reference: the file, for some kinds with a colon and the name of the function.
        kind: what the file is; empty if it holds no functions.
        named: true if the functions of such a file have names.
        functions: those of the file.
        choices: ways in which the file can be used, if there are several.
    """

    file: str
    reference: str
    kind: str
    named: bool
    function: str
    functions: Sequence[str]
    choices: Sequence[str]


@dataclass(frozen=True)
class FunctionPort:
    """An input of a function; `later` tells that only later samples use its value."""

    name: str
    unit: str
    default: float | None
    later: bool


@dataclass(frozen=True)
class ProjectFunction(NamedFunction):
    """The function of the project in a file; what follows `problems` is known if it can be read.

    Attributes:
        source: text of the file; empty if it is not one of text.
        facts: names and texts that the file states of itself.
        runs: true if code of the file runs with the function.
    """

    source: str
    facts: Sequence[tuple[str, str]]
    whole: bool
    problems: Sequence[ImportProblem]
    inputs: Sequence[FunctionPort] | Absent = ABSENT
    outputs: Sequence[NamedUnit] | Absent = ABSENT
    parameters: Sequence[CalibratableParameter] | Absent = ABSENT
    states: Sequence[StateRow] | Absent = ABSENT
    notes: Sequence[str] | Absent = ABSENT
    step: float | Absent | None = ABSENT
    solver: str | Absent = ABSENT
    runs: bool | Absent = ABSENT
    lines: Sequence[FormulaLine] | Absent = ABSENT


@dataclass(frozen=True)
class FunctionCall:
    """The way in which formula text calls an output."""

    signature: str
    unit: str


@dataclass(frozen=True)
class CalledFunction(NamedFunction):
    """A function that formula text may call; `memory` tells if it has states, as far as it can be read."""

    name: str
    calls: Sequence[FunctionCall]
    parameters: Sequence[CalibratableParameter]
    notes: Sequence[str]
    problems: Sequence[ImportProblem]
    memory: bool | Absent = ABSENT
    runs: bool | Absent = ABSENT


@dataclass(frozen=True)
class CallableFunctions:
    """The functions that formula text may call."""

    functions: Sequence[CalledFunction]


@dataclass(frozen=True)
class FunctionsCommand:
    """Files of the folder."""

    files: Sequence[str]


@dataclass(frozen=True)
class FunctionNames:
    """The names by which formula text calls the functions of files."""

    names: Sequence[str]


@dataclass(frozen=True)
class CompletionRow:
    """A name that formula text can use, and how it is called or its unit."""

    label: str
    kind: Literal["function", "parameter", "node", "input"]
    detail: str


@dataclass(frozen=True)
class CompletionRows:
    """The names that formula text can use."""

    completions: Sequence[CompletionRow]


def function_file(session: Session) -> ProjectFunction:
    """Return the function of the project in a file of another tool: its source, ports, parameters, states, problems."""
    source = require_function(session)
    text, facts = _text(source), _facts(source)
    refused = [f for f in session.findings if f.location.path == "[model] file" and f.severity == "error"]
    try:
        function = source.read()
        model = as_model(function)
    except InputError as error:
        findings = [f for f in refused if not source.path.is_file()] or _reasons(source, error)
        return ProjectFunction(
            **_file_of(source, facts), source=text, facts=[], whole=False, problems=_problems(findings)
        )
    own = ProjectFunction(**_file_of(source, facts), source=text, facts=list(facts.rows), whole=True, problems=[])
    return replace(_with_function(own, source, function, model), states=_states(facts, model))


def _problems(findings: Sequence[Finding]) -> list[ImportProblem]:
    return [ImportProblem(**view) for view in problem_views(findings)]


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


def _lines(source: FunctionSource, model: Model) -> list[FormulaLine]:
    importer = source.importer
    return [] if importer is None else formula_lines(importer, model)


def _file_of(source: FunctionSource, facts: FileFacts) -> dict[str, Any]:
    importer = source.importer
    return {
        "file": source.file,
        "reference": source.reference,
        "kind": "" if importer is None else importer.name,
        "named": importer is not None and importer.named,
        "function": source.function,
        "functions": list(source.names),
        "choices": list(facts.choices),
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


def _with_function(
    own: ProjectFunction, source: FunctionSource, function: ModelFunction, model: Model
) -> ProjectFunction:
    return replace(
        own,
        inputs=[FunctionPort(x.name, x.unit, x.default, x.later) for x in function.inputs if x.name not in CLOCK],
        outputs=[NamedUnit(y.name, y.unit) for y in function.outputs],
        parameters=[calibratable(p) for p in function.values.parameters],
        notes=[str(remark) for remark in function.remarks],
        step=source.step or model.step,
        solver=model.solver,
        runs=source.runs,
        lines=_lines(source, model) if is_formula(model.graph) else [],
    )


def _states(facts: FileFacts, model: Model) -> list[StateRow]:
    """Return the states with their names, as far as the file states them, and their first values.

    Functions that are called over a whole trajectory keep theirs to themselves.
    """
    graph = model.equations or model.graph
    if any(is_sequential(node) for node in graph.nodes):
        return []
    nodes = [graph.nodes[state.init] for state in graph.states]
    starts = [finite(float(node.payload)) if node.op == "const" else None for node in nodes]
    names = list(facts.states)
    if len(names) != len(starts):
        names = [f"state {number}" for number in range(1, len(starts) + 1)]
    return [StateRow(name, start) for name, start in zip(names, starts, strict=True)]


def called_functions(session: Session) -> CallableFunctions:
    """Return the functions that formula text may call: how they are called, and what is wrong with them."""
    sources = FunctionSource.called(session.settings, session.path)
    return CallableFunctions([_called(source) for source in sources])


def _called(source: FunctionSource) -> CalledFunction:
    own = CalledFunction(
        **_file_of(source, _facts(source)), name=source.name, calls=[], parameters=[], notes=[], problems=[]
    )
    try:
        function = source.read()
    except InputError as error:
        return replace(own, problems=_problems(source.listing_problems or error.findings))
    units = [output.unit for output in function.outputs]
    return replace(
        own,
        calls=[FunctionCall(rule.signature, units[function.calls[rule.name]]) for rule in _rules(function)],
        memory=function.memory,
        runs=source.runs,
        parameters=[calibratable(p) for p in function.values.parameters],
        notes=[str(remark) for remark in function.remarks],
    )


def _rules(function: ModelFunction) -> Sequence[BuiltinFunction]:
    """Return how formula text calls the outputs; of the two names of a single output, the short one."""
    rules = list(functions_of_files([function]).values())
    return rules[-1:] if len(function.outputs) == 1 else rules


def add_functions(session: Session, asked: FunctionsCommand) -> FunctionNames:
    """Let formula text call the functions of files of the folder, each by a name like that of its file.

    Files of data that come with a function in C are no functions of their own.
    """
    folder = session.path.parent
    taken = {*FUNCTIONS, *_keys(session, "functions"), *_keys(session, "surrogates"), *_used(session)}
    changes: list[tuple[tuple[str, ...], Any]] = []
    files = [confined(folder, name).relative_to(folder.resolve()).as_posix() for name in asked.files]
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
    return FunctionNames(names)


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


def completions(session: Session) -> CompletionRows:
    """Return the names that formula text can use, each with its kind and how it is called or its unit."""
    return CompletionRows(list(_completions(session)))


def _completions(session: Session) -> Iterator[CompletionRow]:
    called = read_called(session.settings, session.path)
    calls = functions_of_files(called)
    for rule in (*FUNCTIONS.values(), *(rule for each in called for rule in _rules(each))):
        yield CompletionRow(rule.name, "function", rule.signature)
    for name in _keys(session, "surrogates"):
        yield CompletionRow(name, "function", "surrogate")
    function = session.function
    if function is None:
        return
    graph = function.graph
    for name, axes in graph.parameters.items():
        if name not in calls:
            yield CompletionRow(name, "parameter", _KINDS[axes] if axes < len(_KINDS) else f"{axes} axes")
    for name in graph.names:
        yield CompletionRow(name, "node", graph.units.get(name, ""))
    for name in graph.inputs:
        yield CompletionRow(name, "input", graph.units.get(name, ""))
