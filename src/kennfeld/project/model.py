"""Reads the model of a project and its surrogates, and adds the expressions of criteria as nodes."""

import re
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.base.errors import Finding, Findings, InputError, Location, choices
from kennfeld.base.file_errors import files_beside
from kennfeld.base.formatting import count_noun, nearest, quoted, toml_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.files.formats import named_format
from kennfeld.graph import Graph
from kennfeld.graph.factors import factors
from kennfeld.graph.traversal import coordinates_of
from kennfeld.models import Model
from kennfeld.models.formula import extend, read, spell_name
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.lexer import Source, is_plain
from kennfeld.models.formula.name_resolution import NameScope, NameTable
from kennfeld.models.formula.parser import parse
from kennfeld.models.function_files import read_function_file, split_reference
from kennfeld.models.importer import ImportOptions, ImportRequest
from kennfeld.models.importer_registry import importer_of, importers
from kennfeld.models.model_function import ModelFunction
from kennfeld.project.schema import ProjectFile
from kennfeld.project.value_forms import DIRECTIONS

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate


_NAME = re.compile(r"[^\W\d][\w.]*|%(?:[^%]|%%)*%")


def read_surrogates(file: ProjectFile, findings: Findings) -> "tuple[Surrogate, ...]":
    """Return the surrogates under their names in the project; add findings about those that cannot be read."""
    if not file.surrogates:
        return ()
    from kennfeld.surrogate.surrogate_file import read_surrogate

    surrogates = []
    for name, path in file.surrogates.items():
        if not _can_be_called(name, file.location("surrogates", name), findings):
            continue
        target = file.folder / path
        if not target.is_file():
            remedy = nearest(target.name, files_beside(target)) or "Train it with `kennfeld surrogate train`."
            fixes = choices(("surrogates", name), file.alike(path), removable=True)
            findings.error(file.location("surrogates", name), f"file {path} does not exist", remedy, fixes=fixes)
            continue
        try:
            surrogates.append(replace(read_surrogate(target), name=name))
        except InputError as error:
            findings.add(*error.findings)
    return tuple(surrogates)


def _read_called_functions(file: ProjectFile, findings: Findings) -> tuple[ModelFunction, ...]:
    """Return the functions from files that formula text may call; add findings about those that cannot be read."""
    functions = []
    for name, reference in file.functions.items():
        location = file.location("functions", name)
        if name in file.surrogates:
            findings.error(location, f"{name} is also the name of a surrogate", "Use another name.")
        elif _can_be_called(name, location, findings) and _exists(file, reference, location, findings):
            try:
                entry = file.model
                options = ImportOptions(target=entry.target, float32=entry.float32)
                functions.append(read_function_file(reference, file.folder, name, entry.step, options))
            except InputError as error:
                findings.add(*error.findings)
    return tuple(functions)


def _can_be_called(name: str, location: Location, findings: Findings) -> bool:
    """Return if formula text can call a function by this name; otherwise add an error."""
    if name in FUNCTIONS:
        findings.error(location, f"{name} is a built-in function", "Use another name.")
    elif not is_plain(name):
        findings.error(location, f"invalid name {name!r} in formula text", "Use another name.")
    else:
        return True
    return False


def _exists(file: ProjectFile, reference: str, location: Location, findings: Findings) -> bool:
    path = file.folder / split_reference(reference)[0]
    if path.is_file():
        return True
    message = f"{path.name} is a folder" if path.is_dir() else f"file {reference} does not exist"
    others = [] if "#" in reference or ":" in Path(reference).name else file.alike(reference)
    fixes = choices(location.keys, others, removable=True)
    findings.error(location, message, nearest(path.name, files_beside(path)) or "Check the path.", fixes=fixes)
    return False


@dataclass(frozen=True)
class ProjectModel:
    """The model, with the expressions of criteria as additional nodes; `inputs` are those of the model alone."""

    model: Model
    inputs: tuple[str, ...]

    @property
    def graph(self) -> Graph:
        """The graph of one time step."""
        return self.model.graph

    def place(self, name: str) -> Location:
        """Return the location of a name of the function."""
        return self.model.locations.get(name, Location.of_file(self.model.source))


