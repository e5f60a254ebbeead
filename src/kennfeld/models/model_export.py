"""Writing of an imported model as formula text with a parameter file next to it."""

import textwrap
from collections.abc import Iterable
from pathlib import Path

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import toml_text
from kennfeld.files.file_format import call
from kennfeld.graph import Graph
from kennfeld.models.formula.line_wrapping import WIDTH
from kennfeld.models.formula.printer import TextLayout, to_lines
from kennfeld.models.importer import FormulaLine, Importer, ImportRequest
from kennfeld.models.model import Model


def formula_lines(importer: Importer, model: Model) -> list[FormulaLine]:
    """Return the formula text of an imported model, each line with the node that it calculates."""
    if importer.export:
        lines: list[FormulaLine] = call(importer.export, model)
        return lines
    # the text has the continuous equations, to which its `solver` line is applied again when it is read
    layout = TextLayout(descriptions=descriptions_of(model))
    printed = to_lines(model.equations or model.graph, model.step, model.solver, layout)
    return [FormulaLine(line.text, line.node if line.defines else "") for line in printed]


def descriptions_of(model: Model) -> dict[str, str]:
    """Return the descriptions of parameters, by their names."""
    return {parameter.name: parameter.description for parameter in model.values.parameters}


def is_formula(graph: Graph) -> bool:
    """Return if formula text can express a graph: it calls no foreign code, and has no layers of networks."""
    return not any(node.op in ("external", "dense") for node in graph.nodes)


def write_formula(importer: Importer, request: ImportRequest, target: Path) -> tuple[Path, ...]:
    """Write a model as formula text that gives the same results.

    Args:
        importer: the importer of the file.
        request: what to import.
        target: the `.kf` file; parameter values go to a `.json` of the same name.

    Returns:
        The paths written.

    Raises:
        InputError: a part of the model is not supported, formula text cannot express it, or a file cannot be written.
    """
    if target.suffix.lower() != ".kf":
        message = "unsupported file extension for formula text"
        raise InputError.of(Location(str(target)), message, "Use the extension .kf.")
    result = importer.import_(request)
    model = result.require_model()
    if not is_formula(model.graph):
        content = "layers of a network" if model.graph.layers else "machine code"
        message = f"holds {content}, which cannot be written as formula text"
        file = toml_text(request.path.name)
        remedy = f"Formula text can call it: write NAME = {file} under [functions] of a project file."
        raise InputError.of(Location(request.path.name), message, remedy)
    head: list[str] = call(importer.heading, request, result.report) if importer.heading else [request.path.name]
    lines = (line.text for line in formula_lines(importer, model))
    return _write(model, target, [f"{head[0]}, converted by Kennfeld", *head[1:]], lines)


def _write(model: Model, target: Path, head: Iterable[str], lines: Iterable[str]) -> tuple[Path, ...]:
    from kennfeld.calfiles import write as write_parameters

    comments = [part for line in head for part in _comment_lines(line)]
    paths = [target]
    try:
        write_whole(target, "\n".join([*comments, *lines, ""]), follow=True)
        if model.values:
            paths.append(target.with_suffix(".json"))
            write_parameters(model.values, paths[-1])
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise InputError.of(Location(str(target)), message, "Choose another output file.") from None
    return tuple(paths)


def _comment_lines(text: str) -> list[str]:
    """Return a comment as lines that begin with #, broken between words."""
    return textwrap.wrap(
        " ".join(text.split()),
        WIDTH,
        initial_indent="# ",
        subsequent_indent="#   ",
        break_long_words=False,
        break_on_hyphens=False,
    )
