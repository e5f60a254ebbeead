"""The model of a project: read with the project's parameters, and extended by the expressions of its criteria."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from kennfeld.errors import Finding, InputError, nearest
from kennfeld.graph import Graph
from kennfeld.models import Model
from kennfeld.models.formula import extend, read
from kennfeld.project.schema import DIRECTIONS, ProjectFile, TargetEntry

__all__ = ["Function", "coordinates_of", "read_function", "undefined"]

_LATER_KINDS = {
    ".slx": "a Simulink model",
    ".mdl": "a Simulink model",
    ".esdl": "an ASCET model",
    ".fmu": "an FMU",
    ".onnx": "an ONNX network",
    ".py": "a Python function",
}
_NAME = re.compile(r"[^\W\d][\w.]*|%(?:[^%]|%%)*%")


@dataclass(frozen=True)
class Function:
    """The model with its criteria's expressions as further nodes.

    `inputs` are those of the model itself, before the expressions.
    """

    model: Model
    inputs: tuple[str, ...]

    @property
    def graph(self) -> Graph:
        """The graph of one time step."""
        return self.model.graph

    def place(self, name: str) -> str:
        """Where a name of the function stands."""
        return self.model.places.get(name, self.model.source)


def read_function(file: ProjectFile, known: Collection[str], findings: list[Finding]) -> Function | None:
    """The model of the project; None, and findings, where it cannot be read. `known` are the parameters' names."""
    if not file.model.file or not _is_readable(file, findings):
        return None
    try:
        model = _read(file, known)
    except InputError as error:
        findings += error.findings
        return None
    return Function(_extended(model, file, findings), model.graph.inputs)


def _is_readable(file: ProjectFile, findings: list[Finding]) -> bool:
    name, place = file.model.file, file.place("[model] file")
    path = file.folder / name
    suffix = f".{name.partition(':')[0].rpartition('.')[2]}".casefold()
    if suffix in _LATER_KINDS and suffix != path.suffix.casefold() or path.suffix.casefold() in _LATER_KINDS:
        what = f"{name} is {_LATER_KINDS[suffix]}, which is not available in this version"
        findings.append(Finding(place, what, "Formula text (.kf) can be read."))
    elif not path.is_file():
        beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
        what = f"{name} is a folder" if path.is_dir() else f"there is no file {name}"
        findings.append(Finding(place, what, nearest(path.name, beside) or "Check the path."))
    elif path.suffix.casefold() != ".kf":
        what = f"{name} is no kind of model that is known"
        findings.append(Finding(place, what, "Formula text (.kf) can be read."))
    else:
        return True
    return False


def _read(file: ProjectFile, known: Collection[str]) -> Model:
    """The model; names of scalars can only be told from inputs once the parameters are known."""
    path = file.folder / file.model.file
    model = read(path)
    ambiguous = {*model.graph.inputs, *model.graph.names}
    if ambiguous.isdisjoint(known):
        return model
    return read(path, [*known, *(name for name in model.graph.parameters if name not in known)])


def _extended(model: Model, file: ProjectFile, findings: list[Finding]) -> Model:
    """The model with each criterion's node, and each target that is a node, by the text the project file gives."""
    for criterion in file.criteria:
        wanted = {"node": criterion.node}
        if criterion.target.kind == "node":
            wanted["target"] = criterion.target.name
        for key, text in wanted.items():
            model = _with_node(model, text, f"{criterion.place} {key}", findings)
    return model


def _with_node(model: Model, text: str, place: str, findings: list[Finding]) -> Model:
    if not text or text in model.graph.names:
        return model
    if _NAME.fullmatch(text):
        candidates = [name for name in model.graph.names if _NAME.fullmatch(name)]
        mend = nearest(text, candidates) or f"It has {', '.join(candidates[-8:])}."
        findings.append(Finding(place, f"{text} is no node of the function", mend))
        return model
    try:
        return extend(model, {text: text}, place)
    except InputError as error:
        findings += error.findings
        return model


def is_node(function: Function, target: TargetEntry) -> bool:
    """Whether a target's name is a node of the function."""
    return target.name in function.graph.names


def undefined(function: Function, known: Collection[str]) -> list[Finding]:
    """A finding for each parameter that the function looks up and nobody defines, with a snippet to copy."""
    found = []
    for name, count in function.graph.parameters.items():
        if name not in known:
            lines = _snippet(name, count, function)
            what = f"{name} is looked up here, but no file and no section of the project defines it"
            guess = nearest(name, known)
            mend = f"{guess} Or define it: {lines[0]} {', '.join(lines[1:])}.".strip()
            found.append(Finding(function.place(name), what, mend, "\n".join(lines)))
    return found


def _snippet(name: str, count: int, function: Function) -> list[str]:
    """Lines of a project file that define a table, its axes named after what the function looks it up with."""
    graph = function.graph
    lines = [f"[parameters.{name}]" if re.fullmatch(r"[\w-]+", name) else f'[parameters."{name}"]']
    for direction, quantity in zip(DIRECTIONS, coordinates_of(graph, name)[:count], strict=False):
        spread = "count = 8" if quantity in graph.inputs else "begin = 0.0, end = 1.0, count = 8"
        lines.append(f'{direction} = {{ input = "{quantity}", {spread} }}')
    return [*lines, "initial = 0.0"]


def coordinates_of(graph: Graph, parameter: str) -> Sequence[str]:
    """What the function looks a table up with, an axis each; a name where there is one, else an empty text.

    >>> from kennfeld.models.formula import formula
    >>> coordinates_of(formula("y = M(Speed, a + b)").graph, "M")
    ['Speed', '']
    """
    names: Mapping[int, str] = {at: name for name, at in reversed(graph.names.items())}
    for node in graph.nodes:
        if node.op == "lookup" and node.payload == parameter:
            return [
                str(graph.nodes[at].payload) if graph.nodes[at].op == "input" else names.get(at, "") for at in node.args
            ]
    return []