def read_function(
    file: ProjectFile,
    known: Collection[str],
    surrogates: "Collection[Surrogate]",
    findings: Findings,
    initial: ParameterSet | None = None,
) -> ProjectModel | None:
    """Read the model of a project; return None and add findings if it cannot be read.

    Args:
        file: the project file.
        known: names of parameters.
        surrogates: data-driven models that formula text may call.
        findings: to be extended.
        initial: values from calibration files, which an importer may need.
    """
    if not file.model.file or not _is_readable(file, findings):
        return None
    functions = _read_called_functions(file, findings)
    if len(functions) < len(file.functions):
        return None  # calls of missing ones would be false errors
    try:
        importer = importer_of(split_reference(file.model.file)[0])
        if importer is None:
            model = _read_formula(file, known, surrogates, functions)
        else:
            model = importer.model(_request(file, initial))
    except InputError as error:
        findings.add(*error.findings)
        return None
    return ProjectModel(_extend_model(model, file, findings), model.graph.inputs)


def defines_values(file: ProjectFile) -> bool:
    """Return if the function is of a kind that may define parameters with values."""
    return importer_of(split_reference(file.model.file)[0]) is not None


def _request(file: ProjectFile, initial: ParameterSet | None) -> ImportRequest:
    """Return what to import; raises `InputError` if a folder for further files does not exist."""
    if missing := [name for name in file.model.folders if not (file.folder / name).is_dir()]:
        location = file.location("model", "folders")
        raise InputError(Finding(location, f"folder {name} does not exist", "Check the path.") for name in missing)
    return file.import_request(initial)


def _read_formula(
    file: ProjectFile,
    known: Collection[str],
    surrogates: "Collection[Surrogate]",
    functions: Collection[ModelFunction],
) -> Model:
    """Read formula text; undefined parameters become lookups, so that `find_undefined` can report them."""
    path, text = file.folder / file.model.file, file.unsaved.get(file.model.file)
    try:
        return read(path, known, surrogates, text, functions)
    except InputError as error:
        assumed = _find_assumed(
            path, text, [*known, *(s.name for s in surrogates), *(call for f in functions for call in f.calls)]
        )
        # `f.x` of a function f without an output x is a mistake, not the name of a parameter
        named = tuple(f"{function.name}." for function in functions)
        assumed = [name for name in assumed if not f"{name}.".startswith(named)]
        if not assumed:
            raise error from None
    return read(path, [*known, *assumed], surrogates, text, functions)


def _find_assumed(path: Path, text: str | None, known: Collection[str]) -> list[str]:
    """Return undefined tables, and undefined bare names if the text declares its inputs."""
    try:
        source = Source.of_text(path.name, path.read_text("utf-8-sig", errors="replace") if text is None else text)
    except OSError:
        return []
    # a scope without known names takes every name that is called for a table
    names = NameTable(parse(source), NameScope(), source)
    tables = [name for name in names.axes if name not in known]
    scalars = [name for name in names.uses if name not in (*names.inputs, *known, *tables)]
    # without declarations, an unknown bare name is an input
    return [*tables, *scalars] if names.inputs else tables


def _is_readable(file: ProjectFile, findings: Findings) -> bool:
    name, location = file.model.file, file.location("model", "file")
    path = file.folder / split_reference(name)[0]
    ending = path.suffix.casefold()
    stated = named_format(ending)
    if not path.is_file() and name not in file.unsaved:
        message = f"{name} is a folder" if path.is_dir() else f"file {name} does not exist"
        fixes = choices(("model", "file"), _functions_beside(file, path))
        findings.error(location, message, nearest(path.name, files_beside(path)) or "Check the path.", fixes=fixes)
    elif stated is not None and stated.remedy:
        findings.error(location, f"{name} is {stated.phrase}", stated.remedy)
    elif ending != ".kf" and importer_of(path.name) is None:
        findings.error(location, f"unknown model format {path.suffix or name}", _kinds_remedy())
    else:
        return True
    return False


def _functions_beside(file: ProjectFile, path: Path) -> list[str]:
    """Return the files beside a missing one that can be the function."""
    names = (name for name in files_beside(path) if name.casefold().endswith(".kf") or importer_of(name) is not None)
    folder = path.parent.relative_to(file.folder) if path.is_relative_to(file.folder) else path.parent
    return sorted((folder / name).as_posix() for name in names)


def _kinds_remedy() -> str:
    """Return which files can be the function."""
    kinds = ["formula text (.kf)"]
    for importer in importers():
        endings = [ending for known in importer.formats if not known.remedy for ending in known.endings]
        kinds.append(f"{importer.label} ({', '.join(endings)})")
    *first, last = kinds
    return f"Use {', '.join(first)} or {last}." if first else f"Use {last}."


def _extend_model(model: Model, file: ProjectFile, findings: Findings) -> Model:
    """Add each criterion's node and each target node under the text of the project file."""
    for criterion in file.criteria:
        texts = {"node": criterion.node}
        if criterion.target.kind == "node":
            texts["target"] = criterion.target.name
        for key, text in texts.items():
            model = _with_node(model, text, criterion.location.within(key), findings)
    return model


