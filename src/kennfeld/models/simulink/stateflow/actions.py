"""The code in labels as statements and expressions of `kennfeld.matlab.syntax`, of both action languages."""

import re
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from typing import Any

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression, parse_script
from kennfeld.models.simulink.stateflow.clanguage import CError, c_expression, c_statements
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["Language", "calls_in", "changed", "within"]

_STEP = re.compile(r"(?m)(^|[;,\n])([ \t]*)([A-Za-z]\w*(?:\.\w+)*(?:\([^()\n]*\))?)[ \t]*(\+\+|--)[ \t]*(?=$|[;,\n])")
_CHANGE = re.compile(r"(?m)(^|[;,\n])([ \t]*)([A-Za-z]\w*(?:\.\w+)*(?:\([^()\n]*\))?)[ \t]*([-+*/])=(?!=)([^;\n]*)")
_OR = re.compile(r"\|\||\|")


class Language:
    """Reads the code of one chart; raises `UnsupportedError` that names the place."""

    def __init__(self, name: str, bits: bool = False) -> None:
        self.name = name
        self.bits = bits

    def statements(self, code: str, place: str) -> tuple[m.Statement, ...]:
        """The statements of actions."""
        if not code.strip():
            return ()
        try:
            if self.name == "C":
                return c_statements(code, self.bits)
            script = parse_script(_plain(code))
        except CError as error:
            raise UnsupportedError(f"{place}: {error}") from None
        except InputError as error:
            raise UnsupportedError(f"{place}: {error.findings[0].what}") from None
        if script.functions:
            raise UnsupportedError(f"{place} defines a function")
        return script.statements

    def expression(self, code: str, place: str) -> m.Expression:
        """The expression of a condition."""
        try:
            return c_expression(code, self.bits) if self.name == "C" else parse_expression(code)
        except CError as error:
            raise UnsupportedError(f"{place}: {error}") from None
        except InputError as error:
            raise UnsupportedError(f"{place}: {error.findings[0].what}") from None

    def events(self, code: str, place: str) -> tuple[m.Expression, ...]:
        """The events of a list, any of which is waited for."""
        return tuple(self.expression(part, place) for part in _OR.split(code)) if code.strip() else ()


def _plain(code: str) -> str:
    """MATLAB without `x++` and `x += y`, which charts know and MATLAB does not."""
    code = _STEP.sub(lambda f: f"{f[1]}{f[2]}{f[3]} = {f[3]} {f[4][0]} 1", code)
    return _CHANGE.sub(lambda f: f"{f[1]}{f[2]}{f[3]} = {f[3]} {f[4]} ({f[5].strip()})", code)


def within(tree: object) -> Iterator[m.Expression]:
    """All expressions in expressions or statements, the outer ones first."""
    waiting = [tree]
    while waiting:
        one = waiting.pop()
        if isinstance(one, m.Expression):
            yield one
            waiting += reversed(list(m.children(one)))
        elif isinstance(one, tuple):
            waiting += reversed(one)
        elif hasattr(one, "__dataclass_fields__"):
            waiting += [getattr(one, name) for name in reversed(list(one.__dataclass_fields__))]


def changed(tree: m.Expression, change: Callable[[m.Expression], m.Expression]) -> m.Expression:
    """An expression whose parts are replaced by what a function makes of them."""
    parts = {one.name: _changed(getattr(tree, one.name), change) for one in fields(tree) if one.name != "place"}
    return replace(tree, **parts)


def _changed(part: Any, change: Callable[[m.Expression], m.Expression]) -> Any:
    if isinstance(part, tuple):
        return tuple(_changed(one, change) for one in part)
    return change(part) if isinstance(part, m.Expression) else part


def calls_in(tree: object) -> Iterator[tuple[str, tuple[m.Expression, ...]]]:
    """The names that are called in expressions or statements, with their arguments."""
    for one in within(tree):
        if isinstance(one, m.Call) and isinstance(one.of, m.Name):
            yield one.of.name, one.arguments
