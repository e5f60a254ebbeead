"""Export of an ESDL class or task as formula text with a parameter file next to it."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from kennfeld.base.errors import InputError
from kennfeld.importers.ascet.importing import import_esdl
from kennfeld.models.formula import to_lines
from kennfeld.models.formula.printer import PrintedLine
from kennfeld.models.formula_file import check_formula_target, write_formula_file
from kennfeld.models.model import Model


def write_esdl_formula(
    source: str | Path,
    target: str | Path,
    class_name: str = "",
    methods: Iterable[str] = (),
    *,
    task: str | Iterable[str] = "",
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> tuple[Path, ...]:
    """Write a class or tasks of an ASCET project as formula text that gives the same results.

    Args:
        source: the `.esdl` or `.app` file.
        target: the `.kf` file; parameter values go to a `.json` of the same name.
        class_name: name of the class.
        methods: methods that a step calls.
        task: name of the task, or several, or `*` for all periodic ones.
        folders: folders with further projects.
        step: time step in s that replaces the one of the tasks.

    Returns:
        The paths written.

    Raises:
        InputError: a part of the program is not supported, or a file cannot be written.
    """
    source, target = Path(source), Path(target)
    check_formula_target(target)
    result = import_esdl(source, class_name, methods, task=task, folders=folders, step=step)
    if result.model is None:
        raise InputError(result.report.findings)
    remarks = [str(remark) for remark in result.report.remarks]
    head = [f"{source.name}, {', '.join(result.report.methods)}, converted by Kennfeld", *remarks]
    return write_formula_file(result.model, target, head, (line.text for line in formula_lines(result.model)))


def formula_lines(model: Model) -> Sequence[PrintedLine]:
    """Return the formula text of an imported model, each line with the node that it belongs to."""
    return to_lines(model.graph, model.step)
