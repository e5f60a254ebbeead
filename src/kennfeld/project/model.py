"""The data-driven models that a project file names: `[surrogates] engine = "engine.json"`.

The model of a project: read with the project's parameters, and extended by the expressions of its criteria.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.graph import Graph
from kennfeld.graph.factors import factors
from kennfeld.models import Model
from kennfeld.models.formula import extend, read
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.lexer import Source
from kennfeld.models.formula.name_resolution import NameScope, NameTable
from kennfeld.models.formula.parser import parse
from kennfeld.parameter_set import ParameterSet
from kennfeld.project.schema import DIRECTIONS, PROTECTED, SIMULINK, ProjectFile

if TYPE_CHECKING:
    from kennfeld.surrogate import Surrogate

__all__ = [
    "ProjectModel",
    "axes_finding",
    "coordinates_of",
    "initial_level",
    "is_drawn",
    "read_function",
    "read_surrogates",
    "undefined",
]

_LATER_KINDS = {
    ".esdl": "an ASCET model",
    ".fmu": "an FMU",
    ".onnx": "an ONNX network",
    ".py": "a Python function",
}
_ASK = "Ask for the model itself, .slx or .mdl."
_NAME = re.compile(r"[^\W\d][\w.]*|%(?:[^%]|%%)*%")


def read_surrogates(file: ProjectFile, findings: list[Finding]) -> "tuple[Surrogate, ...]":
    """The surrogates, each under the name that the project gives it; findings for those that cannot be read."""
    if not file.surrogates:
        return ()
    from kennfeld.models.formula.functions import FUNCTIONS
    from kennfeld.models.formula.lexer import is_plain
    from kennfeld.surrogate import read_surrogate

    made = []
    for name, path in file.surrogates.items():
        if name in FUNCTIONS or not is_plain(name):
            message = "is built in" if name in FUNCTIONS else "is no name that formula text can call"
            findings.append(Finding(file.place(f"[surrogates] {name}"), f"{name} {message}", "Use another name."))
            continue
        target = file.folder / path
        if not target.is_file():
            beside = [one.name for one in target.parent.iterdir() if one.is_file()] if target.parent.is_dir() else []
            remedy = nearest(target.name, beside) or "Train it with `kennfeld surrogate train`."
            findings.append(Finding(file.place(f"[surrogates] {name}"), f"there is no file {path}", remedy))
            continue
        try:
            made.append(replace(read_surrogate(target), name=name))
        except InputError as error:
            findings += error.findings
    return tuple(made)


@dataclass(frozen=True)
class ProjectModel:
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


def read_function(
    file: ProjectFile,
    known: Collection[str],
    surrogates: "Collection[Surrogate]",
    findings: list[Finding],
    initial: ParameterSet | None = None,
) -> ProjectModel | None:
    """The model of the project; None, and findings, where it cannot be read.

    `known` are the parameters' names, `initial` gives the variables of a Simulink model their values.
    """
    if not file.model.file or not _is_readable(file, findings):
        return None
    try:
        model = _drawn(file, initial) if is_drawn(file) else _read(file.folder / file.model.file, known, surrogates)
    except InputError as error:
        findings += error.findings
        return None
    return ProjectModel(_extended(model, file, findings), model.graph.inputs)


def is_drawn(file: ProjectFile) -> bool:
    """Whether the function is a Simulink model, whose parameters have values of its own."""
    return file.model.file.lower().endswith((*SIMULINK, PROTECTED))


def _drawn(file: ProjectFile, initial: ParameterSet | None) -> Model:
    """The model in a Simulink file, its variables with the values of its own files, then those of the project.

    Literals of blocks that the project names, `Torque/Gain1:Gain`, become parameters.
    """
    from kennfeld.models.simulink.importing import simulink

    entry = file.model
    if missing := [name for name in entry.folders if not (file.folder / name).is_dir()]:
        place = file.place("[model] folders")
        raise InputError(Finding(place, f"there is no folder {name}", "Check the path.") for name in missing)
    files = [file.folder / name for name in entry.parameters]
    promoted = [name for name in file.parameters if ":" in name]
    stated = {name: one.initial for name, one in file.parameters.items() if one.initial is not None and not one.axes}
    given: list[Any] = [*files, *([] if initial is None else [initial]), stated]
    drawn = file.folder / entry.file, entry.subsystem or None, given, dict(entry.bind), promoted
    return simulink(*drawn, [file.folder / name for name in entry.folders], entry.step)


def _read(path: Path, known: Collection[str], surrogates: "Collection[Surrogate]") -> Model:
    """The model; parameters that nobody defines are looked up all the same, so that `undefined` can report them."""
    try:
        return read(path, known, surrogates)
    except InputError as error:
        assumed = _assumed(path, [*known, *(surrogate.name for surrogate in surrogates)])
        if not assumed:
            raise error from None
    return read(path, [*known, *assumed], surrogates)


def _assumed(path: Path, known: Collection[str]) -> list[str]:
    """Tables in the text that are not known, and bare names that are no input, since the text declares its inputs."""
    try:
        source = Source.of_text(path.name, path.read_text("utf-8-sig", errors="replace"))
    except OSError:
        return []
    names = NameTable(parse(source), NameScope(), source)
    tables = [name for name in names.axes if name not in known]
    scalars = [name for name in names.uses if name not in (*names.inputs, *known, *tables)]
    return [*tables, *scalars] if names.inputs else tables


def _is_readable(file: ProjectFile, findings: list[Finding]) -> bool:
    name, place = file.model.file, file.place("[model] file")
    path = file.folder / name.partition(":")[0]  # a Python function stands behind a colon
    kind = path.suffix.casefold()
    if kind in _LATER_KINDS:
        message = f"{name} is {_LATER_KINDS[kind]}, which is not available in this version"
        findings.append(Finding(place, message, "Formula text (.kf) and Simulink models (.slx, .mdl) can be read."))
    elif not path.is_file():
        beside = [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []
        message = f"{name} is a folder" if path.is_dir() else f"there is no file {name}"
        findings.append(Finding(place, message, nearest(path.name, beside) or "Check the path."))
    elif kind == PROTECTED:
        findings.append(Finding(place, f"{name} is a protected model, whose blocks cannot be read", _ASK))
    elif kind != ".kf" and kind not in SIMULINK:
        message = f"{name} is no kind of model that is known"
        findings.append(Finding(place, message, "Formula text (.kf) and Simulink models (.slx, .mdl) can be read."))
    else:
        return True
    return False


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
    if around := _beside(model.graph, text):
        remedy = (
            "/" in text and nearest(text, around)
        ) or f"Of {text.partition('/')[0]} it has {', '.join(around[:8])}."
        findings.append(Finding(place, f"{text} is no node of the function", remedy))
        return model
    if _NAME.fullmatch(text):
        candidates = [name for name in model.graph.names if _NAME.fullmatch(name)]
        shown = list(model.graph.outputs[:12]) if model.values else candidates[-8:]
        remedy = nearest(text, candidates) or f"It has {', '.join(shown)}."
        findings.append(Finding(place, f"{text} is no node of the function", remedy))
        return model
    try:
        return extend(model, {text: text}, place)
    except InputError as error:
        findings += error.findings
        return model


def _beside(graph: Graph, text: str) -> list[str]:
    """The nodes that share the first subsystem with a text that is the path of a block; none where it is no path."""
    first = text.partition("/")[0]
    if first in graph.names or first in graph.inputs:
        return []
    return [name for name in graph.names if name.startswith(f"{first}/")]


def undefined(function: ProjectModel, known: Collection[str]) -> list[Finding]:
    """A finding for each parameter that the function looks up and nobody defines, with a snippet to copy."""
    found = []
    for name, count in function.graph.parameters.items():
        if name not in known:
            lines = _snippet(name, count, function)
            message = f"{name} is looked up here, but no file and no section of the project defines it"
            if not count:
                message = f"{name} is no node and no input, and no file and no section of the project defines it"
            others = FUNCTIONS if count else (*function.graph.inputs, *function.graph.names)
            guess = nearest(name, [*known, *others])
            remedy = f"{guess} Or define it: {lines[0]} {', '.join(lines[1:])}.".strip()
            found.append(Finding(function.place(name), message, remedy, "\n".join(lines)))
    return found


def axes_finding(function: ProjectModel, name: str, kind: str, axes: int) -> Finding:
    """Return the error that a function looks a table up with another number of coordinates than it has axes."""
    count = function.graph.parameters[name]
    given = f"{count or 'no'} coordinate{'s' * (count != 1)}"
    message = f"{name} is given {given}, but it is a {kind} with {axes} axes"
    return Finding(function.place(name), message, "Correct one of them.")


def _snippet(name: str, count: int, function: ProjectModel) -> list[str]:
    """Lines of a project file that define a table, its axes named after what the function looks it up with."""
    graph = function.graph
    lines = [f"[parameters.{name}]" if re.fullmatch(r"[\w-]+", name) else f'[parameters."{name}"]']
    for direction, quantity in zip(DIRECTIONS, coordinates_of(graph, name)[:count], strict=False):
        spread = "count = 8" if quantity in graph.inputs else "begin = 0.0, end = 1.0, count = 8"
        named = f'input = "{quantity}", ' if quantity else ""
        lines.append(f"{direction} = {{ {named}{spread} }}")
    return [*lines, f"initial = {initial_level(graph, name)}"]


def initial_level(graph: Graph, parameter: str) -> float:
    """The number at which a parameter may start of which nothing is known: 1 for a factor, else 0.

    Two factors at 0 would keep each other there.

    >>> from kennfeld.models.formula import formula
    >>> graph = formula("y = A(u) * B(v) + C(u)").graph
    >>> initial_level(graph, "A"), initial_level(graph, "C")
    (1.0, 0.0)
    """
    return 1.0 if parameter in factors(graph) else 0.0


def coordinates_of(graph: Graph, parameter: str) -> Sequence[str]:
    """What the function looks a table up with, an axis each; a name where there is one, else an empty text.

    >>> from kennfeld.models.formula import formula
    >>> coordinates_of(formula("y = M(Speed, a + b)").graph, "M")
    ['Speed', '']
    """
    names: Mapping[int, str] = {at: name for name, at in reversed(list(graph.names.items()))}
    for node in graph.nodes:
        if node.op == "lookup" and node.payload == parameter:
            return [
                str(graph.nodes[at].payload) if graph.nodes[at].op == "input" else names.get(at, "") for at in node.args
            ]
    return []
