"""Lexer of formula text: characters to tokens, tokens to statements, and findings with the line they refer to.

A statement is one line; an open bracket continues it on the next line.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.graph import CLOCK
from kennfeld.models.formula.syntax import Token

DECLARATIONS = frozenset({"input", "output", "scalar", "curve", "map", "cube", "rbf", "step", "solver", "def"})
RESERVED = frozenset({"and", "or", "not", "if", "pi", *CLOCK, "inf", "nan"})

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
    "[": "Close the unit with ]; write names with brackets as %any[3].name%.",
    "]": "Write names with brackets as %any[3].name%.",
    ";": "Lines end without a terminator; # starts a comment.",
    "{": "Write ( and ).",
    "}": "Write ( and ).",
    "?": "Write if(condition, a, b).",
    "\\": "An open bracket continues the line.",
    '"': "Write names with other characters as %any name%.",
    "'": "Write names with other characters as %any name%.",
}

_NAME = r"[^\W\d]\w*(?:\.\w+)*"
# the first alternative that matches counts: `foreign` before `op`, whose signs it begins with; a number does not end
# before a letter or a point, so that `2x` and `1.2.3` are one bad token each
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

_WIDEST = 120


def is_plain(name: str) -> bool:
    """Return True if a name needs no quotes.

    >>> is_plain("n.eng_1"), is_plain("rad[3].x"), is_plain("pi")
    (True, False, False)
    """
    return _PLAIN.fullmatch(name) is not None and name not in RESERVED


def tokens(line: str, number: int) -> list[Token]:
    """Yield the tokens of one physical line, without blanks and comments."""
    line_tokens: list[Token] = []
    for match in _TOKEN.finditer(line):
        kind = match.lastgroup
        if kind is None or kind == "comment":
            break
        text, column = match[kind], match.start(kind) + 1
        if kind == "name" and text in _WORDS:
            kind = "op"
        elif kind == "foreign":
            kind = "bad"
        line_tokens.append(Token(kind, text, number, column))
    return line_tokens


def statements(lines: Iterable[str]) -> Iterator[list[Token]]:
    """Yield the tokens of each statement, followed by an `end` token.

    An open bracket continues the statement on the next line, unless that line can only start a statement: a missing
    bracket must not hide the findings of the lines below.
    """
    current: list[Token] = []
    depth = 0
    for number, line in enumerate(lines, start=1):
        result = tokens(line, number)
        if current and _begins_statement(result):
            yield [*current, _end(current)]
            current, depth = [], 0
        current += result
        # a closing bracket too many counts for its own line only
        depth = max(0, depth + sum((token.text == "(") - (token.text == ")") for token in result))
        if current and not depth:
            yield [*current, _end(current)]
            current = []
    if current:
        yield [*current, _end(current)]


def _end(line_tokens: Sequence[Token]) -> Token:
    last = line_tokens[-1]
    return Token("end", "", last.line, last.column + len(last.text))


def _begins_statement(line_tokens: Sequence[Token]) -> bool:
    # a line number
    if line_tokens and line_tokens[0].kind == "number":
        line_tokens = line_tokens[1:]
    if len(line_tokens) < 2 or line_tokens[0].kind not in ("name", "quoted"):
        return False
    if line_tokens[0].text in DECLARATIONS and line_tokens[1].kind in ("name", "quoted", "number"):
        return True
    return line_tokens[1 + (line_tokens[1].kind == "unit" and len(line_tokens) > 2)].text == "="


def split(text: str) -> list[str]:
    """Split a text into lines, with any line endings."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


class Source:
    """The lines of a text with their locations, and the findings about them.

    >>> source = Source.of_text("torque.kf", "a = b +")
    >>> source.report(Token("end", "", 1, 8), "an operand is missing")
    >>> print(source.findings[0])
    torque.kf line 1, column 8: an operand is missing
    >>> print(source.findings[0].excerpt)
    a = b +
           ^
    """

    def __init__(self, label: Location, lines: Sequence[str], locations: Sequence[Location]) -> None:
        self.label = label
        self.lines = lines
        self.locations = locations
        self._positions: dict[Finding, tuple[int, int]] = {}

    @classmethod
    def of_text(cls, label: str, text: str) -> "Source":
        """Return the source of a text whose locations are line numbers: "torque.kf line 4"."""
        lines = split(text)
        return cls(Location(label), lines, [Location(label, number) for number in range(1, len(lines) + 1)])

    def location(self, line: int, column: int = 0) -> Location:
        """Return the location of a line, or of a column in it."""
        return replace(self.locations[line - 1], column=column)

    def report(self, at: Token, message: str, remedy: str = "") -> None:
        """Add a finding about a token; a token in column 0 stands for the whole line."""
        excerpt = self._excerpt(at) if at.column else ""
        finding = Finding(self.location(at.line, at.column), message, remedy, excerpt)
        self._positions.setdefault(finding, (at.line, at.column))

    def report_all(self, message: str, remedy: str = "") -> None:
        """Add a finding about the text as a whole."""
        self._positions.setdefault(Finding(self.label, message, remedy), (0, 0))

    @property
    def findings(self) -> list[Finding]:
        """The findings without duplicates, from the top of the text to its end."""
        return sorted(self._positions, key=self._positions.__getitem__)

    def raise_findings(self) -> None:
        """Raise `InputError` if there are findings."""
        if self._positions:
            raise InputError(self.findings)

    def text(self, first: Token, last: Token) -> str:
        """Return the text from one token to the end of another; "" if they are on different lines."""
        if first.line != last.line:
            return ""
        return self.lines[first.line - 1][first.column - 1 : last.column - 1 + len(last.text)]

    def _excerpt(self, at: Token) -> str:
        line = self.lines[at.line - 1]
        start = max(0, at.column - 1 - _WIDEST // 2) if len(line) > _WIDEST else 0
        shown = line[start : start + _WIDEST]
        # tabs are repeated, so that the mark stands below its token at any width of tabs
        before = "".join("\t" if c == "\t" else " " for c in line[start : at.column - 1])
        width = max(1, min(len(at.text), _WIDEST - len(before)))
        return f"{shown.rstrip()}\n{before}{'^' * width}"
