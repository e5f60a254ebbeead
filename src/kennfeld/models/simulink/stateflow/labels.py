"""The labels of states and transitions, taken apart; the code in them stays text.

name/ entry: code; during, exit: code; on E: code
event [condition] {condition action} / transition action
"""

import re
from dataclasses import dataclass, field

__all__ = ["Action", "StateLabel", "TransitionLabel", "state_label", "transition_label", "without_comments"]

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


@dataclass(frozen=True, slots=True)
class Action:
    """Code of a state; `kind` is "entry", "during", "exit", "bind" or "on", then with the `event`."""

    kind: str
    code: str
    event: str = ""


@dataclass(frozen=True, slots=True)
class StateLabel:
    """The name of a state and its actions in their order; `bare` tells that the first ones stand under no keyword."""

    name: str
    actions: tuple[Action, ...] = ()
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
    Action(kind='during', code='y = 1;', event='')
    """
    text = _cleaned(label, language)
    name = _NAME.match(text)
    if name is None:
        return StateLabel("")
    rest = text[name.end() :].lstrip().removeprefix("/")
    heads = list(_HEAD.finditer(rest))
    plain = rest[: heads[0].start()].strip() if heads else rest.strip()
    bare = bool(plain.strip(";, \t\n"))
    actions = [Action("entry", plain), Action("during", plain)] if bare else []
    ends = [*(head.start() for head in heads), len(rest)][1:]
    for head, end in zip(heads, ends, strict=True):
        code = rest[head.end() : end].strip()
        actions += [_action(word.strip(), code) for word in _ONE.split(head[1]) if code]
    return StateLabel(name[1], tuple(actions), bare)


def _cleaned(label: str, language: str) -> str:
    return without_comments(label.replace("\r\n", "\n").replace("\r", "\n"), language)


def _action(word: str, code: str) -> Action:
    return Action(_KINDS[word], code) if word in _KINDS else Action("on", code, word[2:].strip())


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
