"""The words of a MATLAB script, with its rules for quotes, comments, continued lines and brackets."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float

__all__ = ["BadSyntaxError", "Statement", "Token", "statements"]

_TOKEN = re.compile(
    r"""(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?)
    |(?P<name>[A-Za-z]\w*)
    |(?P<string>"(?:[^"\n]|"")*")
    |(?P<operator>\.\*|\./|\.\^|\.'|[-+*/\\^()\[\]{}=,;:.<>&|~!@?'$])""",
    re.VERBOSE,
)
_QUOTED = re.compile(r"'(?:[^'\n]|'')*'")
_BLANKS = re.compile(r"[ \t\f\v]+")
_CONTINUED = re.compile(r"\.\.\.[^\n]*\n")
_PLAIN_MATRIX = re.compile(r"\[([0-9eE+\-.,;\sNaInf]*)\]")
_BLOCK_COMMENT = re.compile(r"[ \t]*[%#]\{[ \t]*")
_BLOCK_END = re.compile(r"[ \t]*[%#]\}[ \t]*")
_COMMENTS = "%#"  # of MATLAB, of Octave
_OPENING, _CLOSING = "([{", ")]}"
_MOST_DEPTH = 50


class BadSyntaxError(Exception):
    """Text that is no statement this reader knows."""


@dataclass(frozen=True, slots=True)
class Token:
    """One word; `blank` tells whether a blank stands before it, which parts elements within brackets."""

    kind: str  # number, name, string, operator, matrix, newline
    text: str
    blank: bool
    value: Float | None = None  # of a matrix of numbers


@dataclass
class Statement:
    """One statement: where it begins, its words, and the comment behind it on its last line."""

    line: int
    tokens: list[Token]
    text: str
    comment: str = ""
    last_line: int = 0
    is_open: bool = False  # a bracket is never closed; nothing of what follows is known


def statements(text: str) -> Iterator[Statement]:
    """The statements of a script; one that cannot be split into words has none and tells its text."""
    text = _without_block_comments(text)
    lexer = _Lexer(text)
    waiting: Statement | None = None
    for statement, comment, line in lexer.run():
        if statement is not None:
            if waiting is not None:
                yield waiting
            waiting = statement
        elif waiting is not None and waiting.last_line == line:
            waiting.comment = comment
    if waiting is not None:
        yield waiting


def _without_block_comments(text: str) -> str:
    """The text with the lines of `%{ ... %}` empty, so that lines keep their numbers."""
    if "{" not in text:
        return text
    depth, made = 0, []
    for line in text.split("\n"):
        if _BLOCK_COMMENT.fullmatch(line):
            depth += 1
            made.append("")
        elif depth and _BLOCK_END.fullmatch(line):
            depth -= 1
            made.append("")
        else:
            made.append("" if depth else line)
    return "\n".join(made)


class _Lexer:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.line = 1

    def run(self) -> Iterator[tuple[Statement | None, str, int]]:
        """Statements, and comments with their lines."""
        length = len(self.text)
        while self.at < length:
            character = self.text[self.at]
            if character in " \t\f\v;,\n":
                self._step(self.at + 1)
            elif character in _COMMENTS:
                end = self._end_of_line()
                yield None, self.text[self.at + 1 : end], self.line
                self._step(end)
            elif self.text.startswith("...", self.at):
                self._step(self._end_of_line() + 1)
            else:
                yield self._statement(), "", 0

    def _end_of_line(self) -> int:
        end = self.text.find("\n", self.at)
        return len(self.text) if end < 0 else end

    def _step(self, to: int) -> None:
        to = min(to, len(self.text))
        self.line += self.text.count("\n", self.at, to)
        self.at = to

    def _statement(self) -> Statement:
        start, line = self.at, self.line
        tokens: list[Token] = []
        try:
            self._words(tokens)
        except BadSyntaxError:
            is_open = self.at >= len(self.text)
            self._step(self._end_of_line())
            return Statement(line, [], self.text[start : self.at].strip(), last_line=self.line, is_open=is_open)
        return Statement(line, tokens, self.text[start : self.at].strip(), last_line=self.line)

    def _words(self, tokens: list[Token]) -> None:
        """Words up to the end of the statement, which stays unread."""
        depth: list[str] = []
        blank = False
        while self.at < len(self.text):
            character = self.text[self.at]
            if character in " \t\f\v":
                found = _BLANKS.match(self.text, self.at)
                assert found is not None
                self.at, blank = found.end(), True
                continue
            if self.text.startswith("...", self.at):
                self._step(self._end_of_line() + 1)
                blank = True
                continue
            if character in _COMMENTS:
                if not depth:
                    return
                self._step(self._end_of_line())
                continue
            if character == "\n" or (character in ";," and not depth):
                if not depth:
                    return
                if depth[-1] != "(":
                    tokens.append(Token("newline", ";", blank))
                self._step(self.at + 1)
                blank = True
                continue
            token = self._word(tokens, blank, depth)
            tokens.append(token)
            blank = False
        if depth:
            raise BadSyntaxError

    def _word(self, tokens: list[Token], blank: bool, depth: list[str]) -> Token:
        character = self.text[self.at]
        if character == "[" and (matrix := self._matrix()) is not None:
            return Token("matrix", "[]", blank, matrix)
        if character == "'" and not self._is_transpose(tokens, blank, bool(depth) and depth[-1] != "("):
            found = _QUOTED.match(self.text, self.at)
            if found is None:
                raise BadSyntaxError
            self.at = found.end()
            return Token("string", found[0][1:-1].replace("''", "'"), blank)
        match = _TOKEN.match(self.text, self.at)
        if match is None:
            raise BadSyntaxError
        self.at = match.end()
        kind, word = str(match.lastgroup), match[0]
        if kind == "string":
            word = word[1:-1].replace('""', '"')
        elif word in _OPENING:
            depth.append(word)
        elif word in _CLOSING and (not depth or _OPENING.index(depth.pop()) != _CLOSING.index(word)):
            raise BadSyntaxError
        if len(depth) > _MOST_DEPTH:
            raise BadSyntaxError
        return Token(kind, word, blank)

    def _is_transpose(self, tokens: list[Token], blank: bool, in_brackets: bool) -> bool:
        if not tokens or (blank and in_brackets):
            return False
        last = tokens[-1]
        return last.kind in ("number", "name", "matrix") or (
            last.text in (")", "]", "}", "'", ".'") and last.kind == "operator"
        )

    def _matrix(self) -> Float | None:
        """Numbers alone between brackets, read at once; None where there is more to them."""
        found = _PLAIN_MATRIX.match(self.text, self.at)
        if found is None:
            return None
        inner = _CONTINUED.sub(" ", found[1]) if "..." in found[1] else found[1]
        rows = [row.replace(",", " ").split() for row in inner.replace("\n", ";").split(";")]
        try:
            numbers = [list(map(float, row)) for row in rows if row]
        except ValueError:
            return None
        if any(len(row) != len(numbers[0]) for row in numbers):
            return None
        self._step(found.end())
        return np.array(numbers, dtype=np.float64).reshape(len(numbers), -1) if numbers else np.zeros((0, 0))
