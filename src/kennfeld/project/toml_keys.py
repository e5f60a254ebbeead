"""Finds the keys of TOML text, with the positions of their values."""

import re
import tomllib
from typing import Literal

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.program.positions import TextLines
from kennfeld.project.section import KeyPath

_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")  # also comments
_SPACE = re.compile(r"[ \t]*")
# a multi-line text may end with up to two quotes of its own before the three that close it
_TEXT = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}(?!")|' + r"'''.*?'{3,5}(?!')|" + r'"(?:\\.|[^"\\\n])*"|' + r"'[^'\n]*'", re.DOTALL
)
_NAME = re.compile(r"""[A-Za-z0-9_-]+|"(?:\\.|[^"\\\n])*"|'[^'\n]*'""")
_FLAT = re.compile(r"""\[[^\[\]{}"'#]*\]""")  # a list of numbers
_PLAIN = re.compile(r"[^,\]}#\n\r]*")  # a number, a date or a flag


@dataclass(frozen=True)
class KeySpan:
    """Position of a key, a heading, or a table in a list.

    Attributes:
        kind: of the TOML element.
        start: offset of its first character; that of a key is the offset of its name.
        value: offset of its value; of a heading, the end of the line.
        end: offset behind its value.
    """

    kind: Literal["heading", "key", "item"]
    start: int
    value: int
    end: int

    @property
    def has_value(self) -> bool:
        """True unless this is a heading, or only a part of a dotted key."""
        return self.kind != "heading" and self.end > self.value


class TomlKeys:
    r"""The keys of valid TOML text.

    >>> keys = TomlKeys('[model]\nstep = 0.1\n[[dataset]]\nfiles = ["a.csv"]\n')
    >>> keys.line(("dataset", 1, "files")), list(keys.spans)[1]
    (4, ('model', 'step'))
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.spans: dict[KeyPath, KeySpan] = {}
        self.headings: list[tuple[int, KeyPath]] = []  # in the order of the text
        self._counts: dict[KeyPath, int] = {}
        # offsets of line breaks, in which `line` searches: counting them anew for each key takes quadratic time
        self._lines = TextLines(text)
        self._scan()

    def line(self, path: KeyPath) -> int:
        """Return the line of a key, or of the nearest table around it that the text has; 0 if there is none."""
        for length in range(len(path), 0, -1):
            span = self.spans.get(path[:length])
            if span is not None:
                return self._lines.number(span.start)
        return 0

    def block_end(self, heading: KeyPath) -> int:
        """Return the offset at which the keys below a heading end: behind the line of the last of them."""
        starts = [start for start, path in self.headings if path == heading]
        start = starts[-1] if starts else 0
        following = [other for other, _ in self.headings if other > start or not starts]
        stop = following[0] if following else len(self.text)
        inside = [span for span in self.spans.values() if start <= span.start < stop and span.kind != "item"]
        last = max((span.end for span in inside), default=0)
        return self.line_end(last) if inside else 0

    def line_end(self, offset: int) -> int:
        """Return the offset behind the line break that follows."""
        at = self.text.find("\n", offset)
        return len(self.text) if at < 0 else at + 1

    def _scan(self) -> None:
        prefix: KeyPath = ()
        at = self._skip(_BLANK, 0)
        while at < len(self.text):
            if self.text[at] == "[":
                prefix, end = self._heading(at)
            else:
                end = self._key(prefix, at)
            at = self._skip(_BLANK, end)

    def _heading(self, at: int) -> tuple[KeyPath, int]:
        is_list = self.text.startswith("[[", at)
        names, end = self._names(at + 1 + is_list)
        end += 1 + is_list
        path = self._resolve(names[:-1])
        if is_list:
            count = self._counts[(*path, names[-1])] = self._counts.get((*path, names[-1]), 0) + 1
            # the first heading of a list stands for the list
            self.spans.setdefault((*path, names[-1]), KeySpan("heading", at, end, end))
            path = (*path, names[-1], count)
        else:
            path = self._resolve(names)
        self.spans.setdefault(path, KeySpan("heading", at, end, end))
        self.headings.append((at, path))
        return path, end

    def _resolve(self, names: list[str]) -> KeyPath:
        """Return the path of dotted names; within a list of sections they belong to its last one."""
        path: KeyPath = ()
        for name in names:
            path = (*path, name)
            if path in self._counts:
                path = (*path, self._counts[path])
        return path

    def _names(self, at: int) -> tuple[list[str], int]:
        """Return dotted names, and the offset behind them."""
        names: list[str] = []
        while True:
            at = self._skip(_SPACE, at)
            match = _NAME.match(self.text, at)
            assert match is not None, "valid TOML has a name here"
            names.append(next(iter(tomllib.loads(f"{match[0]} = 0"))) if match[0][0] in "\"'" else match[0])
            at = self._skip(_SPACE, match.end())
            if not self.text.startswith(".", at):
                return names, at
            at += 1

    def _key(self, prefix: KeyPath, start: int) -> int:
        names, at = self._names(start)
        value = self._skip(_SPACE, at + 1)
        path = (*prefix, *names)
        # parts of a dotted key have a place, but no value: start = end
        for length in range(1, len(names)):
            self.spans.setdefault(path[: len(prefix) + length], KeySpan("key", start, start, start))
        end = self._value(path, value)
        self.spans[path] = KeySpan("key", start, value, end)
        return end

    def _value(self, path: KeyPath, at: int) -> int:
        """Record the tables within a value; return the offset behind it."""
        # lists of numbers, which are long, in one match
        for pattern in (_TEXT, _FLAT):
            if match := pattern.match(self.text, at):
                return match.end()
        if self.text[at] == "{":
            return self._inline(path, at)
        if self.text[at] != "[":
            match = _PLAIN.match(self.text, at)
            return at + len(match[0].rstrip()) if match else at
        at, number = self._skip(_BLANK, at + 1), 0
        while self.text[at] != "]":
            number += 1
            end = self._value((*path, number), at)
            if self.text[at] == "{":
                self.spans[(*path, number)] = KeySpan("item", at, at, end)
            at = self._skip_comma(end)
        return at + 1

    def _inline(self, path: KeyPath, at: int) -> int:
        at = self._skip(_BLANK, at + 1)
        while self.text[at] != "}":
            at = self._skip_comma(self._key(path, at))
        return at + 1

    def _skip_comma(self, at: int) -> int:
        at = self._skip(_BLANK, at)
        return self._skip(_BLANK, at + 1) if self.text[at] == "," else at

    def _skip(self, pattern: re.Pattern[str], at: int) -> int:
        match = pattern.match(self.text, at)
        return match.end() if match else at
