"""Parameter scripts and the code in a model's callbacks: followed, never executed."""

import re
from dataclasses import replace
from pathlib import Path

from kennfeld.errors import Finding, InputError, nearest
from kennfeld.matlab.scripts import Files, run_script
from kennfeld.models.simulink.variables.enumerations import enumeration_of, is_class, variable_of
from kennfeld.models.simulink.variables.found import GIVEN, Variables, same
from kennfeld.models.simulink.variables.numbers import variable_from
from kennfeld.models.simulink.variables.scopes import Variable

__all__ = ["content", "run", "run_text"]

_NAME = re.compile(r"[\w.-]{1,128}\Z")


def run(found: Variables, path: Path) -> None:
    """Add the variables that a script makes; raises `InputError` where it cannot be read."""
    text = content(path).decode("utf-8", "replace")
    if is_class(text):
        _enumeration(found, text, path)
    else:
        run_text(found, text, path.name, path.parent)


def _enumeration(found: Variables, text: str, path: Path) -> None:
    made = enumeration_of(text)
    if made is None:
        raise InputError.of(path.name, "is a class, and none of whole numbers", "Give scripts and enumerations.")
    found[made[0]] = variable_of(made[1], path.name)


def run_text(found: Variables, text: str, name: str, folder: Path) -> None:
    """Add the variables that a text of MATLAB makes; those that it leaves without a value lose the one they had.

    What is given by name stays, so that it can stand in for what a script cannot say. Files that it loads are looked
    for in `folder` alone.
    """
    given = {key: variable.value for key, variable in found.items()}
    outcome = run_script(text, name, given, _beside(folder))
    found.findings += [replace(one, severity="warning") for one in outcome.findings]
    for key, value in outcome.variables.items():
        made = variable_from(value, name)
        if made is None:
            found.findings.append(Finding(f"{name} {key}", "it is of a kind that is not supported", severity="warning"))
            continue
        before = found.get(key)
        if before is None or not same(before.value, made.value):
            found[key] = _commented(made, outcome.comments.get(key, ""))
    for key, why in outcome.undefined.items():
        found.undefined[key] = why
        if key in found and found[key].source != GIVEN:
            del found[key]


def _commented(made: Variable, comment: str) -> Variable:
    return made if made.description or not comment else replace(made, description=comment)


def _beside(folder: Path) -> Files:
    def found(name: str) -> bytes | None:
        path = folder / name
        return content(path) if _NAME.match(name) and path.is_file() else None

    return found


def content(path: Path) -> bytes:
    """What a file holds; raises `InputError` where it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
        mend = nearest(path.name, beside) or "Check the path."
        raise InputError.of(str(path), "there is no such file", mend) from None
    except OSError as error:
        raise InputError.of(str(path), f"the file cannot be read: {error.strerror or error}") from None
