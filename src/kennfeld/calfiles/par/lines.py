"""Splits the text of a CANape parameter file into labels with their numbers.

    CANape PAR V3.1: ecu.a2l 1 0 ECU
    ;comment
    Kp [FLOAT(32)] 0.08 ; 0.080
    Map [INT(16),(2,3)] 10 ; 1.0
    : 20 ; 2.0
    X : 700 ; 700
    Name [STRING(3)] 69 67 85 ; ECU

Behind a number stands, after a semicolon, its physical value or word. The sizes are those of y and x, and x varies
fastest. Version 3.2 puts the first number of an array on a line of its own. Breakpoints follow the values if the
control unit stores them with the table.
"""

import re
from collections.abc import Iterator
from dataclasses import field
from math import isnan, prod

from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import parse_float
from kennfeld.calfiles.format import FileFindings

_SIGNATURE = re.compile(r"\ufeff?\s*CANape PAR V(\d+(?:\.\d+)*)")
# name, perhaps further words, [type(bits),(sizes)], and the rest
_HEADER = re.compile(
    r"\s*([^\s;:\[]\S*)\s+(?:[^\s\[;][^\[;]*\s)?\[\s*(STRING|INT|UINT|FLOAT|DOUBLE)\s*(?:\(\s*(\d{1,5})\s*\))?\s*"
    r"(?:,\s*\(\s*(\d{1,7}(?:\s*,\s*\d{1,7}){0,4})\s*\)\s*)?\](.*)",
    re.DOTALL,
)
_NUMBER = re.compile(r"\s*([XYZ]?)\s*:(.*)", re.DOTALL)
_HEX = re.compile(r"0[xX][0-9a-fA-F]{1,16}")
_MOST = 10_000_000  # numbers of a label
_MAX_SKIPPED = 20  # lines that are reported
AXES = ("X", "Y", "Z")


@dataclass(frozen=True, slots=True)
class ParNumber:
    """A number as the control unit stores it, its physical value as text, and where both are in the file's text."""

    raw: float
    word: str
    begin: int
    physical: str  # empty if the file has none
    physical_begin: int


@dataclass(slots=True)
class ParLabel:
    """A label with its numbers: the values by x, then y, and the breakpoints of each axis."""

    name: str
    type: str
    bits: int | None
    sizes: tuple[int, ...]  # z, y, x; empty for a single value
    line: int
    values: list[ParNumber] = field(default_factory=list)
    axes: dict[str, list[ParNumber]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """The number of values."""
        return prod(self.sizes)

    @property
    def is_integer(self) -> bool:
        """True if the control unit stores integers."""
        return self.type in ("INT", "UINT")


def displayed_value(text: str) -> float:
    """Return the physical value that a text displays, decimal or hexadecimal; NaN for words.

    >>> displayed_value("1.50"), displayed_value("0x1F")
    (1.5, 31.0)
    """
    return float(int(text, 16)) if _HEX.fullmatch(text) else parse_float(text)


def is_hexadecimal(text: str) -> bool:
    """Check whether a text displays a number as hexadecimal."""
    return _HEX.fullmatch(text) is not None


def version_of(text: str) -> str:
    """Return the version that the first line states."""
    match = _SIGNATURE.match(text)
    return match[1] if match else ""


def split_labels(lines: list[str], findings: FileFindings) -> list[ParLabel]:
    """Return the labels of a file; reports lines that belong to none and labels that lack numbers.

    Args:
        lines: The lines with their ends.
        findings: Receives the errors and warnings.
    """
    splitter = _Splitter(findings)
    offset = 0
    for number, line in enumerate(lines, 1):
        if number > 1 and line.strip() and not line.lstrip().startswith(";"):
            splitter.feed(number, line, offset)
        offset += len(line)
    splitter.finish()
    return splitter.labels


class _Splitter:
    def __init__(self, findings: FileFindings) -> None:
        self.findings = findings
        self.labels: list[ParLabel] = []
        self.skipped = 0

    def feed(self, number: int, line: str, offset: int) -> None:
        match = _NUMBER.fullmatch(line)
        if match:
            self._take_number(number, match, offset)
            return
        header = _HEADER.fullmatch(line)
        if header is None:
            self.skipped += 1
            if self.skipped <= _MAX_SKIPPED:
                self.findings.warning(number, "", f"skipped, since it is not a label: {line.strip()[:60]!r}")
            return
        self._check_last()
        name, kind, bits, sizes, rest = header.groups()
        shape = tuple(int(size) for size in sizes.split(",")) if sizes else ()
        label = ParLabel(name, kind, int(bits) if bits else None, shape, number)
        self.labels.append(label)
        if not 0 < label.count <= _MOST:
            self.findings.error(number, name, f"must have 1 to {_MOST} numbers, got the sizes {sizes}")
        if kind == "STRING":
            label.values += self._codes(label, number, rest, offset + header.start(5))
        elif rest.partition(";")[0].strip():
            label.values += self._numbers(label, number, rest, offset + header.start(5))

    def _take_number(self, number: int, match: re.Match[str], offset: int) -> None:
        if not self.labels:
            self.findings.error(number, "", "a number without a label", "Restore the line of the label above it.")
            return
        label, letter = self.labels[-1], match[1]
        if label.type == "STRING":
            self.findings.error(number, label.name, "a number below a text", "The codes of a text are in its line.")
            return
        numbers = self._numbers(label, number, match[2], offset + match.start(2))
        (label.axes.setdefault(letter, []) if letter else label.values).extend(numbers)

    def _numbers(self, label: ParLabel, line: int, text: str, offset: int) -> Iterator[ParNumber]:
        """Yield the one number of a line; report it if it is none."""
        before, _, comment = text.partition(";")
        word = before.strip()
        raw = parse_float(word)
        if isnan(raw):
            self.findings.error(line, label.name, f"must be a number, got {word[:40]!r}", "", text)
        physical = comment.strip()
        begin = offset + len(before) - len(before.lstrip())
        # behind the semicolon and its blanks
        after = offset + len(before) + 1 + len(comment) - len(comment.lstrip())
        yield ParNumber(raw, word, begin, physical, after)

    def _codes(self, label: ParLabel, line: int, text: str, offset: int) -> Iterator[ParNumber]:
        """Yield the character codes of a text."""
        before = text.partition(";")[0]
        for match in re.finditer(r"\S+", before):
            if not match[0].isdecimal() or int(match[0]) > 255:
                self.findings.error(line, label.name, f"must be a character code, 0 to 255, got {match[0][:40]!r}")
                return
            yield ParNumber(float(match[0]), match[0], offset + match.start(), "", 0)

    def _check_last(self) -> None:
        """Report a label that has not as many numbers as its sizes say."""
        if not self.labels or self.labels[-1].type == "STRING":
            return
        label = self.labels[-1]
        counts = {"": (len(label.values), label.count)}
        # the sizes are stated from the last axis to x
        sizes = dict(zip(AXES, reversed(label.sizes), strict=False))
        counts |= {letter: (len(points), sizes.get(letter, 0)) for letter, points in label.axes.items()}
        for letter, (count, size) in counts.items():
            if count != size:
                numbers = f"{count_noun(count, f'{letter} breakpoint' if letter else 'value')}, but {size} by its sizes"
                remedy = "The file may be truncated: use a complete copy."
                self.findings.error(label.line, label.name, f"has {numbers}", remedy)

    def finish(self) -> None:
        self._check_last()
        if self.skipped > _MAX_SKIPPED:
            self.findings.warning(0, "", f"{self.skipped - _MAX_SKIPPED} more lines that are not labels were skipped")
