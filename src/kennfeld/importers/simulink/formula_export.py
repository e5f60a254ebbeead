"""Export of a Simulink model as formula text.

A node is named after its outport, else its signal, else its block, or the path of the block if another node has that
name. Nodes are grouped by subsystem.
"""

from collections import Counter
from types import MappingProxyType

from kennfeld.graph import CLOCK, Graph
from kennfeld.importers.simulink.import_report import SimulinkReport
from kennfeld.importers.simulink.reader.model_tree import join_path, split_path
from kennfeld.models.formula import to_lines
from kennfeld.models.importer import FormulaLine, ImportRequest
from kennfeld.models.model import Model


def heading(request: ImportRequest, report: SimulinkReport) -> list[str]:
    """Return the comments above the formula text of a model: what it is of, and the differences from Simulink."""
    part = request.options.subsystem
    return [f"{request.path.name}{f', {part}' if part else ''}", *report.substitutions]


def formula_lines(model: Model) -> list[FormulaLine]:
    """Return the formula text of an imported model, grouped by subsystem, each line with the block it comes from.

    Continuous states are written as integrators of their derivatives, below a declaration of the solver.
    """
    graph, headings, original = _arrange_by_subsystem(model)
    solver = "" if model.equations is None else model.solver
    blocks = _computing_blocks(model)
    return [
        FormulaLine(line.text, name := original.get(line.node, ""), blocks.get(name, ""))
        for line in to_lines(graph, model.step, headings, solver)
    ]


def _computing_blocks(model: Model) -> dict[str, str]:
    """Return the path of the block that computes each named node: not of an outport if the node has another name."""
    names, outputs = model.graph.names, set(model.graph.outputs)
    inner = {at: _path(model, name) for name, at in reversed(list(names.items())) if name not in outputs}
    return {name: inner.get(at) or _path(model, name) for name, at in names.items()}


def _path(model: Model, name: str) -> str:
    return model.locations[name].path if name in model.locations else ""


def _arrange_by_subsystem(model: Model) -> tuple[Graph, dict[str, str], dict[str, str]]:
    """Return the graph in the order of subsystems with short names, the heading above each node, and its own name."""
    graph = model.graph if model.equations is None else model.equations
    kept = _best_names(graph)
    paths = {name: _path(model, name) for name in kept}
    ways = {name: split_path(path) for name, path in paths.items()}
    short = {name: _short_name(name, path, ways[name]) for name, path in paths.items()}
    uses = Counter([*short.values(), *graph.inputs, *graph.parameters, *CLOCK])
    new = {name: short[name] if uses[short[name]] == 1 else name for name in kept}
    above = {name: "" if name in graph.outputs else join_path(*ways[name][:-1]) for name in kept}
    order = {heading: at for at, heading in enumerate(dict.fromkeys(["", *above.values()]))}
    names = sorted(kept, key=lambda name: order[above[name]])
    arranged = Graph(
        graph.nodes,
        MappingProxyType({new[name]: graph.names[name] for name in names}),
        graph.states,
        MappingProxyType({new.get(name, name): unit for name, unit in graph.units.items()}),
        tuple(new[name] for name in graph.outputs),
    )
    return arranged, {new[name]: above[name] for name in names}, {new[name]: name for name in names}


def _best_names(graph: Graph) -> list[str]:
    """Return the outputs, and the first name of each other node, which is that of its signal if it has one."""
    named = {graph.names[name] for name in graph.outputs}
    kept = dict.fromkeys(graph.outputs)
    for name, at in graph.names.items():
        is_leaf = not graph.nodes[at].args and graph.nodes[at].op != "state"
        if at not in named and not is_leaf:
            named.add(at)
            kept[name] = None
    return [name for name in graph.names if name in kept]


def _short_name(name: str, path: str, field_path: tuple[str, ...]) -> str:
    """Return the block name of a node that is named by its block path."""
    return field_path[-1] + name[len(path) :] if len(field_path) > 1 and name.startswith(path) else name
