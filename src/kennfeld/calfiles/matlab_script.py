"""MATLAB scripts (.m) as parameters: their assignments are read, nothing is executed."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.calfiles.format import Content, Notes, Source
from kennfeld.calfiles.matlab_expressions import value_of
from kennfeld.calfiles.matlab_tokens import BadSyntaxError, Statement, Token, statements
from kennfeld.calfiles.matlab_values import Struct, Value, parameters_of

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
    script = _Script(notes)
    for statement in statements(source.text.lstrip("\ufeff")):
        if not script.take(statement):
            break
    script.settle()
    parameters = parameters_of(script.variables, notes, script.lines)
    if not parameters.chosen and not source.text.lstrip("\ufeff").startswith(TITLE):
        notes.error(0, "", "assigns no numbers", "A parameter looks like: K = 0.08;")
    return Content("MATLAB script", parameters, notes.settle())


@dataclass
class _Script:
    notes: Notes
    variables: dict[str, Value] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    said: dict[str, tuple[str, str]] = field(default_factory=dict)  # unit and description of a variable
    axis_units: dict[tuple[str, str], str] = field(default_factory=dict)
    depth: int = 0  # of blocks that are left aside
    in_function: bool = False
    left: int = _MOST_VALUES

    def take(self, statement: Statement) -> bool:
        """Follow one statement; False where the rest of the text is none of the script."""
        first = statement.tokens[0].text if statement.tokens and statement.tokens[0].kind == "name" else ""
        if statement.is_open:
            what = "opens a bracket that is never closed"
            self.notes.error(statement.line, "", what, "Close it.", statement.text[:200])
        elif first == "function":
            again, self.in_function = self.in_function or bool(self.variables), True
            if again:
                self._left_aside(statement, "and the rest of the script")
            return not again
        elif first in _BLOCKS:
            if not self.depth:
                self._left_aside(statement, "and what it decides")
            self.depth += 1
            self._forget(statement.tokens)
        elif first == "end" and len(statement.tokens) == 1:
            self.depth = max(self.depth - 1, 0)
        elif self.depth:
            self._forget(statement.tokens)
        else:
            self._assign(statement)
        return self.left >= 0

    def _assign(self, statement: Statement) -> None:
        tokens = statement.tokens
        try:
            path, rest = _target(tokens)
            value = value_of(rest, self._lookup)
            self.left -= _size(value, 0)
            if self.left < 0:
                what = f"assigns more than {_MOST_VALUES} values up to here, which no calibration has"
                self.notes.error(statement.line, "", what)
                return
            self._set(path, value)
        except BadSyntaxError:
            named = _NAME.match(statement.text)
            self._forget(tokens or ([Token("name", named[0], False)] if named else []))
            if statement.text != "return":
                self._left_aside(statement)
            return
        self.lines.setdefault(path[0], statement.line)
        self._heed(path, statement.comment)

    def _left_aside(self, statement: Statement, more: str = "") -> None:
        excerpt = " ".join(statement.text.split())[:_EXCERPT]
        what = f"{excerpt!r} {more + ' ' if more else ''}assigns no plain numbers; left aside"
        self.notes.remark(statement.line, "", what)

    def _forget(self, tokens: Sequence[Token]) -> None:
        """What is assigned in a way that is not followed has no value any more."""
        for at, token in enumerate(tokens):
            assigned = at == 0 or (at + 1 < len(tokens) and tokens[at + 1].text == "=")
            if token.kind == "name" and assigned:
                self.variables.pop(token.text, None)

    def _lookup(self, path: str) -> "Value | None":
        name, *rest = path.split(".")
        value = self.variables.get(name)
        for step in rest:
            value = value.fields.get(step) if isinstance(value, Struct) else None
        return value

    def _set(self, path: tuple[str, tuple[Step, ...]], value: Value) -> None:
        name, steps = path
        if not steps:
            self.variables[name] = _copied(value)
            return
        holder: dict[str, Value] = self.variables
        key = name
        for at, step in enumerate(steps):
            if isinstance(step, int):
                holder, key = _element(holder, key, step, whole=at == len(steps) - 1)
                continue
            inner = holder.setdefault(key, Struct())
            if not isinstance(inner, Struct):
                raise BadSyntaxError
            holder, key = inner.fields, step
        holder[key] = _copied(value)

    def _heed(self, path: tuple[str, tuple[Step, ...]], comment: str) -> None:
        """What the comment behind an assignment says about its value."""
        unit, description = said_by(comment)
        name, steps = path
        if not steps or (len(steps) == 1 and str(steps[0]).casefold() in _VALUES and comment):
            self.said[name] = (unit, description)
        elif len(steps) == 1 and unit and steps[0] in tuple("xyzw"):
            self.axis_units[name, str(steps[0])] = unit

    def settle(self) -> None:
        """Add what comments said to the variables, unless fields say it."""
        info = self.variables.setdefault("kennfeld_info", Struct())
        for name, (unit, description) in self.said.items():
            value = self.variables.get(name)
            own = info.fields.setdefault(name, Struct()) if isinstance(info, Struct) else value
            target = value if isinstance(value, Struct) else own
            if isinstance(target, Struct):
                for key, word in (("unit", unit), ("description", description)):
                    if word and key not in target.folded():
                        target.fields[key] = word
        for (name, letter), unit in self.axis_units.items():
            value = self.variables.get(name)
            if isinstance(value, Struct) and f"{letter}unit" not in value.folded():
                value.fields[f"{letter}_unit"] = unit


def _target(tokens: Sequence[Token]) -> tuple[tuple[str, tuple[Step, ...]], Sequence[Token]]:
    """The variable that a statement assigns to, with fields and places, and the words behind its equals sign."""
    if not tokens or tokens[0].kind != "name":
        raise BadSyntaxError
    steps: list[Step] = []
    at = 1
    while at < len(tokens) and tokens[at].text != "=":
        words = tokens[at : at + 3]
        if words[0].text == "." and len(words) > 1 and words[1].kind == "name":
            steps.append(words[1].text)
            at += 2
        elif len(words) == 3 and words[0].text + words[2].text in ("()", "{}") and words[1].text.isdigit():
            steps.append(int(words[1].text[:6]))
            at += 3
        else:
            raise BadSyntaxError
    if at >= len(tokens) - 1 or len(steps) > 50:
        raise BadSyntaxError
    return (tokens[0].text, tuple(steps)), tokens[at + 1 :]


def _element(holder: dict[str, Value], key: str, index: int, whole: bool) -> tuple[dict[str, Value], str]:
    """Where a place of a list is kept, as if it were a field; the list grows up to it."""
    known = holder.get(key)
    if known is None or isinstance(known, Struct):
        known = holder[key] = [known] if known is not None else []
    if not isinstance(known, list) or whole or not 1 <= index <= _MOST_INDEX:
        raise BadSyntaxError
    known += [Struct() for _ in range(index - len(known))]
    element = known[index - 1]
    if not isinstance(element, Struct):
        raise BadSyntaxError
    return {"": element}, ""


def _size(value: Value, depth: int) -> int:
    """How many values an assignment copies; a struct that holds itself over and over would double each time."""
    if depth > _MOST_DEPTH:
        raise BadSyntaxError
    if isinstance(value, Struct):
        return _FIELD + sum(_size(inner, depth + 1) for inner in value.fields.values())
    if isinstance(value, list):
        return _FIELD + sum(_size(inner, depth + 1) for inner in value)
    return _FIELD + (value.size if isinstance(value, np.ndarray) else 0)


def _copied(value: Value) -> Value:
    """A struct of its own, as an assignment in MATLAB gives."""
    if isinstance(value, Struct):
        return Struct({name: _copied(inner) for name, inner in value.fields.items()})
    return [_copied(inner) for inner in value] if isinstance(value, list) else value


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
