"""The common interface of calibration formats: source file, findings, and the results of reading and writing."""

import re
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from kennfeld.base.errors import Finding, Findings, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text
from kennfeld.files.encoding import detect_encoding
from kennfeld.files.head import HEAD_SIZE

Item = Parameter | Text
Key = tuple[str, str]  # name and variant

_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_MAX_EXCERPT = 120  # characters of a line shown with a finding


class FileFindings:
    """Findings of one file: errors refuse it, warnings are shown by `kennfeld info`."""

    def __init__(self, file: str) -> None:
        self.file = file
        self._findings = Findings()
        self.add = self._findings.add
        self.finish = self._findings.finish

    def error(self, line: int, item: str, message: str, remedy: str = "", excerpt: str = "") -> None:
        """Add an error; line 0 means the file as a whole."""
        self._findings.error(Location(self.file, line, item), message, remedy, excerpt.strip()[:_MAX_EXCERPT])

    def warning(self, line: int, item: str, message: str, remedy: str = "") -> None:
        """Add a warning, such as a skipped item."""
        self._findings.warning(Location(self.file, line, item), message, remedy)


@dataclass(frozen=True)
class CalibrationSource:
    """The bytes of a calibration file.

    For formats with paired files, `path` is its location and `partner` the other file, if given.
    """

    name: str
    raw: bytes
    path: Path | None = None
    partner: Path | None = None

    @property
    def is_binary(self) -> bool:
        """True if it contains NUL bytes and is not UTF-16."""
        return b"\0" in self.raw[:HEAD_SIZE] and self.mark not in _UTF_16

    @cached_property
    def text(self) -> str:
        """The decoded text with LF line ends.

        A byte order mark decides first, then a first line `* encoding="..."`, then the bytes: see `detect_encoding`.
        """
        return self._decoded.replace("\r\n", "\n").replace("\r", "\n")

    @property
    def lines(self) -> list[str]:
        """The lines of `text` with their original line ends; the last one may have none."""
        # `splitlines` would also split at form feeds and other separators
        return _LINE.findall(self._decoded)

    def encoded(self, text: str) -> bytes:
        """Encode a text in the encoding of this file, with its byte order mark."""
        return self.mark + text.encode(self.encoding, errors="replace")

    @property
    def mark(self) -> bytes:
        return next((mark for mark in _MARKS if self.raw.startswith(mark)), b"")

    @cached_property
    def encoding(self) -> str:
        if self.mark:
            return _MARKS[self.mark]
        encoding = detect_encoding(self.raw, whole=True)
        # Latin-1 keeps each byte, so that the file can be written as it was
        try:
            self.raw.decode(encoding)
        except ValueError:
            return "latin-1"
        return encoding

    @property
    def is_exact(self) -> bool:
        """True if encoding the text reproduces the file."""
        return self.encoded(self._decoded) == self.raw

    @cached_property
    def _decoded(self) -> str:
        return self.raw[len(self.mark) :].decode(self.encoding, errors="replace")


@dataclass(frozen=True)
class ReadResult:
    """The parameters of a file, its dialect, and the findings on what was skipped."""

    kind: str
    parameters: ParameterSet
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class WriteResult:
    """The bytes of a file to write, and the findings about them."""

    raw: bytes
    findings: tuple[Finding, ...] = ()


def build_set(items: dict[Key, Item], axes: Iterable[Axis], origin: object | None = None) -> ParameterSet:
    """Build a set from items by name and variant; the first variant of each label is used, the rest are `others`."""
    # from the last to the first, so that the first variant of a name remains
    first = {name: (name, variant) for name, variant in reversed(items)}
    chosen = [items[key] for key in items if first[key[0]] == key]
    members = [item for item in chosen if isinstance(item, Parameter)]
    texts = [item for item in chosen if isinstance(item, Text)]
    others = [item for key, item in items.items() if first[key[0]] != key]
    return ParameterSet(members, texts, axes, others, origin=origin)
