"""MATLAB scripts (.m) as parameters: their assignments are read, nothing is executed."""

import re
from collections.abc import Mapping

from kennfeld.calfiles.format import Content, Notes, Source
from kennfeld.calfiles.matlab_plain import plain_of
from kennfeld.calfiles.matlab_values import INFO, Struct, Value, parameters_of
from kennfeld.matlab.budget import Budget
from kennfeld.matlab.scripts import Files, run_script

__all__ = ["TITLE", "comment_of", "read_script", "recognises_script", "said_by"]

TITLE = "% Kennfeld calibration"
_ASSIGNMENT = re.compile(r"[A-Za-z]\w*(?:\.\w+|\(\d+\)|\{\d+\})*[ \t]*=[ \t]*(?:\[|(?!=)[^;\n]*(?:;|\.\.\.))")
_HARMLESS = re.compile(r"(?:clear|clc|close|function|format|clearvars)\b[^:]*")
_NAME = re.compile(r"[A-Za-z]\w*")
_BLOCKS = frozenset({"if", "for", "while", "switch", "try", "parfor", "spmd", "classdef"})
_COMMENT = re.compile(r"(?:\[([^\[\]]*)\])?[ \t]*(.*)", re.DOTALL)
_VALUES = frozenset({"value", "values", "data"})
_MOST_INDEX = 1000
_MOST_DEPTH = 50
_FIELD = 100  # values that take the memory of one field
_MOST_VALUES = 20_000_000  # that a script assigns
_LARGEST = 200_000_000  # bytes of a file beside it
_HEAD_LINES = 400
_EXCERPT = 60
_LONGEST_LINE = 500  # characters of a command that is no assignment

Step = str | int  # a field, or a place in a list


def recognises_script(text: str) -> bool:
    """Whether a text begins like a script that assigns numbers."""
    text = text.lstrip("\ufeff")
    if text.startswith(TITLE):
        return True
    for line in text.split("\n", _HEAD_LINES)[:_HEAD_LINES]:
        line = line.strip()
        if _ASSIGNMENT.match(line):
            return True
        if line and line[0] not in "%#" and not _HARMLESS.fullmatch(line[:_LONGEST_LINE]):
            return False
    return False


def read_script(source: Source) -> Content:
    """The parameters that a script assigns: numbers, matrices, texts, structs with axes and values.

    The comment behind a value, `% [Nm] torque at full load`, gives its unit and description. Other statements are told
    with their line and left aside, with the variables they would change. Raises `InputError` with every finding.
    """
    notes = Notes(source.name)
    text = source.text.lstrip("\ufeff")
    outcome = run_script(text, source.name, files=_beside(source), budget=Budget(elements=_MOST_VALUES))
    for finding in outcome.findings:
        notes.take(finding)
    variables = {name: plain_of(value) for name, value in outcome.variables.items()}
    _heed(variables, outcome.comments)
    parameters = parameters_of(variables, notes, outcome.lines)
    if not parameters.chosen and not text.startswith(TITLE):
        notes.error(0, "", "assigns no numbers", "A parameter looks like: K = 0.08;")
    return Content("MATLAB script", parameters, notes.settle())


def _beside(source: Source) -> Files:
    """The scripts and data files in the folder of a script, which it may call and load."""
    folder = None if source.path is None else source.path.parent

    def content(name: str) -> bytes | None:
        if folder is None or "/" in name or "\\" in name or not (folder / name).is_file():
            return None
        file = folder / name
        return file.read_bytes() if file.stat().st_size < _LARGEST else None

    return content


def _heed(variables: dict[str, Value], comments: Mapping[str, str]) -> None:
    """What the comments behind values say, unless fields say it: unit and description of a value, units of axes."""
    info = variables.setdefault(INFO, Struct())
    for path, comment in comments.items():
        name, _, step = path.partition(".")
        unit, description = said_by(comment)
        value = variables.get(name)
        if not step or step.casefold() in _VALUES:
            own = info.fields.setdefault(name, Struct()) if isinstance(info, Struct) else value
            _add(value if isinstance(value, Struct) else own, {"unit": unit, "description": description})
        elif step in tuple("xyzw") and isinstance(value, Struct) and f"{step}unit" not in value.folded():
            _add(value, {f"{step}_unit": unit})


def _add(target: Value | None, said: Mapping[str, str]) -> None:
    if isinstance(target, Struct):
        known = target.folded()
        target.fields.update({key: word for key, word in said.items() if word and key not in known})


def said_by(comment: str) -> tuple[str, str]:
    """Unit and description in the comment behind a value.

    >>> said_by(" [Nm] torque at full load")
    ('Nm', 'torque at full load')
    """
    found = _COMMENT.fullmatch(comment.strip())
    return ((found[1] or "").strip(), found[2].strip()) if found else ("", "")


def comment_of(unit: str, description: str) -> str | None:
    """The comment that says so; None where it would be read otherwise."""
    words = [f"[{unit}]"] if unit else []
    made = " ".join([*words, description]) if description else "".join(words)
    plain = not re.search(r"[\x00-\x1f\x7f\ud800-\udfff]", made)
    return made if plain and said_by(made) == (unit, description) else None
