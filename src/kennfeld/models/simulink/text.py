"""A Simulink model as formula text, with its parameters in a file beside it."""

from collections.abc import Iterable
from pathlib import Path

from kennfeld.errors import InputError
from kennfeld.models.formula import to_text
from kennfeld.models.simulink.importing import import_simulink
from kennfeld.whole_files import write_whole

__all__ = ["write_formula"]


def write_formula(
    source: Path, target: Path, subsystem: str = "", parameters: Iterable[str | Path] = ()
) -> tuple[Path, ...]:
    """Write the model in a Simulink file as formula text that gives the same results, and give the paths written.

    What runs in another way than in Simulink stands in comments on top. The values of its parameters go to a `.json`
    of the same name, where there are some. Raises `InputError` where an output cannot be built, or nothing be written.
    """
    if target.suffix.lower() != ".kf":
        raise InputError.of(str(target), "a model is written as formula text", "Name a file that ends in .kf.")
    found = import_simulink(source, subsystem or None, parameters)
    if found.model is None:
        raise InputError(found.report.findings)
    head = [f"{source.name}{f', {subsystem}' if subsystem else ''}, read by Kennfeld", *found.report.substitutions]
    text = "".join(f"# {' '.join(line.split())}\n" for line in head) + to_text(found.model.graph, found.model.step)
    made = [target]
    try:
        write_whole(target, text)
        if found.model.values:
            made.append(target.with_suffix(".json"))
            found.model.values.save(made[-1])
    except OSError as error:
        raise InputError.of(str(target), f"cannot be written: {error.strerror or error}") from None
    return tuple(made)
