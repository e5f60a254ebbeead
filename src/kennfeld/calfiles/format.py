"""What every calibration format shares: the file as read, the notes taken on it, and what came out.

What a set of parameters keeps of an image that it was read from.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.errors import Finding, InputError
from kennfeld.parameter_set import ParameterSet

if TYPE_CHECKING:
    from kennfeld.calfiles.a2l.objects import A2l
    from kennfeld.calfiles.flash.image import Image

__all__ = ["CalibrationSource", "Findings", "FlashOrigin", "Format", "ReadResult", "WriteResult"]

_DECLARED = re.compile(rb'\s*\*\s*encoding\s*=\s*"?([A-Za-z0-9_.:-]+)')
# Python also knows codecs that are no character sets (zip, unicode_escape, ...); a file must not reach them.
_CHARACTER_SET = re.compile(r"(utf|cp\d|windows|iso|latin|ascii|us-ascii|gb|big5|shift|euc|koi)", re.IGNORECASE)
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_LINE_OF = re.compile(r" line (\d+)")
_HEAD = 65536  # bytes that tell text from other content
_EXCERPT = 120  # characters of a line shown with a finding


@dataclass(frozen=True, eq=False)
class FlashOrigin:
    """Where a set of parameters was read from: an image, and the A2L file that describes it."""

    a2l: "A2l"
    image: "Image"


@dataclass
class Findings:
    """Everything noticed while one file is read: errors refuse it, remarks are shown by `kennfeld info`."""

    file: str
    _taken: list[tuple[int, Finding]] = field(default_factory=list)

    def error(self, line: int, thing: str, message: str, remedy: str = "", excerpt: str = "") -> None:
        """Note what makes the file unusable; line 0 stands for the file as a whole."""
        self._taken.append((line, Finding(self._place(line, thing), message, remedy, excerpt.strip()[:_EXCERPT])))

    def remark(self, line: int, thing: str, message: str, remedy: str = "") -> None:
        """Note what was left aside."""
        self._taken.append((line, Finding(self._place(line, thing), message, remedy, severity="warning")))

    def take(self, finding: Finding) -> None:
        """Note what another room found, in the order of its lines."""
        line = _LINE_OF.search(finding.place)
        self._taken.append((int(line[1]) if line else 0, finding))

    def _place(self, line: int, thing: str) -> str:
        place = f"{self.file} line {line}" if line else self.file
        return f"{place} ({thing})" if thing else place

    def settle(self) -> tuple[Finding, ...]:
        """The remarks in the order of the file; raises `InputError` with every finding if there was an error."""
        ordered = [finding for _, finding in sorted(self._taken, key=lambda taken: taken[0])]
        errors = [finding for finding in ordered if finding.severity == "error"]
        if errors:
            raise InputError(errors)
        return tuple(ordered)


@dataclass(frozen=True)
class CalibrationSource:
    """A calibration file as it lies on the disk.

    For formats whose files come in pairs, `path` tells where it is, and `partner` is the other file where it was named.
    """

    name: str
    raw: bytes
    path: Path | None = None
    partner: Path | None = None

    @property
    def is_binary(self) -> bool:
        """Whether it holds bytes that no text has; UTF-16 is text."""
        return b"\0" in self.raw[:_HEAD] and self.mark not in _UTF_16

    @cached_property
    def text(self) -> str:
        """The characters with lines that end in a bare line feed.

        A byte order mark decides first, then a first line `* encoding="..."`, then UTF-8;
        what is none of these is cp1252, as older INCA and ASCET wrote it.
        """
        return self._decoded.replace("\r\n", "\n").replace("\r", "\n")

    @property
    def lines(self) -> list[str]:
        """The lines of `text`, each with the line end that the file has; the last one may have none."""
        return _LINE.findall(self._decoded)

    def encoded(self, text: str) -> bytes:
        """The bytes of a text in the encoding of this file, behind its byte order mark."""
        return self.mark + text.encode(self.encoding, errors="replace")

    @property
    def mark(self) -> bytes:
        """The byte order mark."""
        return next((mark for mark in _MARKS if self.raw.startswith(mark)), b"")

    @cached_property
    def encoding(self) -> str:
        """The name of the encoding."""
        if self.mark:
            return _MARKS[self.mark]
        for encoding in (self._declared(), "utf-8", "cp1252"):
            try:
                self.raw.decode(encoding)
            except (LookupError, ValueError):
                continue
            return encoding
        return "latin-1"

    @property
    def is_exact(self) -> bool:
        """Whether the text gives the bytes of the file again."""
        return self.encoded(self._decoded) == self.raw

    @cached_property
    def _decoded(self) -> str:
        return self.raw[len(self.mark) :].decode(self.encoding, errors="replace")

    def _declared(self) -> str:
        found = _DECLARED.match(self.raw)
        name = found[1].decode("ascii") if found else ""
        return name if _CHARACTER_SET.match(name) else "utf-8"


@dataclass(frozen=True)
class ReadResult:
    """What a reader found: the values, the dialect of the file, and what it left aside."""

    kind: str
    parameters: ParameterSet
    remarks: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class WriteResult:
    """The bytes of a file to be written, and what should be said about them."""

    raw: bytes
    remarks: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Format:
    """One calibration format: how it is told from others, read and written.

    The functions are named as `module:function` of this room, and loaded when they are needed. What tells a format is
    given the text of a file, or the file itself, of which the beginning has to do, where the format is `binary`. What
    writes turns a set into the text or the bytes of a file; its second argument is the file's name, for findings.
    `lacks` are the aspects of a set that a new file has no place for, in the words of `loss_report`.
    """

    name: str
    endings: tuple[str, ...]
    _recognises: str
    _read: str
    _write: str
    binary: bool = False
    lacks: tuple[str, ...] = ()

    def recognises(self, source: CalibrationSource) -> bool:
        """Whether a file is of this format."""
        if self.binary:
            return bool(_loaded(self._recognises)(source))
        return not source.is_binary and bool(_loaded(self._recognises)(source.text))

    def read(self, source: CalibrationSource) -> ReadResult:
        """What a file holds; raises `InputError` with every finding."""
        content: ReadResult = _loaded(self._read)(source)
        return content

    def write(self, parameters: ParameterSet, file: str) -> WriteResult:
        """The file that holds a set; raises `InputError` naming what the format cannot hold."""
        made: str | WriteResult = _loaded(self._write)(parameters, file)
        return WriteResult(made.encode("utf-8", errors="replace")) if isinstance(made, str) else made


def _loaded(name: str) -> Callable[..., Any]:
    module, function = name.split(":")
    found: Callable[..., Any] = getattr(import_module(f"kennfeld.calfiles.{module}"), function)
    return found
