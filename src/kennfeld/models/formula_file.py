"""Writing of an imported model as formula text with a parameter file next to it."""

from collections.abc import Iterable
from pathlib import Path

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import InputError, Location
from kennfeld.models.model import Model


def check_formula_target(target: Path) -> None:
    """Raise `InputError` if a path is not that of formula text."""
    if target.suffix.lower() != ".kf":
        message = "unsupported file extension for formula text"
        raise InputError.of(Location(str(target)), message, "Use the extension .kf.")


def write_formula_file(model: Model, target: Path, head: Iterable[str], lines: Iterable[str]) -> tuple[Path, ...]:
    """Write a model as formula text.

    Args:
        model: the model; its parameter values go to a `.json` of the same name.
        target: the `.kf` file.
        head: comments at the top.
        lines: the formula text.

    Returns:
        The paths written.

    Raises:
        InputError: a file cannot be written.
    """
    from kennfeld.calfiles import write as write_parameters

    comments = [f"# {' '.join(line.split())}" for line in head]
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
