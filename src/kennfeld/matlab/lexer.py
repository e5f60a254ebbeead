"""The words of MATLAB text, by its rules for quotes, comments, continued lines, brackets and commands.

A line break within round brackets ends the statement, as in MATLAB; within others it ends a row. `#` begins a comment
as in Octave, since it has no meaning in MATLAB.
"""

import re
from bisect import bisect_right
from collections.abc import Iterator
from typing import NamedTuple

from kennfeld.matlab.syntax import SourcePosition

__all__ = ["Lines", "MatlabToken", "TokenKind", "tokenize"]

KEYWORDS = frozenset(
    {"if", "elseif", "else", "end", "for", "parfor", "while", "switch", "case", "otherwise", "try", "catch"}
    | {"break", "continue", "return", "function", "global", "persistent", "classdef", "spmd"}
)
_WORD = re.compile(
    r"""(?P<number>0[xX][0-9a-fA-F]+(?:[us](?:8|16|32|64))?|0[bB][01]+(?:[us](?:8|16|32|64))?
        |(?:[0-9]+(?:\.(?![*/\\^']|\.\.)[0-9]*)?|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?[ij]?)(?![A-Za-z0-9_])
    |(?P<name>[A-Za-z][A-Za-z0-9_]*)
    |(?P<string>"(?:[^"\n]|"")*")
    |(?P<operator>\.\*|\./|\.\\|\.\^|\.'|==|~=|!=|<=|>=|&&|\|\||[-+*/\\^()\[\]{}=,;:.<>&|~!@'?])""",
    re.VERBOSE,
)
_QUOTED = re.compile(r"'(?:[^'\n]|'')*'")
_COMMAND = re.compile(
    r"""([A-Za-z][A-Za-z0-9_]*)[ \t]+(?!\.\.\.)
    (?=[A-Za-z0-9_]|'[^'\n]*'[ \t]*(?:[;,%\n]|\Z)|"|-[A-Za-z]|[./~\\][^\s=*/'\\^])""",
    re.VERBOSE,
)
_ARGUMENT = re.compile(r"""'(?:[^'\n]|'')*'|"(?:[^"\n]|"")*"|[^\s;,%'"]+""")
_ASSIGNS = re.compile(r"[A-Za-z0-9_]+[ \t]*=(?!=)")
_BLOCK_BEGIN = re.compile(r"[ \t]*[%#]\{[ \t]*")
_BLOCK_END = re.compile(r"[ \t]*[%#]\}[ \t]*")
_CLOSED_BY = {"(": ")", "[": "]", "{": "}"}
_PARAMETERS = ("parameters",)  # no operand ends where those of a function do
_ENDS_OPERAND = frozenset({")", "]", "}", "'", ".'"})


class TokenKind:
    """What a token is."""

    NUMBER, NAME, KEYWORD, OPERATOR, TEXT, STRING = "number", "name", "keyword", "operator", "text", "string"
    ROW, STOP, COMMAND, COMMENT, BAD, OVER = "row", "stop", "command", "comment", "bad", "over"


class MatlabToken(NamedTuple):
    """One word; `blank` tells whether a blank stands before it, which parts elements within brackets."""

    kind: str
    text: str
    at: int
    end: int
    blank: bool = False
    words: tuple[str, ...] = ()


