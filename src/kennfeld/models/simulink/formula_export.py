"""A Simulink model as formula text, with its parameters in a file beside it."""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from kennfeld.atomic_files import write_whole
from kennfeld.errors import InputError
from kennfeld.graph import CLOCK, Graph
from kennfeld.models.formula import to_text
from kennfeld.models.model import Model
from kennfeld.models.simulink.importing import import_simulink
from kennfeld.models.simulink.reader.model_tree import join_path, split_path

__all__ = ["write_formula"]


def write_formula(
    source: str | Path,
    target: str | Path,
    subsystem: str = "",
    parameters: Iterable[str | Path] = (),
    folders: Iterable[str | Path] = (),
    bind: Mapping[str, str] | None = None,
) -> tuple[Path, ...]:
    """Write the model in a Simulink file as formula text that gives the same results, and give the paths written.

    Nodes are called by their blocks, or by the paths of those where a name would mean two things, and stand below the
    paths of their subsystems. What runs in another way than in Simulink stands in comments on top. The values of its
    parameters go to a `.json` of the same name, where there are some. `bind` is as in `simulink`. Raises `InputError`
    where an output cannot be built, or nothing be written.
    """
    from kennfeld.calfiles import write as write_parameters

    source, target = Path(source), Path(target)
    if target.suffix.lower() != ".kf":
        raise InputError.of(str(target), "a model is written as formula text", "Name a file that ends in .kf.")
    found = import_simulink(source, subsystem or None, parameters, bind, folders=folders)
    if found.model is None:
        raise InputError(found.report.findings)
    head = [f"{source.name}{f', {subsystem}' if subsystem else ''}, read by Kennfeld", *found.report.substitutions]
    graph, headings = _arranged(found.model)
    text = "".join(f"# {' '.join(line.split())}\n" for line in head) + to_text(graph, found.model.step, headings)
    made = [target]
    try:
        write_whole(target, text)
        if found.model.values:
            made.append(target.with_suffix(".json"))
            write_parameters(found.model.values, made[-1])
    except OSError as error:
        raise InputError.of(
            str(target), f"cannot be written: {error.strerror or error}", "Name another file."
        ) from None
    return tuple(made)


def _arranged(model: Model) -> tuple[Graph, dict[str, str]]:
    """The graph with its nodes in the order of their subsystems, under short names, and what stands above each."""
    graph = model.graph
    ways = {name: split_path(model.places.get(name, "")) for name in graph.names}
    short = {name: _short(name, model.places.get(name, ""), ways[name]) for name in graph.names}
    uses = Counter([*short.values(), *graph.inputs, *graph.parameters, *CLOCK])
    new = {name: short[name] if uses[short[name]] == 1 else name for name in graph.names}
    above = {name: "" if name in graph.outputs else join_path(*ways[name][:-1]) for name in graph.names}
    order = {heading: at for at, heading in enumerate(dict.fromkeys(["", *above.values()]))}
    names = sorted(graph.names, key=lambda name: order[above[name]])
    arranged = Graph(
        graph.nodes,
        MappingProxyType({new[name]: graph.names[name] for name in names}),
        graph.states,
        MappingProxyType({new.get(name, name): unit for name, unit in graph.units.items()}),
        tuple(new[name] for name in graph.outputs),
    )
    return arranged, {new[name]: above[name] for name in names}


def _short(name: str, path: str, way: tuple[str, ...]) -> str:
    """A node that is called by the path of its block, by the block alone."""
    return way[-1] + name[len(path) :] if len(way) > 1 and name.startswith(path) else name
