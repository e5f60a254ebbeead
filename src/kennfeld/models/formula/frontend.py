"""The ways from text to a model or a graph.

The data-driven models that lie beside a formula text and that it calls.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from kennfeld.errors import InputError
from kennfeld.graph import Graph
from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.formula.functions import FUNCTIONS, BuiltinFunction
from kennfeld.models.formula.lexer import Source, split
from kennfeld.models.formula.lowering import build
from kennfeld.models.formula.name_resolution import NameScope, NameTable, walk
from kennfeld.models.formula.parser import Keys, parse, parse_expression
from kennfeld.models.formula.printer import merged
from kennfeld.models.formula.syntax import (
    Call,
    Declaration,
    Definition,
    FunctionDefinition,
    Statement,
    StepDeclaration,
    Token,
)
from kennfeld.models.model import Model

if TYPE_CHECKING:
    from kennfeld.surrogate import Surrogate

__all__ = ["expression", "extend", "formula", "read", "surrogates_beside", "text_of"]


def formula(
    text: str,
    name: str = "formula",
    parameters: Collection[str] | None = None,
    surrogates: "Collection[Surrogate]" = (),
) -> Model:
    """The model that a formula text describes.

    `parameters` are the names of the known parameters. Without them, what is called like a function is a table,
    and a bare name is an input unless the text declares it as `scalar`. `surrogates` are called by their names.
    Raises `InputError` with every finding of the text.

    >>> model = formula("y[Nm] = Gain(n) * 2 + prev(y, 0)")
    >>> model.graph.inputs, dict(model.graph.parameters), len(model.graph.states)
    (('n',), {'Gain': 1}, 1)
    """
    return _model(Source.of_text(name, text), name, "formula", parameters, surrogates)


def read(
    path: str | Path, parameters: Collection[str] | None = None, surrogates: "Collection[Surrogate]" = ()
) -> Model:
    """The model in a `.kf` file (UTF-8); raises `InputError` like `formula`, and where the file is no text."""
    path = Path(path)
    if path.suffix.casefold() != ".kf":
        raise InputError.of(str(path), "this is no formula text", "Formula text is in files that end in .kf.")
    return _model(Source.of_text(path.name, text_of(path)), path.stem, str(path), parameters, surrogates)


def text_of(path: Path) -> str:
    """The characters of a file of formula text; raises `InputError` where it is no text in UTF-8."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError.of(str(path), f"the file cannot be read: {error.strerror or error}") from None
    if b"\0" in content:
        raise InputError.of(str(path), "this is no text but a binary file", "Formula text is UTF-8 text.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        message = f"byte {content[error.start]:#04x} is no UTF-8"
        raise InputError.of(f"{path.name} line {line}", message, "Save the file as UTF-8.") from None


def _model(
    source: Source, name: str, origin: str, parameters: Collection[str] | None, surrogates: "Collection[Surrogate]"
) -> Model:
    statements = parse(source)
    names = NameTable(statements, NameScope(parameters=parameters, functions=_called(surrogates)), source)
    step = _step(statements, source)
    builder = GraphBuilder()
    nodes = build(names, builder, {})
    visible = {n: at for n, at in nodes.items() if not names.definitions[n].auxiliary}
    if not names.definitions and not source.findings:
        source.report_all("the text defines no node", "Write name[unit] = expression.")
    source.raise_findings()
    graph = merged(builder.finish(visible, {}, tuple(names.outputs)))
    return Model(
        graph=replace(graph, units=_units(names, graph)),
        name=name,
        step=step,
        declared=MappingProxyType(_declared(names)),
        source=origin,
        places=MappingProxyType(_places(names, source)),
        surrogates=tuple(surrogate for surrogate in surrogates if surrogate.name in graph.parameters),
    )


def _called(surrogates: "Collection[Surrogate]") -> Mapping[str, BuiltinFunction]:
    if not surrogates:
        return {}
    from kennfeld.models.formula.functions import functions_of  # most texts call none

    return functions_of(surrogates)


def _step(statements: Collection[Statement], source: Source) -> float | None:
    found = [statement for statement in statements if isinstance(statement, StepDeclaration)]
    for second in found[1:]:
        source.report(second.at, f"step stands already in {source.place(found[0].at.line)}", "Remove one.")
    return found[0].seconds if found else None


def _units(names: NameTable, graph: Graph) -> Mapping[str, str]:
    present = {**graph.names, **dict.fromkeys(graph.inputs), **graph.parameters}
    statements: list[tuple[str, Definition | Declaration]] = [
        *names.definitions.items(),
        *names.inputs.items(),
        *names.declared.items(),
    ]
    return MappingProxyType({name: s.unit for name, s in statements if s.unit and name in present})


def _declared(names: NameTable) -> dict[str, int]:
    axes = {"scalar": 0, "curve": 1, "map": 2, "cube": 3, "rbf": 1}
    return {name: names.axes.get(name, axes[found.kind]) for name, found in names.declared.items()}


def _places(names: NameTable, source: Source) -> dict[str, str]:
    declared = {name: found.at for name, found in (*names.inputs.items(), *names.declared.items())}
    defined = {name: found.at for name, found in names.definitions.items()}
    return {name: source.place(at.line) for name, at in {**declared, **names.uses, **defined}.items()}


def extend(model: Model, nodes: Mapping[str, str], place: str) -> Model:
    """The model with further nodes, each an expression over its nodes, parameters and inputs, and over each other.

    A name that the model does not know is a further input. `place` says in findings where the expressions stand.

    >>> model = extend(formula("n = Speed(u)"), {"deviation": "abs(n_set - n)"}, "kennfeld.toml limit 1")
    >>> model.graph.inputs, model.graph.outputs
    (('u', 'n_set'), ('n', 'deviation'))
    """
    graph = model.graph
    axes = {**model.declared, **graph.parameters}
    around = NameScope(graph.names, axes.keys(), axes, inputs=graph.inputs, owner=f"model {model.name}")
    builder = GraphBuilder.of(graph)
    assert isinstance(builder, GraphBuilder)
    made = _expressions(nodes, place, around, builder, graph.names)
    grown = builder.finish({**graph.names, **made}, graph.units, (*graph.outputs, *nodes))
    places = {**model.places, **dict.fromkeys(nodes, place)}
    return replace(model, graph=merged(grown), places=MappingProxyType(places))


def expression(text: str, place: str, channels: Collection[str] | None = None) -> Graph:
    """The graph of one expression over channel names, called "value"; it has no parameters.

    With `channels`, a name that is none of them is an error.

    >>> expression("air_kg_h / n_rpm * 1000", "kennfeld.toml [calculated] rel_air").inputs
    ('air_kg_h', 'n_rpm')
    """
    builder = GraphBuilder()
    # no channel has the empty name, so the expression may read one called "value"
    made = _expressions({"": text}, place, NameScope(parameters=(), channels=channels), builder, {})
    return merged(builder.finish({"value": made[""]}))


def _expressions(
    texts: Mapping[str, str], place: str, around: NameScope, builder: GraphBuilder, known: Mapping[str, int]
) -> dict[str, int]:
    """The nodes of expressions by name; raises what is wrong with any of them."""
    lines: list[str] = []
    places: list[str] = []
    spans: dict[str, range] = {}
    for name, text in texts.items():
        own, label = split(text), place if len(texts) == 1 else f"{place} {name}"
        spans[name] = range(len(lines) + 1, len(lines) + len(own) + 1)
        lines += own
        places += [label] if len(own) == 1 else [f"{label} line {number + 1}" for number in range(len(own))]
    source = Source(place, lines, places)
    keys: Keys = {}
    names = NameTable(
        [
            Definition(Token("quoted", _quoted(name), span[0], 0), "", parse_expression(source, span, keys))
            for name, span in spans.items()
        ],
        around,
        source,
    )
    nodes = build(names, builder, known)
    source.raise_findings()
    return nodes


def _quoted(name: str) -> str:
    return f"%{name.replace('%', '%%')}%"


def surrogates_beside(path: str | Path) -> "tuple[Surrogate, ...]":
    """The surrogates in files NAME.json beside a text, where the text calls NAME and does not declare it as a table.

    A project says itself where its surrogates are; this is for a text alone. Each has the name of its file. Raises
    `InputError` where such a file is damaged; a text that cannot be read calls none.
    """
    path = Path(path)
    found = [file for name in _names_called(path) if (file := _file(path, name)) is not None]
    if not found:
        return ()
    from dataclasses import replace

    from kennfeld.surrogate import read_surrogate

    return tuple(replace(read_surrogate(file), name=file.stem) for file in found)


def _names_called(path: Path) -> Collection[str]:
    """What the text calls and defines nowhere."""
    try:
        source = Source.of_text(path.name, path.read_text("utf-8-sig", errors="replace"))
    except OSError:
        return ()
    statements = parse(source)
    own = {one.at.name for one in statements if isinstance(one, Declaration | FunctionDefinition | Definition)}
    written = [
        one.value for one in statements if isinstance(one, Definition | FunctionDefinition) and one.value is not None
    ]
    called = dict.fromkeys(part.name for value in written for part in walk(value) if isinstance(part, Call))
    return [name for name in called if name not in own and name not in FUNCTIONS]


def _file(path: Path, name: str) -> Path | None:
    """The file of a surrogate of that name, None where there is none; a calibration file is none."""
    file = path.with_name(f"{name}.json") if Path(name).name == name else path
    if file == path or not file.is_file():
        return None
    from kennfeld.surrogate import recognises_surrogate

    try:
        with file.open("rb") as stream:
            head = stream.read(200).decode("utf-8", errors="replace")
    except OSError:
        return None
    return file if recognises_surrogate(head) else None
