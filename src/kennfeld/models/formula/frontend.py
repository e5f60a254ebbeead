"""The ways from text to a model or a graph."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from kennfeld.errors import InputError
from kennfeld.graph import Graph
from kennfeld.models.formula.build import build
from kennfeld.models.formula.functions import Function, Loom
from kennfeld.models.formula.names import Names, Surroundings
from kennfeld.models.formula.parser import Keys, parse, parse_expression
from kennfeld.models.formula.source import Source, split
from kennfeld.models.formula.states import merged
from kennfeld.models.formula.syntax import Declaration, Definition, Statement, Step, Token
from kennfeld.models.model import Model

if TYPE_CHECKING:
    from kennfeld.surrogate import Surrogate

__all__ = ["expression", "extend", "formula", "read", "text_of"]


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
        what = f"byte {content[error.start]:#04x} is no UTF-8"
        raise InputError.of(f"{path.name} line {line}", what, "Save the file as UTF-8.") from None


def _model(
    source: Source, name: str, origin: str, parameters: Collection[str] | None, surrogates: "Collection[Surrogate]"
) -> Model:
    statements = parse(source)
    names = Names(statements, Surroundings(parameters=parameters, functions=_called(surrogates)), source)
    step = _step(statements, source)
    loom = Loom()
    nodes = build(names, loom, {})
    visible = {n: at for n, at in nodes.items() if not names.definitions[n].auxiliary}
    if not names.definitions and not source.findings:
        source.report_all("the text defines no node", "Write name[unit] = expression.")
    source.raise_findings()
    graph = merged(loom.finish(visible, {}, tuple(names.outputs)))
    return Model(
        graph=replace(graph, units=_units(names, graph)),
        name=name,
        step=step,
        declared=MappingProxyType(_declared(names)),
        source=origin,
        places=MappingProxyType(_places(names, source)),
        surrogates=tuple(surrogate for surrogate in surrogates if surrogate.name in graph.parameters),
    )


def _called(surrogates: "Collection[Surrogate]") -> Mapping[str, Function]:
    if not surrogates:
        return {}
    from kennfeld.models.formula.surrogates import functions_of  # most texts call none

    return functions_of(surrogates)


def _step(statements: Collection[Statement], source: Source) -> float | None:
    found = [statement for statement in statements if isinstance(statement, Step)]
    for second in found[1:]:
        source.report(second.at, f"step stands already in {source.place(found[0].at.line)}", "Remove one.")
    return found[0].seconds if found else None


def _units(names: Names, graph: Graph) -> Mapping[str, str]:
    present = {**graph.names, **dict.fromkeys(graph.inputs), **graph.parameters}
    statements: list[tuple[str, Definition | Declaration]] = [
        *names.definitions.items(),
        *names.inputs.items(),
        *names.declared.items(),
    ]
    return MappingProxyType({name: s.unit for name, s in statements if s.unit and name in present})


def _declared(names: Names) -> dict[str, int]:
    axes = {"scalar": 0, "curve": 1, "map": 2, "cube": 3, "rbf": 1}
    return {name: names.axes.get(name, axes[found.kind]) for name, found in names.declared.items()}


def _places(names: Names, source: Source) -> dict[str, str]:
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
    around = Surroundings(graph.names, axes.keys(), axes, inputs=graph.inputs, owner=f"model {model.name}")
    loom = Loom.of(graph)
    assert isinstance(loom, Loom)
    made = _expressions(nodes, place, around, loom, graph.names)
    grown = loom.finish({**graph.names, **made}, graph.units, (*graph.outputs, *nodes))
    places = {**model.places, **dict.fromkeys(nodes, place)}
    return replace(model, graph=merged(grown), places=MappingProxyType(places))


def expression(text: str, place: str, channels: Collection[str] | None = None) -> Graph:
    """The graph of one expression over channel names, called "value"; it has no parameters.

    With `channels`, a name that is none of them is an error.

    >>> expression("air_kg_h / n_rpm * 1000", "kennfeld.toml [calculated] rel_air").inputs
    ('air_kg_h', 'n_rpm')
    """
    loom = Loom()
    # no channel has the empty name, so the expression may read one called "value"
    made = _expressions({"": text}, place, Surroundings(parameters=(), channels=channels), loom, {})
    return merged(loom.finish({"value": made[""]}))


def _expressions(
    texts: Mapping[str, str], place: str, around: Surroundings, loom: Loom, known: Mapping[str, int]
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
    names = Names(
        [
            Definition(Token("quoted", _quoted(name), span[0], 0), "", parse_expression(source, span, keys))
            for name, span in spans.items()
        ],
        around,
        source,
    )
    nodes = build(names, loom, known)
    source.raise_findings()
    return nodes


def _quoted(name: str) -> str:
    return f"%{name.replace('%', '%%')}%"
