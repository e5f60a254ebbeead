"""Entry points of the formula compiler: text, file or single expression to a model or graph."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.file_state import note_opened
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.files.functions import recognises_surrogate
from kennfeld.graph import Graph
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.call_columns import called_in_loops
from kennfeld.graph.integration import DEFAULT_SOLVER, apply_solver, has_marks, is_continuous
from kennfeld.models.formula.functions import FUNCTIONS, functions_of, functions_of_files
from kennfeld.models.formula.lexer import Source, split
from kennfeld.models.formula.lowering import build
from kennfeld.models.formula.name_resolution import NameScope, NameTable, walk
from kennfeld.models.formula.parser import Keys, parse, parse_expression
from kennfeld.models.formula.printer import merge_equal_states
from kennfeld.models.formula.syntax import (
    Call,
    Declaration,
    Definition,
    FunctionDefinition,
    SolverDeclaration,
    Statement,
    StepDeclaration,
    Token,
)
from kennfeld.models.function_files import CallableSources, named_functions
from kennfeld.models.model import Model

if TYPE_CHECKING:
    from kennfeld.models.model_function import ModelFunction
    from kennfeld.surrogate.surrogate_file import Surrogate

_Setting = TypeVar("_Setting", StepDeclaration, SolverDeclaration)
_AXES = {"scalar": 0, "curve": 1, "map": 2, "cube": 3, "rbf": 1}
_TABLE_REMEDY = 'A table needs initial values: kf.{kind}("{name}", ...).'


def formula(
    text: str,
    name: str = "formula",
    parameters: Collection[str] | None = None,
    surrogates: Collection["Surrogate"] = (),
    *,
    functions: CallableSources = (),
) -> Model:
    """Compile formula text to a model.

    Args:
        text: statements of formula text.
        name: name of the model, and of the text in error messages.
        parameters: names of the known parameters. If None, a name that is called is a table, and a bare name is an
            input unless the text declares it as `scalar`.
        surrogates: data-driven models, called by their names.
        functions: functions by the names of their calls: a file such as "plant.fmu", "net.onnx" or "lag.c:step", a
            Python function of numbers, or a model without memory, such as one of `kf.function`.

    Returns:
        The model; its graph has a node for each name of the text.

    Raises:
        InputError: the text is wrong, or a file cannot be read; carries all findings.

    >>> model = formula("y[Nm] = Gain(n) * 2 + prev(y, 0)")
    >>> model.graph.inputs, dict(model.graph.parameters), len(model.graph.states)
    (('n',), {'Gain': 1}, 1)
    """
    called = named_functions(functions)
    scope = NameScope(parameters=parameters, owner="the start", table_remedy=_TABLE_REMEDY)
    return _model(Source.of_text(name, text), name, "formula", scope, surrogates, called)


def read(
    path: str | Path,
    parameters: Collection[str] | None = None,
    surrogates: Collection["Surrogate"] = (),
    text: str | None = None,
    functions: Collection["ModelFunction"] = (),
) -> Model:
    """Compile a `.kf` file (UTF-8) to a model; see `formula`. `text` replaces the contents of the file.

    Raises:
        InputError: the file is not UTF-8 text, or the text is wrong.
    """
    path = Path(path)
    if path.suffix.casefold() != ".kf":
        remedy = "Formula text files have the extension .kf."
        raise InputError.of(Location.of_file(path), "not a formula text file", remedy)
    source = Source.of_text(path.name, text_of(path) if text is None else text)
    return _model(source, path.stem, str(path), NameScope(parameters=parameters), surrogates, functions)


def text_of(path: Path) -> str:
    """Return the contents of a file of formula text; raises `InputError` if it is not UTF-8 text."""
    with convert_errors(path, "the file cannot be read"):
        content = path.read_bytes()
    if b"\0" in content:
        raise InputError.of(Location.of_file(path), "the file is binary, not text", "Formula text must be UTF-8.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        message = f"byte {content[error.start]:#04x} is not valid UTF-8"
        raise InputError.of(Location(path.name, line), message, "Save the file as UTF-8.") from None


def _model(
    source: Source,
    name: str,
    origin: str,
    scope: NameScope,
    surrogates: Collection["Surrogate"],
    functions: Collection["ModelFunction"],
) -> Model:
    statements = parse(source)
    calls = {**functions_of(surrogates), **functions_of_files(functions)}
    names = NameTable(statements, scope._replace(functions=calls), source)
    step = _single(StepDeclaration, "step", statements, source)
    solver = _single(SolverDeclaration, "solver", statements, source)
    builder = GraphBuilder()
    # also with findings: it reports loops and wrong arguments, and all are raised together
    nodes = build(names, builder, {})
    visible = {n: at for n, at in nodes.items() if not names.definitions[n].auxiliary}
    if not names.definitions and not source.findings:
        source.report_all("the text defines no node", "Write name[unit] = expression.")
    source.raise_findings()
    equations = merge_equal_states(builder.finish(visible, {}, tuple(names.outputs)))
    equations = replace(equations, units=_units(names, equations))
    # a declared solver counts; without one, continuous states, as functions from files have, are advanced by the
    # default
    used = DEFAULT_SOLVER if solver is None and is_continuous(equations) else "" if solver is None else solver.solver
    marked = has_marks(equations)
    graph = merge_equal_states(apply_solver(equations, used or DEFAULT_SOLVER)) if marked else equations
    return Model(
        graph=graph,
        name=name,
        step=None if step is None else step.seconds,
        declared=FrozenDict({name: names.axes.get(name, _AXES[d.kind]) for name, d in names.declared.items()}),
        source=origin,
        locations=FrozenDict(_locations(names, source)),
        surrogates=tuple(surrogate for surrogate in surrogates if surrogate.name in graph.parameters),
        equations=equations if is_continuous(equations) else None,
        solver=used,
        stepped=solver is None and bool(used),
        values=ParameterSet(p for f in functions for p in f.values.parameters if p.name in graph.parameters),
        remarks=tuple(remark for function in functions for remark in function.remarks) + _loop_remarks(graph, source),
        undeclared=names.undeclared,
    )


def declared_inputs(text: str) -> tuple[str, ...]:
    r"""Return the names that formula text declares as inputs, each by a line of its own.

    >>> declared_inputs("input n[rpm]\ny = C(n) + offset")
    ('n',)
    """
    statements = parse(Source.of_text("formula", text))
    return tuple(each.at.name for each in statements if isinstance(each, Declaration) and each.kind == "input")


def _loop_remarks(graph: Graph, source: Source) -> tuple[Finding, ...]:
    tail = "is called in a loop, so its code runs sample by sample, which is slow"
    return tuple(Finding(source.label, f"{name} {tail}", severity="remark") for name in called_in_loops(graph))


def _single(kind: type[_Setting], word: str, statements: Collection[Statement], source: Source) -> _Setting | None:
    """Return the only declaration of a kind; report others."""
    settings = [statement for statement in statements if isinstance(statement, kind)]
    for second in settings[1:]:
        source.report(second.at, f"duplicate {word}, first in {source.location(settings[0].at.line)}", "Remove one.")
    return settings[0] if settings else None


def _units(names: NameTable, graph: Graph) -> Mapping[str, str]:
    present = {**graph.names, **dict.fromkeys(graph.inputs), **graph.parameters}
    statements: dict[str, Definition | Declaration] = {**names.definitions, **names.inputs, **names.declared}
    return FrozenDict({name: s.unit for name, s in statements.items() if s.unit and name in present})


def _locations(names: NameTable, source: Source) -> dict[str, Location]:
    """Return the line of each definition and declaration, and the character at which other names are first used."""
    declared = {name: source.location(d.at.line) for name, d in {**names.inputs, **names.declared}.items()}
    used = {name: source.location(at.line, at.column) for name, at in names.uses.items()}
    defined = {name: source.location(definition.at.line) for name, definition in names.definitions.items()}
    return declared | used | defined


def extend(model: Model, nodes: Mapping[str, str], location: Location) -> Model:
    """Extend a model by nodes, each an expression over its nodes, parameters, inputs and the other new nodes.

    Names unknown to the model become inputs. The model that is passed stays as it is.

    Args:
        model: the model to extend.
        nodes: expressions by the name of the new node.
        location: of the expressions, for messages.

    Raises:
        InputError: an expression is wrong.

    >>> model = extend(formula("n = Speed(u)"), {"deviation": "abs(n_set - n)"}, Location("limit 1"))
    >>> model.graph.inputs, model.graph.outputs
    (('u', 'n_set'), ('n', 'deviation'))
    """
    graph = model.graph
    axes = {**model.declared, **graph.parameters}
    around = NameScope(graph.names, axes.keys(), axes, inputs=graph.inputs, owner=f"model {model.name}")
    builder = GraphBuilder.of(graph)
    result = _expressions(nodes, location, around, builder, graph.names)
    # states of the new nodes may equal those of the model, and are merged with them
    grown = builder.finish({**graph.names, **result}, graph.units, (*graph.outputs, *nodes))
    locations = {**model.locations, **dict.fromkeys(nodes, location)}
    return replace(model, graph=merge_equal_states(grown), locations=FrozenDict(locations))


def expression(text: str, location: Location, channels: Collection[str] | None = None) -> Graph:
    """Compile one expression over channel names to a graph with the node "value" and no parameters.

    Args:
        text: the expression.
        location: of the expression, for messages.
        channels: known channel names; any other name is then an error.

    Raises:
        InputError: the expression is wrong.

    >>> expression("air_kg_h / n_rpm * 1000", Location("kennfeld.toml", path="[calculated] rel_air")).inputs
    ('air_kg_h', 'n_rpm')
    """
    builder = GraphBuilder()
    # no channel has the empty name, so the expression may read one called "value"
    result = _expressions({"": text}, location, NameScope(parameters=(), channels=channels), builder, {})
    return merge_equal_states(builder.finish({"value": result[""]}))


def _expressions(
    texts: Mapping[str, str], whole: Location, around: NameScope, builder: GraphBuilder, known: Mapping[str, int]
) -> dict[str, int]:
    """Return the nodes of expressions by name; raises `InputError` with the findings of all."""
    lines: list[str] = []
    locations: list[Location] = []
    spans: dict[str, range] = {}
    for name, text in texts.items():
        own, location = split(text), whole if len(texts) == 1 else whole.within(name)
        spans[name] = range(len(lines) + 1, len(lines) + len(own) + 1)
        lines += own
        numbered = [Location(str(location), number) for number in range(1, len(own) + 1)]
        locations += [location] if len(own) == 1 else numbered
    # one text of all expressions, so that each can use the nodes of the others
    source = Source(whole, lines, locations)
    keys: Keys = {}
    statements = []
    for name, span in spans.items():
        # a name may be any text; column 0, as it is not part of the expression
        quoted = Token("quoted", f"%{name.replace('%', '%%')}%", span[0], 0)
        statements.append(Definition(quoted, "", parse_expression(source, span, keys)))
    nodes = build(NameTable(statements, around, source), builder, known)
    source.raise_findings()
    return nodes


def surrogates_beside(path: str | Path) -> tuple["Surrogate", ...]:
    """Read the surrogates NAME.json in the folder of a text, for each NAME that the text calls and does not define.

    Used for a text without a project, which would name its surrogates itself. Each surrogate gets the name of its file.
    A text that cannot be read has none.

    Raises:
        InputError: a surrogate file is damaged.
    """
    from kennfeld.surrogate.surrogate_file import read_surrogate

    path = Path(path)
    surrogate_files = [file for name in _names_called(path) if (file := _file(path, name)) is not None]
    return tuple(replace(read_surrogate(file), name=file.stem) for file in surrogate_files)


def _names_called(path: Path) -> Collection[str]:
    """Return the names that the text calls but does not define."""
    note_opened(path)
    try:
        source = Source.of_text(path.name, path.read_text("utf-8-sig", errors="replace"))
    except OSError:
        return ()
    statements = parse(source)
    own = {
        statement.at.name for statement in statements if not isinstance(statement, StepDeclaration | SolverDeclaration)
    }
    defining = (statement for statement in statements if isinstance(statement, Definition | FunctionDefinition))
    parts = (part for statement in defining if statement.value is not None for part in walk(statement.value))
    called = dict.fromkeys(part.name for part in parts if isinstance(part, Call))
    return [name for name in called if name not in own and name not in FUNCTIONS]


def _file(path: Path, name: str) -> Path | None:
    """Return the surrogate file of that name; None if there is none, or if it is a calibration file."""
    # a name such as %../other% must not lead to another folder
    file = path.with_name(f"{name}.json") if Path(name).name == name else path
    note_opened(file)
    if file == path or not file.is_file():
        return None
    try:
        with file.open("rb") as stream:
            # calibration files are JSON as well
            head = stream.read(200).decode("utf-8", errors="replace")
    except OSError:
        return None
    return file if recognises_surrogate(head) else None
