"""The data-driven models that a project file names: `[surrogates] engine = "engine.json"`."""

from dataclasses import replace
from typing import TYPE_CHECKING

from kennfeld.errors import Finding, InputError, nearest
from kennfeld.project.schema import ProjectFile

if TYPE_CHECKING:  # most projects have none
    from kennfeld.surrogate import Surrogate

__all__ = ["read_surrogates"]


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
            what = "is built in" if name in FUNCTIONS else "is no name that formula text can call"
            findings.append(Finding(file.place(f"[surrogates] {name}"), f"{name} {what}", "Use another name."))
            continue
        target = file.folder / path
        if not target.is_file():
            beside = [one.name for one in target.parent.iterdir() if one.is_file()] if target.parent.is_dir() else []
            mend = nearest(target.name, beside) or "Train it with `kennfeld surrogate train`."
            findings.append(Finding(file.place(f"[surrogates] {name}"), f"there is no file {path}", mend))
            continue
        try:
            made.append(replace(read_surrogate(target), name=name))
        except InputError as error:
            findings += error.findings
    return tuple(made)
