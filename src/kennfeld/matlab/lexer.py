"""The lexer of MATLAB text, with its rules for quotes, comments, continued lines, brackets and command syntax.

A line break in round brackets ends the statement, as in MATLAB; in other brackets it ends a row. `#` begins a comment,
as in Octave; it is not used otherwise.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

KEYWORDS = frozenset(
    {"if", "elseif", "else", "end", "for", "parfor", "while", "switch", "case", "otherwise", "try", "catch"}
    | {"break", "continue", "return", "function", "global", "persistent", "classdef", "spmd"}
)
# the point in `2.*x` belongs to the operator, that in `1...` to the continuation of the line
_WORD = re.compile(
    r"""(?P<number>0[xX][0-9a-fA-F]+(?:[us](?:8|16|32|64))?|0[bB][01]+(?:[us](?:8|16|32|64))?
        |(?:[0-9]+(?:\.(?![*/\\^']|\.\.)[0-9]*)?|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?[ij]?)(?![A-Za-z0-9_])
    |(?P<name>[A-Za-z][A-Za-z0-9_]*)
    |(?P<string>"(?:[^"\n]|"")*")
    |(?P<operator>\.\*|\./|\.\\|\.\^|\.'|==|~=|!=|<=|>=|&&|\|\||[-+*/\\^()\[\]{}=,;:.<>&|~!@'?])""",
    re.VERBOSE,
)
_QUOTED = re.compile(r"'(?:[^'\n]|'')*'")
# `hold on` and `clear -all` are commands; `a - b`, `a (1)` and `a = 1` are not
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
_PARAMETERS = ("parameters",)  # marks the bracket behind the parameters of an anonymous function
_ENDS_OPERAND = frozenset({")", "]", "}", "'", ".'"})


class TokenKind:
    """The kinds of tokens."""

    NUMBER, NAME, KEYWORD, OPERATOR, TEXT, STRING = "number", "name", "keyword", "operator", "text", "string"
    ROW, STOP, COMMAND, COMMENT, BAD, END = "row", "stop", "command", "comment", "bad", "end"


class MatlabToken(NamedTuple):
    """A token; `blank` is True if a blank precedes it, which separates elements in brackets."""

    kind: str
    text: str
    at: int
    end: int
    blank: bool = False
    words: tuple[str, ...] = ()


def tokenize(text: str, commands: bool = True) -> list[MatlabToken]:
    """Return the tokens of a text, ending with END; an invalid one has kind BAD and the reason as its text.

    If `commands`, a statement of the form `name word word` is one token.
    """
    return list(_Lexer(_without_block_comments(text), commands).run())


def _without_block_comments(text: str) -> str:
    """Blank out the lines of `%{ ... %}`, which keeps all positions."""
    if "%{" not in text and "#{" not in text:
        return text
    depth, lines = 0, []
    for line in text.split("\n"):
        # only marks alone on their line count: `%{ text` is an ordinary comment
        begins, ends = _BLOCK_BEGIN.fullmatch(line), _BLOCK_END.fullmatch(line)
        depth += bool(begins)
        lines.append(" " * len(line) if depth else line)
        depth -= bool(ends and depth)
    return "\n".join(lines)


class _Lexer:
    def __init__(self, text: str, commands: bool) -> None:
        self.text = text
        self.commands = commands
        self.at = 0
        self.open: list[tuple[str, int, bool]] = []  # bracket, offset, True for the parameters of a function
        self.last: MatlabToken | None = None  # the last token of the statement

    def run(self) -> Iterator[MatlabToken]:
        blank = False
        while (skipped := self._skip()) is not None or self.at < len(self.text):
            if skipped is not None:
                blank = True
                if skipped:
                    yield MatlabToken(TokenKind.COMMENT, skipped[1:], self.at - len(skipped), self.at)
                continue
            for token in self._token(blank):
                self.last = None if token.kind == TokenKind.STOP else token
                yield token
            blank = False
        # the outermost bracket has swallowed the others
        for bracket, at, _ in self.open[:1]:
            yield MatlabToken(TokenKind.BAD, f"{bracket} is never closed", at, at + 1)
        yield MatlabToken(TokenKind.STOP, "\n", self.at, self.at)
        yield MatlabToken(TokenKind.END, "", self.at, self.at)

    def _skip(self) -> str | None:
        """Skip blanks, a comment or a continued line; return None if there are none, or the comment."""
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

    def _token(self, blank: bool) -> Iterator[MatlabToken]:
        character = self.text[self.at]
        if character == "\n" or (character in ";," and not self.open):
            yield from self._stop()
        elif character == ";" and self.open[-1][0] != "(":
            yield self._take(TokenKind.ROW, self.at + 1, blank)
        elif self.commands and not self.open and self.last is None and (command := self._command()):
            yield command
        elif character == "'" and not self._is_transpose(blank):
            match = _QUOTED.match(self.text, self.at)
            yield (self._take(TokenKind.TEXT, match.end(), blank) if match else self._reject("unterminated text"))
        else:
            yield self._word(blank)

    def _stop(self) -> Iterator[MatlabToken]:
        if self.open and self.open[-1][0] != "(":
            yield self._take(TokenKind.ROW, self.at + 1, True)
            return
        if self.open:
            bracket, at, _ = self.open[-1]
            yield MatlabToken(TokenKind.BAD, f"{bracket} is not closed on its line", at, at + 1)
            self.open.clear()
        yield self._take(TokenKind.STOP, self.at + 1, False)

    def _take(self, kind: str, end: int, blank: bool) -> MatlabToken:
        begin, self.at = self.at, end
        return MatlabToken(kind, self.text[begin:end], begin, end, blank)

    def _reject(self, message: str) -> MatlabToken:
        begin, self.at = self.at, self._line_end()
        return MatlabToken(TokenKind.BAD, message, begin, self.at)

    def _command(self) -> MatlabToken | None:
        """Return a statement in command syntax, `name word word`; None if it is not one."""
        begin = self.at
        if self.text[begin] == "!":
            self.at = self._line_end()
            return MatlabToken(TokenKind.COMMAND, "!", begin, self.at, False, (self.text[begin + 1 : self.at].strip(),))
        match = _COMMAND.match(self.text, begin)
        if not match or match[1] in KEYWORDS or _ASSIGNS.match(self.text, match.end()):
            return None
        at, words = match.end(), []
        while word := _ARGUMENT.match(self.text, at):
            words.append(word[0])
            at = word.end()
            while at < len(self.text) and self.text[at] in " \t\r\f\v":
                at += 1
        self.at = at
        return MatlabToken(TokenKind.COMMAND, match[1], begin, at, False, tuple(words))

    def _is_transpose(self, blank: bool) -> bool:
        last = self.last
        # in square and curly brackets, a quote behind a blank begins a text: [a 'b']
        if last is None or last.words or (blank and bool(self.open) and self.open[-1][0] != "("):
            return False
        if last.kind == TokenKind.KEYWORD:
            # the last element in an index, x(end'), not the end of a block
            return last.text == "end" and bool(self.open)
        return (
            last.kind in (TokenKind.NUMBER, TokenKind.NAME, TokenKind.STRING)
            or (last.kind == TokenKind.OPERATOR and last.text in _ENDS_OPERAND)
            or (last.kind == TokenKind.TEXT and not blank)
        )

    def _word(self, blank: bool) -> MatlabToken:
        match = _WORD.match(self.text, self.at)
        if match is None:
            return self._reject_unknown()
        kind, text = str(match.lastgroup), match[0]
        # a field may have the name of a keyword: s.end
        if kind == TokenKind.NAME and text in KEYWORDS and not (self.last and self.last.text == "." and not blank):
            kind = TokenKind.KEYWORD
        words: tuple[str, ...] = ()
        if text in _CLOSED_BY:
            self.open.append((text, self.at, self.last is not None and self.last.text == "@"))
        elif kind == TokenKind.OPERATOR and text in ")]}":
            if not self.open or _CLOSED_BY[self.open[-1][0]] != text:
                return self._reject(f"unmatched {text}")
            words = _PARAMETERS if self.open.pop()[2] else ()
        return self._take(kind, match.end(), blank)._replace(words=words)

    def _reject_unknown(self) -> MatlabToken:
        character = self.text[self.at]
        message = "unterminated text" if character == '"' else f"unexpected character {character!r}"
        if character.isdigit() or character == ".":
            message = f"invalid number {self.text[self.at : self.at + 20].split()[0]!r}"
        return self._reject(message)