def _with_node(model: Model, text: str, location: Location, findings: Findings) -> Model:
    if not text or text in model.graph.names:
        return model
    # formula text would read the path of a block, A/B, as a division
    if siblings := _siblings(model.graph, text):
        subsystem = text.partition("/")[0]
        remedy = ("/" in text and nearest(text, siblings)) or f"{subsystem} has {', '.join(siblings[:8])}."
        findings.error(location, f"unknown node {text}", remedy)
        return model
    if _NAME.fullmatch(text):
        candidates = [name for name in model.graph.names if _NAME.fullmatch(name)]
        shown = list(model.graph.outputs[:12]) if model.values else candidates[-8:]
        nodes = f"The function has {', '.join(shown)}." if shown else "The function has no named nodes."
        remedy = nearest(text, candidates) or nodes
        findings.error(location, f"unknown node {text}", remedy)
        return model
    try:
        return extend(model, {text: text}, location)
    except InputError as error:
        findings.add(*error.findings)
        return model


def _siblings(graph: Graph, text: str) -> list[str]:
    """Return the nodes in the same top-level subsystem, if the text is the path of a block."""
    first = text.partition("/")[0]
    if first in graph.names or first in graph.inputs:
        return []
    return [name for name in graph.names if name.startswith(f"{first}/")]


def undefined_names(function: ProjectModel, known: Collection[str]) -> list[str]:
    """Return the names of the function that no file or section defines."""
    return [name for name in function.graph.parameters if name not in known]


def find_undefined(function: ProjectModel, known: Collection[str], channels: Collection[str] = ()) -> Iterator[Finding]:
    """Yield an error for each undefined name, with a snippet to copy.

    Args:
        function: the function.
        known: names of parameters.
        channels: the undefined names that are channels of the data, inputs that the text does not declare.
    """
    for name in undefined_names(function, known):
        count = function.graph.parameters[name]
        lines = _snippet(name, count, function)
        kinds = "a parameter" if count else "a node, an input, or a parameter"
        message = f"undefined name {name}: not {kinds} of any file or section"
        define = f"{lines[0]} {', '.join(lines[1:])}"
        if name in channels and not count:
            declaration = f"input {spell_name(name)}"
            remedy = (
                f"The data have a channel of this name; declare it: {declaration}. Or define a parameter: {define}."
            )
            yield Finding(function.place(name), message, remedy, declaration)
            continue
        # a name with coordinates may be a misspelt function, one without them a misspelt node
        others = FUNCTIONS if count else (*function.graph.inputs, *function.graph.names)
        guess = nearest(name, [*known, *others])
        remedy = f"{guess} {'Or define' if guess else 'Define'} it: {define}.".strip()
        yield Finding(function.place(name), message, remedy, "\n".join(lines))


def call_remedy(name: str) -> str:
    """Return how formula text calls a table that has the name of a built-in function; "" for other names."""
    if name not in FUNCTIONS:
        return ""
    return f"In formula text, {name}(...) is the built-in function. Write %{name}%(...) for the table."


def axis_count_finding(function: ProjectModel, name: str, kind: str, axes: int) -> Finding:
    """Return the error for a lookup whose number of coordinates differs from the table's number of axes."""
    count = function.graph.parameters[name]
    message = f"{name} is looked up with {count_noun(count, 'coordinate')}, but it is a {kind} with {axes} axes"
    return Finding(function.place(name), message, "Correct one of them.")


def _snippet(name: str, count: int, function: ProjectModel) -> list[str]:
    """Return lines of a project file that define a table, its axes named after the coordinates of the lookup."""
    graph = function.graph
    lines = [f"[parameters.{quoted(name)}]"]
    for direction, quantity in zip(DIRECTIONS, coordinates_of(graph, name)[:count], strict=False):
        # the data show the range of an input, but not that of a node
        spread = "count = 8" if quantity in graph.inputs else "begin = 0.0, end = 1.0, count = 8"
        named = f"input = {toml_text(quantity)}, " if quantity else ""
        lines.append(f"{direction} = {{ {named}{spread} }}")
    return [*lines, f"initial = {initial_level(graph, name)}"]


def initial_level(graph: Graph, parameter: str) -> float:
    """Return the default initial value of a parameter: 1 for a factor, else 0.

    The gradient of a product of two factors at 0 vanishes.

    >>> from kennfeld.models.formula import formula
    >>> graph = formula("y = A(u) * B(v) + C(u)").graph
    >>> initial_level(graph, "A"), initial_level(graph, "C")
    (1.0, 0.0)
    """
    return 1.0 if parameter in factors(graph) else 0.0
