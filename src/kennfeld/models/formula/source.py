"""A text with its place: turns tokens into findings that show the line."""

from collections.abc import Sequence

from kennfeld.errors import Finding, InputError
from kennfeld.models.formula.syntax import Token

__all__ = ["Source", "split"]

_WIDEST = 120


def split(text: str) -> list[str]:
    """The lines of a text, whichever system wrote it."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


class Source:
    """The lines of a text, the place of each, and the findings about them.

    >>> source = Source.of_text("torque.kf", "a = b +")
    >>> source.report(Token("end", "", 1, 8), "an operand is missing")
    >>> print(source.findings[0])
    torque.kf line 1, column 8: an operand is missing
    >>> print(source.findings[0].excerpt)
    a = b +
           ^
    """

    def __init__(self, label: str, lines: Sequence[str], places: Sequence[str]) -> None:
        self.label = label
        self.lines = lines
        self.places = places
        self._found: list[tuple[int, int, Finding]] = []

    @classmethod
    def of_text(cls, label: str, text: str) -> "Source":
        """A text whose lines are counted: "torque.kf line 4"."""
        lines = split(text)
        return cls(label, lines, [f"{label} line {number}" for number in range(1, len(lines) + 1)])

    def place(self, line: int) -> str:
        """The place of a line."""
        return self.places[line - 1]

    def report(self, at: Token, what: str, mend: str = "") -> None:
        """Keep a finding about a token; one in column 0 stands for the whole line."""
        place = self.place(at.line) + (f", column {at.column}" if at.column else "")
        excerpt = self._excerpt(at) if at.column else ""
        self._found.append((at.line, at.column, Finding(place, what, mend, excerpt)))

    def report_all(self, what: str, mend: str = "") -> None:
        """Keep a finding about the text as a whole."""
        self._found.append((0, 0, Finding(self.label, what, mend)))

    @property
    def findings(self) -> list[Finding]:
        """What was found, from the top of the text to its end, each once."""
        ordered = sorted(self._found, key=lambda found: found[:2])
        return list(dict.fromkeys(finding for _, _, finding in ordered))

    def raise_findings(self) -> None:
        """Raise `InputError` if anything was found."""
        if self._found:
            raise InputError(self.findings)

    def text(self, first: Token, last: Token) -> str:
        """The text from one token to the end of another in the same line; empty where they are in two."""
        if first.line != last.line:
            return ""
        return self.lines[first.line - 1][first.column - 1 : last.column - 1 + len(last.text)]

    def _excerpt(self, at: Token) -> str:
        line = self.lines[at.line - 1]
        start = max(0, at.column - 1 - _WIDEST // 2) if len(line) > _WIDEST else 0
        shown = line[start : start + _WIDEST]
        before = "".join("\t" if c == "\t" else " " for c in line[start : at.column - 1])
        width = max(1, min(len(at.text), _WIDEST - len(before)))
        return f"{shown.rstrip()}\n{before}{'^' * width}"