class Lines:
    """Finds line and column of a place in a text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.begins = [0, *(found.end() for found in re.finditer("\n", text))]

    def place(self, at: int) -> SourcePosition:
        """Line and column, from 1."""
        line = bisect_right(self.begins, at)
        return SourcePosition(line, at - self.begins[line - 1] + 1)

    def line(self, at: int) -> str:
        """The line around a place."""
        begin = self.begins[bisect_right(self.begins, at) - 1]
        return self.text[begin:].partition("\n")[0] if len(self.text) < 1000 else self._cut(begin)

    def _cut(self, begin: int) -> str:
        end = self.text.find("\n", begin)
        return self.text[begin : len(self.text) if end < 0 else end]


def tokenize(text: str, commands: bool = True) -> list[MatlabToken]:
    """The words of a text, ended by one of kind OVER; what is none has kind BAD and says why.

    Where there are statements, `commands` of the form `name word word` are one token each.
    """
    return list(_Lexer(_without_block_comments(text), commands).run())


def _without_block_comments(text: str) -> str:
    """The text with the lines of `%{ ... %}` blank, so that places stay."""
    if "%{" not in text and "#{" not in text:
        return text
    depth, made = 0, []
    for line in text.split("\n"):
        begins, ends = _BLOCK_BEGIN.fullmatch(line), _BLOCK_END.fullmatch(line)
        depth += bool(begins)
        made.append(" " * len(line) if depth else line)
        depth -= bool(ends and depth)
    return "\n".join(made)


class _Lexer:
    def __init__(self, text: str, commands: bool) -> None:
        self.text = text
        self.commands = commands
        self.at = 0
        self.open: list[tuple[str, int, bool]] = []  # with whether it is that of a function's parameters
        self.last: MatlabToken | None = None  # of this statement

    def run(self) -> Iterator[MatlabToken]:
        blank = False
        while (skipped := self._skip()) is not None or self.at < len(self.text):
            if skipped is not None:
                blank = True
                if skipped:
                    yield self._comment(skipped)
                continue
            for token in self._token(blank):
                self.last = None if token.kind == TokenKind.STOP else token
                yield token
            blank = False
        for bracket, at, _ in self.open[:1]:
            yield MatlabToken(TokenKind.BAD, f"{bracket} is never closed", at, at + 1)
        yield MatlabToken(TokenKind.STOP, "\n", self.at, self.at)
        yield MatlabToken(TokenKind.OVER, "", self.at, self.at)

    def _skip(self) -> str | None:
        """Pass blanks, a comment or a continued line; None where there are none, the comment where it is one."""
        text, start = self.text, self.at
        if start >= len(text):
            return None
        if text[start] in "%#":
            self.at = self._line_end()
            return text[start : self.at]
        if text.startswith("...", start):
            self.at = min(self._line_end() + 1, len(text))
            return ""
        while self.at < len(text) and text[self.at] != "\n" and text[self.at].isspace():
            self.at += 1
        return "" if self.at > start else None

    def _line_end(self) -> int:
        end = self.text.find("\n", self.at)
        return len(self.text) if end < 0 else end

    def _comment(self, text: str) -> MatlabToken:
        return MatlabToken(TokenKind.COMMENT, text[1:], self.at - len(text), self.at)

    def _token(self, blank: bool) -> Iterator[MatlabToken]:
        character = self.text[self.at]
        if character == "\n" or (character in ";," and not self.open):
            yield from self._stop(character)
        elif character == ";" and self.open[-1][0] != "(":
            yield self._made(TokenKind.ROW, self.at + 1, blank)
        elif self.commands and not self.open and self.last is None and (command := self._command()):
            yield command
        elif character == "'" and not self._is_transpose(blank):
            found = _QUOTED.match(self.text, self.at)
            yield (
                self._made(TokenKind.TEXT, found.end(), blank)
                if found
                else self._bad("' opens a text that is not closed")
            )
        else:
            yield self._word(blank)

    def _stop(self, character: str) -> Iterator[MatlabToken]:
        if self.open and self.open[-1][0] != "(":
            yield self._made(TokenKind.ROW, self.at + 1, True)
            return
        if self.open:
            bracket, at, _ = self.open[-1]
            yield MatlabToken(TokenKind.BAD, f"{bracket} is not closed on its line", at, at + 1)
            self.open.clear()
        yield self._made(TokenKind.STOP, self.at + 1, False)

    def _made(self, kind: str, end: int, blank: bool) -> MatlabToken:
        begin, self.at = self.at, end
        return MatlabToken(kind, self.text[begin:end], begin, end, blank)

    def _bad(self, message: str) -> MatlabToken:
        begin, self.at = self.at, self._line_end()
        return MatlabToken(TokenKind.BAD, message, begin, self.at)

    def _command(self) -> MatlabToken | None:
        """`name word word` up to the end of the statement."""
        begin = self.at
        if self.text[begin] == "!":
            self.at = self._line_end()
            return MatlabToken(TokenKind.COMMAND, "!", begin, self.at, False, (self.text[begin + 1 : self.at].strip(),))
        found = _COMMAND.match(self.text, begin)
        if not found or found[1] in KEYWORDS or _ASSIGNS.match(self.text, found.end()):
            return None
        at, words = found.end(), []
        while word := _ARGUMENT.match(self.text, at):
            words.append(word[0])
            at = word.end()
            while at < len(self.text) and self.text[at] in " \t\r\f\v":
                at += 1
        self.at = at
        return MatlabToken(TokenKind.COMMAND, found[1], begin, at, False, tuple(words))

    def _is_transpose(self, blank: bool) -> bool:
        last = self.last
        if last is None or last.words or (blank and bool(self.open) and self.open[-1][0] != "("):
            return False
        if last.kind == TokenKind.KEYWORD:
            return last.text == "end" and bool(self.open)
        return (
            last.kind in (TokenKind.NUMBER, TokenKind.NAME, TokenKind.STRING)
            or (last.kind == TokenKind.OPERATOR and last.text in _ENDS_OPERAND)
            or (last.kind == TokenKind.TEXT and not blank)
        )

    def _word(self, blank: bool) -> MatlabToken:
        match = _WORD.match(self.text, self.at)
        if match is None:
            return self._unknown()
        kind, text = str(match.lastgroup), match[0]
        if kind == TokenKind.NAME and text in KEYWORDS and not (self.last and self.last.text == "." and not blank):
            kind = TokenKind.KEYWORD
        words: tuple[str, ...] = ()
        if text in _CLOSED_BY:
            self.open.append((text, self.at, self.last is not None and self.last.text == "@"))
        elif kind == TokenKind.OPERATOR and text in ")]}":
            if not self.open or _CLOSED_BY[self.open[-1][0]] != text:
                return self._bad(f"{text} closes no bracket")
            words = _PARAMETERS if self.open.pop()[2] else ()
        return self._made(kind, match.end(), blank)._replace(words=words)

    def _unknown(self) -> MatlabToken:
        character = self.text[self.at]
        message = '" opens a text that is not closed' if character == '"' else f"{character!r} is no part of MATLAB"
        if character.isdigit() or character == ".":
            message = f"{self.text[self.at : self.at + 20].split()[0]!r} is no number"
        return self._bad(message)
