"""The labels of states and transitions, and the code in them, of both action languages.

name/ entry: code; during, exit: code; on E: code
event [condition] {condition action} / transition action
"""

import re
from dataclasses import field

from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.c_action_parser import (
    ActionSyntaxError,
    parse_c_expression,
    parse_c_statements,
)
from kennfeld.matlab.parser import parse_expression, parse_script
from kennfeld.program import tree as m

# MATLAB has neither `x++` nor `x += y`; Stateflow takes both as statements of this language, too
_STEP = re.compile(r"(?m)(^|[;,\n])([ \t]*)([A-Za-z]\w*(?:\.\w+)*(?:\([^()\n]*\))?)[ \t]*(\+\+|--)[ \t]*(?=$|[;,\n])")
_CHANGE = re.compile(r"(?m)(^|[;,\n])([ \t]*)([A-Za-z]\w*(?:\.\w+)*(?:\([^()\n]*\))?)[ \t]*([-+*/])=(?!=)([^;\n]*)")
_OR = re.compile(r"\|\||\|")

_KINDS = {
    **dict.fromkeys(("entry", "en"), "entry"),
    **dict.fromkeys(("during", "dur", "du"), "during"),
    **dict.fromkeys(("exit", "ex"), "exit"),
    "bind": "bind",
}
_KEYWORDS = "|".join(_KINDS)
_WORD = rf"(?:{_KEYWORDS}|on[ \t]+(?:[^\s:;{{}}()]|\([^():;]*(?:\([^():;]*\)[^():;]*)*\))[^:;{{}}\n]*?)"
# := is an assignment, not the end of a keyword
_HEAD = re.compile(rf"(?:^|(?<=[;\n\s,]))({_WORD}(?:\s*,\s*{_WORD})*)\s*:(?!=)", re.MULTILINE)
_ONE = re.compile(rf"\s*,\s*(?=(?:{_KEYWORDS}|on)\b)")
_NAME = re.compile(r"\s*([A-Za-z_]\w*|\?)[ \t]*")
# in C, % begins a comment and %% is the remainder; ... continues a line
_COMMENTS = {"C": re.compile(r"/\*.*?\*/|//[^\n]*|(?<!%)%(?!%)[^\n]*|\.\.\.[^\n]*\n", re.DOTALL)}
_COMMENTS["MATLAB"] = re.compile(
    r"^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$|%[^\n]*|//[^\n]*|/\*.*?\*/", re.DOTALL | re.MULTILINE
)
_TEXT = {
    "C": re.compile(r'"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\''),
    # ' behind a name or a bracket is the transpose
    "MATLAB": re.compile(r'"(?:[^"\n]|"")*"|(?<![\w)\]}.\'])\'(?:[^\'\n]|\'\')*\''),
}
_CLOSED_BY = {"(": ")", "[": "]", "{": "}"}


@dataclass(frozen=True, slots=True)
class ActionText:
    """Code of a state; `kind` is "entry", "during", "exit", "bind" or "on", the latter with its `event`."""

    kind: str
    code: str
    event: str = ""


@dataclass(frozen=True, slots=True)
class StateLabel:
    """The name and the actions of a state; `bare` is True if the first actions have no keyword."""

    name: str
    actions: tuple[ActionText, ...] = ()
    bare: bool = False


@dataclass(frozen=True, slots=True)
class TransitionLabel:
    """The parts of a transition label; `fault` describes a syntax error."""

    event: str = ""
    condition: str = ""
    condition_action: str = ""
    action: str = ""
    fault: str = field(default="", compare=False)


def parse_state_label(label: str, language: str = "C") -> StateLabel:
    r"""Parse the label of a state; code without a keyword runs at entry and during.

    >>> parse_state_label("On/\nen, du: y = 1;\nex: y = 0;").actions[1]
    ActionText(kind='during', code='y = 1;', event='')
    """
    text = _clean(label, language)
    name = _NAME.match(text)
    if name is None:
        return StateLabel("")
    # the slash behind the name is optional
    rest = text[name.end() :].lstrip().removeprefix("/")
    heads = list(_HEAD.finditer(rest))
    plain = rest[: heads[0].start()].strip() if heads else rest.strip()
    bare = bool(plain.strip(";, \t\n"))
    actions = [ActionText("entry", plain), ActionText("during", plain)] if bare else []
    ends = [*(head.start() for head in heads), len(rest)][1:]
    for head, end in zip(heads, ends, strict=True):
        code = rest[head.end() : end].strip()
        for word in map(str.strip, _ONE.split(head[1])) if code else ():
            event = "" if word in _KINDS else word[2:].strip()
            actions.append(ActionText(_KINDS.get(word, "on"), code, event))
    return StateLabel(name[1], tuple(actions), bare)


