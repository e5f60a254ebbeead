"""The code in labels as statements and expressions of `kennfeld.matlab.syntax`, of both action languages.

The labels of states and transitions, taken apart; the code in them stays text.

name/ entry: code; during, exit: code; on E: code
event [condition] {condition action} / transition action
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression, parse_script
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.c_action_parser import ActionSyntaxError, c_expression, c_statements

__all__ = ["ActionLanguage", "calls_in", "map_children", "state_label", "transition_label", "walk", "without_comments"]

_STEP = re.compile(r"(?m)(^|[;,\n])([ \t]*)([A-Za-z]\w*(?:\.\w+)*(?:\([^()\n]*\))?)[ \t]*(\+\+|--)[ \t]*(?=$|[;,\n])")
_CHANGE = re.compile(r"(?m)(^|[;,\n])([ \t]*)([A-Za-z]\w*(?:\.\w+)*(?:\([^()\n]*\))?)[ \t]*([-+*/])=(?!=)([^;\n]*)")
_OR = re.compile(r"\|\||\|")

_KINDS = {
    "entry": "entry",
    "en": "entry",
    "during": "during",
    "du": "during",
    "dur": "during",
    "exit": "exit",
    "ex": "exit",
    "bind": "bind",
}
_WORD = (
    r"(?:entry|en|during|dur|du|exit|ex|bind|on[ \t]+(?:[^\s:;{}()]|\([^():;]*(?:\([^():;]*\)[^():;]*)*\))[^:;{}\n]*?)"
)
_HEAD = re.compile(rf"(?:^|(?<=[;\n\s,]))({_WORD}(?:\s*,\s*{_WORD})*)\s*:(?!=)", re.MULTILINE)
_ONE = re.compile(r"\s*,\s*(?=(?:entry|en|during|dur|du|exit|ex|bind|on)\b)")
_NAME = re.compile(r"\s*([A-Za-z_]\w*|\?)[ \t]*")
_COMMENTS = {"C": re.compile(r"/\*.*?\*/|//[^\n]*|(?<!%)%(?!%)[^\n]*|\.\.\.[^\n]*\n", re.DOTALL)}
_COMMENTS["MATLAB"] = re.compile(
    r"^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$|%[^\n]*|//[^\n]*|/\*.*?\*/", re.DOTALL | re.MULTILINE
)
_TEXT = {
    "C": re.compile(r'"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\''),
    "MATLAB": re.compile(r'"(?:[^"\n]|"")*"|(?<![\w)\]}.\'])\'(?:[^\'\n]|\'\')*\''),
}
_CLOSED_BY = {"(": ")", "[": "]", "{": "}"}


class ActionLanguage:
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
        except ActionSyntaxError as error:
            raise UnsupportedError(f"{place}: {error}") from None
        except InputError as error:
            raise UnsupportedError(f"{place}: {error.findings[0].message}") from None
        if script.functions:
            raise UnsupportedError(f"{place} defines a function")
        return script.statements

    def expression(self, code: str, place: str) -> m.Expression:
        """The expression of a condition."""
        try:
            return c_expression(code, self.bits) if self.name == "C" else parse_expression(code)
        except ActionSyntaxError as error:
            raise UnsupportedError(f"{place}: {error}") from None
        except InputError as error:
            raise UnsupportedError(f"{place}: {error.findings[0].message}") from None

    def events(self, code: str, place: str) -> tuple[m.Expression, ...]:
        """The events of a list, any of which is waited for."""
        return tuple(self.expression(part, place) for part in _OR.split(code)) if code.strip() else ()


def _plain(code: str) -> str:
    """MATLAB without `x++` and `x += y`, which charts know and MATLAB does not."""
    code = _STEP.sub(lambda f: f"{f[1]}{f[2]}{f[3]} = {f[3]} {f[4][0]} 1", code)
    return _CHANGE.sub(lambda f: f"{f[1]}{f[2]}{f[3]} = {f[3]} {f[4]} ({f[5].strip()})", code)


def walk(tree: object) -> Iterator[m.Expression]:
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


def map_children(tree: m.Expression, change: Callable[[m.Expression], m.Expression]) -> m.Expression:
    """An expression whose parts are replaced by what a function makes of them."""
    parts = {one.name: _changed(getattr(tree, one.name), change) for one in fields(tree) if one.name != "place"}
    return replace(tree, **parts)


def _changed(part: Any, change: Callable[[m.Expression], m.Expression]) -> Any:
    if isinstance(part, tuple):
        return tuple(_changed(one, change) for one in part)
    return change(part) if isinstance(part, m.Expression) else part


def calls_in(tree: object) -> Iterator[tuple[str, tuple[m.Expression, ...]]]:
    """The names that are called in expressions or statements, with their arguments."""
    for one in walk(tree):
        if isinstance(one, m.Call) and isinstance(one.of, m.Name):
            yield one.of.name, one.arguments


@dataclass(frozen=True, slots=True)
class ActionText:
    """Code of a state; `kind` is "entry", "during", "exit", "bind" or "on", then with the `event`."""

    kind: str
    code: str
    event: str = ""


@dataclass(frozen=True, slots=True)
class StateLabel:
    """The name of a state and its actions in their order; `bare` tells that the first ones stand under no keyword."""

    name: str
    actions: tuple[ActionText, ...] = ()
    bare: bool = False


@dataclass(frozen=True, slots=True)
class TransitionLabel:
    """What a transition waits for, what it asks, and what it does; `fault` says what is wrong with the label."""

    event: str = ""
    condition: str = ""
    condition_action: str = ""
    action: str = ""
    fault: str = field(default="", compare=False)


def without_comments(text: str, language: str) -> str:
    """A label without its comments, each of which leaves a blank or a line end; texts in quotes stay.

    >>> without_comments("a = 1; /* one */ b = 2; // two", "C")
    'a = 1;   b = 2;  '
    """
    comments, texts = _COMMENTS[language], _TEXT[language]
    made, at = [], 0
    for found in re.finditer(f"(?P<text>{texts.pattern})|(?P<comment>{comments.pattern})", text, comments.flags):
        made += [text[at : found.start()], found["text"] if found["text"] is not None else " "]
        at = found.end()
    return "".join(made) + text[at:]


def state_label(label: str, language: str = "C") -> StateLabel:
    r"""The parts of a state's label.

    What stands under no keyword is done at entry and during.

    >>> state_label("On/\nen, du: y = 1;\nex: y = 0;").actions[1]
    ActionText(kind='during', code='y = 1;', event='')
    """
    text = _cleaned(label, language)
    name = _NAME.match(text)
    if name is None:
        return StateLabel("")
    rest = text[name.end() :].lstrip().removeprefix("/")
    heads = list(_HEAD.finditer(rest))
    plain = rest[: heads[0].start()].strip() if heads else rest.strip()
    bare = bool(plain.strip(";, \t\n"))
    actions = [ActionText("entry", plain), ActionText("during", plain)] if bare else []
    ends = [*(head.start() for head in heads), len(rest)][1:]
    for head, end in zip(heads, ends, strict=True):
        code = rest[head.end() : end].strip()
        actions += [_action(word.strip(), code) for word in _ONE.split(head[1]) if code]
    return StateLabel(name[1], tuple(actions), bare)


def _cleaned(label: str, language: str) -> str:
    return without_comments(label.replace("\r\n", "\n").replace("\r", "\n"), language)


def _action(word: str, code: str) -> ActionText:
    return ActionText(_KINDS[word], code) if word in _KINDS else ActionText("on", code, word[2:].strip())


def transition_label(label: str, language: str = "C") -> TransitionLabel:
    """The parts of a transition's label.

    >>> found = transition_label("after(a/b, sec)[x[1] > 0]{y = 1;}/{z = 2;}")
    >>> found.event, found.condition, found.condition_action, found.action
    ('after(a/b, sec)', 'x[1] > 0', 'y = 1;', 'z = 2;')
    """
    text = _cleaned(label, language).strip()
    if text == "?":
        return TransitionLabel()
    event, at = _event(text, language)
    condition, condition_action, end, fault = _bracketed(text, at, language)
    action, rest = "", text[end:].strip()
    if rest.startswith("/"):
        action = _bare(rest[1:].strip(), language)
    elif rest:
        fault = fault or f"{rest[:40]!r} does not belong to it"
    return TransitionLabel(event, condition, condition_action, action, fault)


def _bracketed(text: str, at: int, language: str) -> tuple[str, str, int, str]:
    """The condition and the condition action from a place on, where they end, and what is wrong with them."""
    found, fault = {"[": "", "{": ""}, ""
    while at < len(text) and text[at] in "[{ \t\n":
        if not text[at].isspace():
            end = _close(text, at, language)
            if end < 0:
                return "", "", len(text), f"{text[at]} is never closed"
            inside = text[at + 1 : end].strip()
            if found[text[at]] and inside:
                fault = f"it has two parts in {text[at]}{_CLOSED_BY[text[at]]}"
            found[text[at]] = found[text[at]] or inside
            at = end
        at += 1
    return found["["], found["{"], at, fault


def _event(text: str, language: str) -> tuple[str, int]:
    """What stands before the condition and the actions, and where that ends."""
    at = 0
    while at < len(text) and text[at] not in "[{/":
        if text[at] == "(":
            end = _close(text, at, language)
            at = end if end >= 0 else len(text) - 1
        at += 1
    return text[:at].strip().rstrip(";").strip(), at


def _close(text: str, at: int, language: str) -> int:
    """Where the bracket at a place is closed; -1 where it is not."""
    open_: list[str] = []
    texts = _TEXT[language]
    while at < len(text):
        character = text[at]
        quoted = texts.match(text, at) if character in "\"'" else None
        if quoted is not None:
            at = quoted.end()
            continue
        if character in _CLOSED_BY:
            open_.append(_CLOSED_BY[character])
        elif character in ")]}":
            if not open_ or open_.pop() != character:
                return -1
            if not open_:
                return at
        at += 1
    return -1


def _bare(code: str, language: str) -> str:
    """A transition action without the braces that may stand around it."""
    if code.startswith("{"):
        end = _close(code, 0, language)
        if end >= 0 and not code[end + 1 :].strip(" \t\n;"):
            return code[1:end].strip()
    return code
