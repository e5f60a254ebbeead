"""Export of a Simulink model as formula text.

A node is named after its outport, else its signal, else its block, with as much of the path of the block as
distinguishes it. Statements follow the flow of signals, grouped by the subsystem that computes them. Sums, products and
the like whose blocks have the names that the library gave them are written where they are used.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from kennfeld.graph import CLOCK, Graph
from kennfeld.importers.simulink.formula_inlining import written_in_place
from kennfeld.importers.simulink.import_report import SimulinkReport
from kennfeld.importers.simulink.reader.model_tree import join_path, split_path
from kennfeld.models.formula import to_lines
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.printer import TextLayout, merged, spell_name
from kennfeld.models.formula.signal_order import named_uses, section_order, signal_order
from kennfeld.models.importer import FormulaLine, ImportRequest
from kennfeld.models.model import Model
from kennfeld.models.model_export import descriptions_of
from kennfeld.models.sample_times import find_sample_hits

_LONG_NAME = 24  # characters of a table's name from which the text has a shorter one


def heading(request: ImportRequest, report: SimulinkReport) -> list[str]:
    """Return the comments above the formula text of a model: what it is of, and the differences from Simulink."""
    part = request.options.subsystem
    return [f"{request.path.name}{f', {part}' if part else ''}", *report.substitutions]


def formula_lines(model: Model, each_block: bool = False) -> list[FormulaLine]:
    """Return the formula text of an imported model, grouped by subsystem, each line with the block it comes from.

    Continuous states are written as integrators of their derivatives, below a declaration of the solver. With
    `each_block`, every block that calculates has its own line.
    """
    solver = "" if model.equations is None else model.solver
    whole = merged(model.graph if model.equations is None else model.equations, solver)
    blocks = _computing_blocks(model)
    kept = _best_names(whole)
    arranged = _arrange(whole, kept if each_block else written_in_place(whole, kept, blocks), blocks, model.name)
    counted = [name for name in arranged.graph.parameters if _is_array(model, name)]
    layout = TextLayout(
        arranged.headings,
        descriptions_of(model),
        tables := _table_names(arranged.graph, counted),
        [name for name in counted if name in tables],
        {name: split_path(blocks[own])[-1] for name, own in arranged.original.items() if blocks[own]},
        _names_of_hits(arranged.graph),
    )
    lines = to_lines(arranged.graph, model.step, solver, layout)
    names = [arranged.original.get(line.node, "") for line in lines]
    return [
        FormulaLine(line.text, name if line.defines else "", blocks.get(name, ""))
        for line, name in zip(lines, names, strict=True)
    ]


def _computing_blocks(model: Model) -> dict[str, str]:
    """Return the path of the block that computes each named node: not of an outport if the node has another name."""
    names, outputs = model.graph.names, set(model.graph.outputs)
    inner = {at: _path(model, name) for name, at in reversed(list(names.items())) if name not in outputs}
    return {name: inner.get(at) or _path(model, name) for name, at in names.items()}


def _path(model: Model, name: str) -> str:
    return model.locations[name].path if name in model.locations else ""


class _Arranged(NamedTuple):
    """A graph in the order of its text: the heading above each node, and the name that it has in the model."""

    graph: Graph
    headings: Mapping[str, str]
    original: Mapping[str, str]


def _arrange(graph: Graph, kept: list[str], blocks: Mapping[str, str], top: str) -> _Arranged:
    """Return the graph with the names that are kept, short and in the order of signals and subsystems.

    `top` is the name of the model, the heading of what is in no subsystem.
    """
    shown = _renamed(graph, {name: name for name in kept})
    sections = {name: join_path(*split_path(blocks[name])[:-1]) for name in kept}
    order = section_order(signal_order(shown), sections, named_uses(shown))
    new = _short_names(graph, kept, blocks)
    several = len(set(sections.values())) > 1
    headings = {new[name]: sections[name] or (top if several else "") for name in order}
    return _Arranged(
        _renamed(graph, {name: new[name] for name in order}), headings, {new[name]: name for name in order}
    )


def _renamed(graph: Graph, new: Mapping[str, str]) -> Graph:
    """Return a graph with these of its names only, in their order."""
    return Graph(
        graph.nodes,
        MappingProxyType({short: graph.names[name] for name, short in new.items()}),
        graph.states,
        MappingProxyType({new.get(name, name): unit for name, unit in graph.units.items()}),
        tuple(new[name] for name in graph.outputs),
    )


def _best_names(graph: Graph) -> list[str]:
    """Return the outputs, and the first name of each other node, which is that of its signal if it has one."""
    named = {graph.names[name] for name in graph.outputs}
    kept = dict.fromkeys(graph.outputs)
    for name, at in graph.names.items():
        # a number or an input is written where it is used and needs no line of its own
        is_leaf = not graph.nodes[at].args and graph.nodes[at].op != "state"
        if at not in named and not is_leaf:
            named.add(at)
            kept[name] = None
    return [name for name in graph.names if name in kept]


def _short_names(graph: Graph, kept: Iterable[str], blocks: Mapping[str, str]) -> dict[str, str]:
    """Return the names in the text: of those that are paths, as many last parts as no other name has."""
    candidates = {name: _candidates(name, blocks[name]) for name in kept}
    taken = {*graph.inputs, *graph.parameters, *CLOCK}
    chosen = dict.fromkeys(candidates, 0)
    while True:
        new = {name: candidates[name][at] for name, at in chosen.items()}
        uses = Counter([*new.values(), *taken])
        longer = [name for name, at in chosen.items() if uses[new[name]] > 1 and at + 1 < len(candidates[name])]
        if not longer:
            return new
        chosen |= {name: chosen[name] + 1 for name in longer}


def _candidates(name: str, path: str) -> list[str]:
    """Return the forms of a name, the shortest first, of a node that is named by the path of its block."""
    parts = split_path(path)
    if len(parts) < 2 or not name.startswith(path):
        return [name]
    # a single part is a name, in which a slash is not doubled
    tail = name[len(path) :]
    return [parts[-1] + tail, *(join_path(*parts[at:]) + tail for at in range(len(parts) - 2, -1, -1))]


def _is_array(model: Model, name: str) -> bool:
    """Return True for a vector or matrix of values, whose elements MATLAB counts from 1."""
    return name in model.values and model.values[name].kind == "block"


def _table_names(graph: Graph, counted: Collection[str]) -> dict[str, str]:
    """Return names by which to call arrays, and short names of the tables that are named by the path of a block."""
    taken = {*graph.names, *graph.inputs, *graph.parameters, *CLOCK, *FUNCTIONS}
    names = {}
    for name, axes in graph.parameters.items():
        is_long = len(name) >= _LONG_NAME and spell_name(name) != name
        if not 1 <= axes <= 4 or not (is_long or name in counted):
            continue
        word = re.sub(r"\W+", "_", split_path(name)[-1] if is_long else name).strip("_")
        word = word if word[:1].isalpha() else f"Table_{word}".removesuffix("_Table")
        word = f"{word}_at" if name in counted else word
        if word not in taken:
            names[name] = word
            taken.add(word)
    return names


def _names_of_hits(graph: Graph) -> dict[int, str]:
    """Return names of the conditions that a step is a hit of a sample time, such as `_hit_0.01s`."""
    names = {at: f"_hit_{period:g}s".replace("-", "_") for at, period in find_sample_hits(graph).items()}
    uses = Counter(names.values())
    return {at: name for at, name in names.items() if uses[name] == 1}
