"""Formula text to tokens, and tokens to statements: one a line, longer while a bracket is open."""

import re
from collections.abc import Iterable, Iterator, Sequence

from kennfeld.models.formula.syntax import Token

__all__ = ["DECLARATIONS", "FOREIGN", "RESERVED", "is_plain", "statements", "tokens"]

DECLARATIONS = frozenset({"input", "output", "scalar", "curve", "map", "cube", "rbf", "step", "def"})
RESERVED = frozenset({"and", "or", "not", "if", "pi", "dt", "t", "inf", "nan"})

# what other languages write, and what to write here
FOREIGN = {
    "**": "Write ^ for a power.",
    "&&": "Write and.",
    "||": "Write or.",
    "&": "Write and.",
    "|": "Write or.",
    "!": "Write not.",
    "~": "Write not.",
    "<>": "Write !=.",
    "=<": "Write <=.",
    "=>": "Write >=.",
    ":=": "Write =.",
    "≤": "Write <=.",
    "≥": "Write >=.",
    "≠": "Write !=.",
    "−": "Write -.",
    "–": "Write -.",
    "×": "Write *.",
    "·": "Write *.",
    "÷": "Write /.",
    "%": "Write mod(a, b) for a remainder, and names with other characters as %any name%.",
    "[": "A unit closes with ]; names that hold brackets are written as %any[3].name%.",
    "]": "Names that hold brackets are written as %any[3].name%.",
    ";": "A line ends without a sign; # begins a comment.",
    "{": "Write ( and ).",
    "}": "Write ( and ).",
    "?": "Write if(condition, a, b).",
    "\\": "A line goes on while a bracket is open.",
    '"': "Write names with other characters as %any name%.",
    "'": "Write names with other characters as %any name%.",
}

_NAME = r"[^\W\d]\w*(?:\.\w+)*"
_TOKEN = re.compile(
    rf"""\s*(?:
    (?P<name>{_NAME})
  | (?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.]))
  | (?P<foreign>\*\*|&&|\|\||<>|=<|=>|:=)
  | (?P<op><=|>=|==|!=|[-+*/^(),<>=])
  | (?P<quoted>%(?:[^%]|%%)+%)
  | (?P<unit>\[[^\]]*\])
  | (?P<comment>\#.*)
  | (?P<bad>\.?[0-9][\w.]*|\S)
  )""",
    re.VERBOSE,
)
_PLAIN = re.compile(_NAME)
_WORDS = frozenset({"and", "or", "not"})


def is_plain(name: str) -> bool:
    """Whether a name needs no quotes.

    >>> is_plain("n.eng_1"), is_plain("rad[3].x"), is_plain("pi")
    (True, False, False)
    """
    return _PLAIN.fullmatch(name) is not None and name not in RESERVED


def tokens(line: str, number: int) -> list[Token]:
    """The tokens of one physical line, without blanks and comments."""
    found: list[Token] = []
    for match in _TOKEN.finditer(line):
        kind = match.lastgroup
        if kind is None or kind == "comment":
            break
        text, column = match[kind], match.start(kind) + 1
        if kind == "name" and text in _WORDS:
            kind = "op"
        elif kind == "foreign":
            kind = "bad"
        found.append(Token(kind, text, number, column))
    return found


def statements(lines: Iterable[str]) -> Iterator[list[Token]]:
    """The tokens of each statement, closed by an `end`.

    An open bracket joins the next line, unless that line can only be a statement of its own:
    a forgotten bracket shall not hide the findings of the lines below.
    """
    current: list[Token] = []
    depth = 0
    for number, line in enumerate(lines, start=1):
        found = tokens(line, number)
        if current and _begins_statement(found):
            yield [*current, _end(current)]
            current, depth = [], 0
        current += found
        depth = max(0, depth + _depth(found))
        if current and not depth:
            yield [*current, _end(current)]
            current = []
    if current:
        yield [*current, _end(current)]


def _depth(found: Iterable[Token]) -> int:
    return sum((token.text == "(") - (token.text == ")") for token in found)


def _end(found: Sequence[Token]) -> Token:
    last = found[-1]
    return Token("end", "", last.line, last.column + len(last.text))


def _begins_statement(found: Sequence[Token]) -> bool:
    if found and found[0].kind == "number":
        found = found[1:]
    if len(found) < 2 or found[0].kind not in ("name", "quoted"):
        return False
    if found[0].text in DECLARATIONS and found[1].kind in ("name", "quoted", "number"):
        return True
    return found[1 + (found[1].kind == "unit" and len(found) > 2)].text == "="