def parse_transition_label(label: str, language: str = "C") -> TransitionLabel:
    """Parse the label of a transition.

    >>> label = parse_transition_label("after(a/b, sec)[x[1] > 0]{y = 1;}/{z = 2;}")
    >>> label.event, label.condition, label.condition_action, label.action
    ('after(a/b, sec)', 'x[1] > 0', 'y = 1;', 'z = 2;')
    """
    text = _clean(label, language).strip()
    # Stateflow shows a question mark in place of an empty label
    if text == "?":
        return TransitionLabel()
    event, at = _event(text, language)
    condition, condition_action, end, fault = _bracketed(text, at, language)
    action, rest = "", text[end:].strip()
    if rest.startswith("/"):
        action = _bare(rest[1:].strip(), language)
    elif rest:
        fault = fault or f"unexpected {rest[:40]!r}"
    return TransitionLabel(event, condition, condition_action, action, fault)


def strip_comments(text: str, language: str) -> str:
    """Replace the comments of a label by blanks; quoted text stays.

    >>> strip_comments("a = 1; /* one */ b = 2; // two", "C")
    'a = 1;   b = 2;  '
    """
    comments, texts = _COMMENTS[language], _TEXT[language]
    parts, at = [], 0
    # texts are matched, too, so that no comment begins within one
    for match in re.finditer(f"(?P<text>{texts.pattern})|(?P<comment>{comments.pattern})", text, comments.flags):
        parts += [text[at : match.start()], match["text"] if match["text"] is not None else " "]
        at = match.end()
    return "".join(parts) + text[at:]


class ActionLanguage:
    """Parses the code of a chart; raises `UnsupportedError` with the place."""

    def __init__(self, name: str, bits: bool = False) -> None:
        self.name = name
        self.bits = bits

    def statements(self, code: str, place: str) -> m.Statements:
        """Parse the statements of an action."""
        if not code.strip():
            return ()
        try:
            if self.name == "C":
                return parse_c_statements(code, self.bits)
            script = parse_script(_expand_updates(code))
        except ActionSyntaxError as error:
            raise UnsupportedError(f"{place}: {error}") from None
        except InputError as error:
            raise UnsupportedError(f"{place}: {error.findings[0].message}") from None
        if script.functions:
            raise UnsupportedError(f"{place}: functions cannot be defined here")
        return script.statements

    def expression(self, code: str, place: str) -> m.Expression:
        """Parse a condition."""
        try:
            return parse_c_expression(code, self.bits) if self.name == "C" else parse_expression(code)
        except ActionSyntaxError as error:
            raise UnsupportedError(f"{place}: {error}") from None
        except InputError as error:
            raise UnsupportedError(f"{place}: {error.findings[0].message}") from None

    def events(self, code: str, place: str) -> m.Expressions:
        """Parse a list of alternative events."""
        return tuple(self.expression(part, place) for part in _OR.split(code)) if code.strip() else ()


def _expand_updates(code: str) -> str:
    """Rewrite `x++` and `x += y`, which MATLAB lacks."""
    code = _STEP.sub(lambda f: f"{f[1]}{f[2]}{f[3]} = {f[3]} {f[4][0]} 1", code)
    return _CHANGE.sub(lambda f: f"{f[1]}{f[2]}{f[3]} = {f[3]} {f[4]} ({f[5].strip()})", code)


def _clean(label: str, language: str) -> str:
    return strip_comments(label.replace("\r\n", "\n").replace("\r", "\n"), language)


def _bracketed(text: str, at: int, language: str) -> tuple[str, str, int, str]:
    """Return condition, condition action, their end, and a syntax error from an offset on."""
    parts, fault = {"[": "", "{": ""}, ""
    while at < len(text) and text[at] in "[{ \t\n":
        if not text[at].isspace():
            end = _close(text, at, language)
            if end < 0:
                return "", "", len(text), f"{text[at]} is never closed"
            inside = text[at + 1 : end].strip()
            if parts[text[at]] and inside:
                fault = f"two parts in {text[at]}{_CLOSED_BY[text[at]]}"
            parts[text[at]] = parts[text[at]] or inside
            at = end
        at += 1
    return parts["["], parts["{"], at, fault


def _event(text: str, language: str) -> tuple[str, int]:
    """Return the event in front of condition and actions, and its end."""
    at = 0
    while at < len(text) and text[at] not in "[{/":
        if text[at] == "(":
            end = _close(text, at, language)
            at = end if end >= 0 else len(text) - 1
        at += 1
    return text[:at].strip().rstrip(";").strip(), at


def _close(text: str, at: int, language: str) -> int:
    """Return the offset of the closing bracket; -1 if there is none."""
    open_: list[str] = []
    texts = _TEXT[language]
    while at < len(text):
        character = text[at]
        # brackets in a text close nothing
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
    """Remove the optional braces around a transition action."""
    if code.startswith("{"):
        end = _close(code, 0, language)
        if end >= 0 and not code[end + 1 :].strip(" \t\n;"):
            return code[1:end].strip()
    return code
