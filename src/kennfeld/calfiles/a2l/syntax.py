"""The blocks of an A2L text, `/begin KEYWORD ... /end KEYWORD`, and a cursor over the tokens of one block.

The syntax is that of ASAM MCD-2 MC (ASAP2) 1.3 to 1.71: texts in quotes, with inner quotes doubled or escaped by a
backslash, comments as in C, other files by `/include`. The content of IF_DATA and A2ML is skipped.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from functools import cached_property
from itertools import takewhile
from math import isnan
from pathlib import Path

from kennfeld.base.formatting import one_line
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import parse_float
from kennfeld.calfiles.format import CalibrationSource, FileFindings
from kennfeld.program.positions import TextLines

# The path and the content of an included file, by its name and the path of the file that includes it, which is None for
# the main file; None if there is no such file.
Include = Callable[[str, Path | None], tuple[Path, bytes] | None]

# a text, a comment, a word, or the begin of a text or comment without an end; possessive, so that no failure is retried
_TOKEN = re.compile(
    r'"((?:[^"\\]++|\\.|"")*+)"'
    r"|/\*.*?\*/|//[^\n]*"
    r'|([^\s"/]++(?:/(?![/*])[^\s"/]*+)*+|/(?![/*])[^\s"/]*+(?:/(?![/*])[^\s"/]*+)*+)'
    r'|("|/\*)',
    re.DOTALL,
)
_TEXT, _WORD, _OPEN = 1, 2, 3
_ESCAPE = re.compile(r'\\(["\'\\])|""')
_A2ML_END = re.compile(r"/end\s+A2ML\b", re.IGNORECASE)
_SKIPPED_BLOCKS = ("IF_DATA", "A2ML")
_ML_ENDINGS = (".aml", ".a2ml")
_MAX_NESTING = 64  # blocks within each other
_MAX_INCLUDES = 200
_MAX_INCLUDED_BYTES = 400_000_000  # of all included files together
_MAX_FAULTS = 20
_DAMAGED = "The file is damaged or truncated."
_MAX_SHOWN = 40


@dataclass(frozen=True)
class _File:
    name: str
    text: str
    path: Path | None = None  # of an included file

    @cached_property
    def _lines(self) -> TextLines:
        return TextLines(self.text)

    def line(self, offset: int) -> int:
        return self._lines.number(offset)


@dataclass(slots=True, eq=False)
class A2lBlock:
    """A block: its keyword, its words and texts (with a quote before them) in their order, and the blocks within it."""

    keyword: str
    file: _File
    offset: int
    tokens: list[str] = field(default_factory=list)
    blocks: list["A2lBlock"] = field(default_factory=list)

    @property
    def line(self) -> int:
        """The line of its beginning, counted from 1."""
        return self.file.line(self.offset)

    @property
    def name(self) -> str:
        """Its first word, or its keyword."""
        return unquote(self.tokens[0])[:120] if self.tokens else self.keyword

    def inner(self, keyword: str) -> "Iterator[A2lBlock]":
        """Return the blocks of one keyword within it."""
        return (block for block in self.blocks if block.keyword == keyword)


def is_text(token: str) -> bool:
    """Check whether a token was written in quotes."""
    return token.startswith('"')


def unquote(token: str) -> str:
    """Return the text of a token, without quotes and escapes.

    >>> unquote('"5"" tyre')
    '5" tyre'
    """
    if not is_text(token):
        return token
    return _ESCAPE.sub(lambda match: match[1] or '"', token[1:]) if "\\" in token or '""' in token else token[1:]


def parse_blocks(
    raw: bytes, name: str, findings: FileFindings, include: Include | None = None
) -> tuple[A2lBlock, bool]:
    """Parse a file into one block without a keyword; False if its structure is broken, which is reported."""
    builder = _BlockBuilder(findings, include)
    builder.feed(_File(name, CalibrationSource(name, raw).text), 0)
    return builder.finish(), not builder.faults


@dataclass
class _BlockBuilder:
    findings: FileFindings
    include: Include | None
    stack: list[A2lBlock] = field(default_factory=list)
    faults: int = 0
    files: int = 0
    characters: int = 0

    def feed(self, file: _File, depth: int) -> None:
        if not self.stack:
            self.stack.append(A2lBlock("", file, 0))
        at: int | None = 0
        while at is not None:
            at = self._run(file, at, depth)

    def _run(self, file: _File, start: int, depth: int) -> int | None:
        """Process tokens from an offset; return the offset at which to continue, None at the end."""
        waiting = ""  # /begin, /end or /include, until the word after it has come
        # bound once, as a file has millions of words
        keep = self.stack[-1].tokens.append
        for match in _TOKEN.finditer(file.text, start):
            kind = match.lastindex
            if kind == _WORD and not waiting:
                word = match[0]
                if word[0] == "/" and word.lower() in ("/begin", "/end", "/include"):
                    waiting = word.lower()
                else:
                    keep(word)
                continue
            if kind is None:
                continue
            if kind == _OPEN:
                self._fault(file, match.start(), "a quote or a comment is not closed", _DAMAGED)
                return None
            word = match[0] if kind == _WORD else '"' + match[_TEXT]
            if not waiting:
                keep(word)
                continue
            waiting, action = "", waiting
            if not self._act(file, match.start(), action, word, depth):
                return None
            # A2ML has a grammar of its own
            if action == "/begin" and word == "A2ML":
                return self._after_a2ml(file, match.end())
            keep = self.stack[-1].tokens.append
        if waiting:
            self._fault(file, len(file.text), f"ends after {waiting}", "The file is truncated.")
        return None

    def _after_a2ml(self, file: _File, offset: int) -> int | None:
        end = _A2ML_END.search(file.text, offset)
        if end is None:
            self._fault(file, offset, "A2ML is not closed", _DAMAGED)
            return None
        self.stack.pop()
        return end.end()

    def _act(self, file: _File, offset: int, action: str, word: str, depth: int) -> bool:
        """Open or close a block or include a file; return False to stop parsing."""
        if action == "/begin":
            self.stack.append(A2lBlock(word, file, offset))
            if len(self.stack) > _MAX_NESTING:
                self._fault(file, offset, f"blocks are nested more than {_MAX_NESTING} levels deep")
        elif action == "/end":
            self._close(file, offset, word)
        else:
            self._include(file, offset, unquote(word), depth)
        return self.faults < _MAX_FAULTS and len(self.stack) <= _MAX_NESTING

    def _close(self, file: _File, offset: int, word: str) -> None:
        if len(self.stack) > 1 and self.stack[-1].keyword == word:
            self._attach(self.stack.pop())
            return
        at = next((i for i in range(len(self.stack) - 1, 0, -1) if self.stack[i].keyword == word), 0)
        if at == 0:
            self._fault(file, offset, f"/end {word[:40]} without a matching /begin")
            return
        top = self.stack[-1]
        self._fault(file, offset, f"/end {word[:40]} comes before the {top.keyword[:40]} of line {top.line} is closed")
        while len(self.stack) > at:
            self._attach(self.stack.pop())

    def _attach(self, block: A2lBlock) -> None:
        if block.keyword not in _SKIPPED_BLOCKS:
            self.stack[-1].blocks.append(block)

    def _include(self, file: _File, offset: int, name: str, depth: int) -> None:
        if any(block.keyword in _SKIPPED_BLOCKS for block in self.stack):
            return
        self.files += 1
        if depth >= _MAX_NESTING or self.files > _MAX_INCLUDES:
            self._stop(file, offset, f"/include {name[:60]}: too many files include each other")
            return
        content = self.include(name, file.path) if self.include else None
        if content is None and name.lower().endswith(_ML_ENDINGS):
            message = f"/include {name[:60]!r}: file not found; skipped, as interface descriptions are not needed"
            self.findings.warning(file.line(offset), "", message)
        elif content is None:
            remedy = "Its path is relative to the folder of the including file or of the main file."
            self._fault(file, offset, f"/include {name[:60]!r}: cannot be read", remedy)
        else:
            path, raw = content
            self.characters += len(raw)
            if self.characters > _MAX_INCLUDED_BYTES:
                self._stop(file, offset, f"/include {name[:60]}: the included files are too large")
            else:
                self.feed(_File(name, CalibrationSource(name, raw).text, path), depth + 1)

    def _stop(self, file: _File, offset: int, message: str) -> None:
        self.faults = _MAX_FAULTS
        self._fault(file, offset, message)

    def _fault(self, file: _File, offset: int, message: str, remedy: str = "") -> None:
        self.faults += 1
        inside = f"{file.name}: " if file is not self.stack[0].file else ""
        self.findings.error(file.line(offset), "", inside + message, remedy)

    def finish(self) -> A2lBlock:
        """Return the outermost block, and report what is not closed."""
        if len(self.stack) > 1 and not self.faults:
            top = self.stack[-1]
            self._fault(top.file, top.offset, f"{top.keyword[:40]} is not closed", "The file is truncated.")
        while len(self.stack) > 1:
            self._attach(self.stack.pop())
        return self.stack[0]


class A2lError(Exception):
    """A block does not match its keyword, or is not supported; the text says why."""


class Cursor:
    """A position within the tokens of a block; inner blocks are skipped.

    Everything raises `A2lError` if the block has something else.
    """

    def __init__(self, block: A2lBlock) -> None:
        self.tokens = block.tokens
        self.at = 0

    def left(self) -> int:
        return len(self.tokens) - self.at

    def word(self, message: str) -> str:
        """Return the next word or text; `message` names it in an error."""
        if self.at >= len(self.tokens):
            raise A2lError(f"has no {message}")
        self.at += 1
        return unquote(self.tokens[self.at - 1])

    def text(self, message: str) -> str:
        """Return the next text in quotes, as one line."""
        if self.at >= len(self.tokens) or not is_text(self.tokens[self.at]):
            raise A2lError(f"has no {message} in quotes")
        return one_line(self.word(message))

    def number(self, message: str) -> float:
        word = self.word(message)
        value = parse_number(word)
        if value is None:
            raise A2lError(f"has {word[:_MAX_SHOWN]!r} where its {message} should be")
        return value

    def whole(self, message: str) -> int:
        """Return the next whole number, decimal or hexadecimal."""
        word = self.word(message)
        value = parse_integer(word)
        if value is None:
            raise A2lError(f"has {word[:_MAX_SHOWN]!r} where its {message} should be, which must be an integer")
        return value

    def options(self, known: Mapping[str, int]) -> dict[str, list[str]]:
        """Return the words after each keyword of `known`, which says how many there are (-1: up to the next keyword).

        Words that belong to no known keyword are passed over; of a keyword given twice the last one counts.
        """
        results: dict[str, list[str]] = {}
        while self.at < len(self.tokens):
            keyword = self.tokens[self.at]
            self.at += 1
            if keyword not in known:
                continue
            end = self.at + known[keyword]
            if known[keyword] < 0:
                numbers = takewhile(lambda token: parse_integer(token) is not None, self.tokens[self.at :])
                end = self.at + sum(1 for _ in numbers)
            if end > len(self.tokens):
                raise A2lError(f"has too few words after {keyword}")
            results[keyword] = [unquote(token) for token in self.tokens[self.at : end]]
            self.at = end
        return results


def parse_number(word: str) -> float | None:
    """Return a number of A2L: decimal, or hexadecimal with 0x; infinite if it is beyond all numbers.

    >>> parse_number("0x10"), parse_number("1e3"), parse_number("one")
    (16.0, 1000.0, None)
    """
    value = parse_float(word)
    if not isnan(value):
        return value
    integer = parse_integer(word)
    return None if integer is None else float(integer)


def parse_integer(word: str) -> int | None:
    """Return a whole number of at most 64 bits, None if the word is none."""
    # Python reads 1_000 as a number, and takes long to read thousands of digits
    if len(word) > 40 or "_" in word:
        return None
    try:
        sign, digits = (-1, word[1:]) if word[:1] == "-" else (1, word.removeprefix("+"))
        value = sign * int(digits, 16 if digits[:2] in ("0x", "0X") else 10)
    except ValueError:
        # a whole number may be written as 1e3
        number = parse_float(word)
        return int(number) if number.is_integer() and abs(number) < 2**53 else None
    return value if abs(value) < 2**64 else None
