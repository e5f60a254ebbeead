"""Motorola S-records: `Stllaa..dd..cc`, each line a record with its type, length, address, bytes and checksum.

S1, S2 and S3 hold bytes at addresses of 16, 24 and 32 bits, S0 a title, S5 and S6 how many of them there were,
S7, S8 and S9 end the file.

Intel HEX: `:llaaaattdd..cc`, each line a record with its length, address, type, bytes and checksum.

Types: 00 data, 01 end, 02 segment (address x 16), 03 and 05 start of the program, 04 upper half of the address
(Intel: Hexadecimal Object File Format Specification, revision A, 1988). What tools write around it, such as a closing
0x1A, empty lines and any ends of lines, is accepted and kept.

The lines of a file of records, and the findings about them.

Which kind of image a file is.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from kennfeld.calfiles.flash.image import Image, Record
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import count_noun

__all__ = ["read_image", "recognises_image"]

_MOST = 20  # findings of one kind that are told
_NOTHING = b" \t\r\n\x1a\0"  # what stands between lines and behind the last one

_ADDRESSES = {"0": 2, "1": 2, "2": 3, "3": 4, "5": 2, "6": 3, "7": 4, "8": 3, "9": 2}  # bytes of each type

_HALF = 1 << 16
_SIZES = {1: 0, 2: 2, 3: 4, 4: 2, 5: 4}  # bytes of each type but data

_INTEL = re.compile(rb"\s*:[0-9A-Fa-f]{10}")
_MOTOROLA = re.compile(rb"\s*S[0-9][0-9A-Fa-f]{6}")


@dataclass(frozen=True, slots=True)
class Line:
    """A line that is not empty: its text without blanks around it, and where that begins in the file."""

    number: int
    text: bytes
    at: int


@dataclass
class LineFindings:
    """Notes on lines; of many alike only the first are told, with how many there are."""

    notes: Findings
    counts: dict[str, int] = field(default_factory=dict)
    last: dict[str, int] = field(default_factory=dict)

    def error(self, line: Line, message: str, kind: str, remedy: str = "") -> None:
        """Note what makes the file unusable."""
        self.counts[kind] = self.counts.get(kind, 0) + 1
        self.last[kind] = line.number
        if self.counts[kind] <= _MOST:
            self.notes.error(line.number, "", message, remedy, line.text[:80].decode("latin-1"))

    def close(self, records: Sequence[Record]) -> None:
        """Tell how many findings were not told one by one, or that there is nothing in the file."""
        if not self.counts and not records:
            self.notes.error(0, "", "holds no bytes of any memory")
        for kind, count in self.counts.items():
            if count > _MOST:
                more = count_noun(count - _MOST, "further line")
                self.notes.error(self.last[kind], "", f"{more} up to here with {kind}")


class RecordReader(ABC):
    """Reads a file of records; a format says how a line is taken, and what it means that the end is missing.

    `besides` is how many bytes of a line its stated length leaves out, `total` what its bytes add up to, modulo 256.
    """

    besides = 1
    total = 0

    def __init__(self, notes: Findings) -> None:
        self.notes = notes
        self.findings = LineFindings(notes)
        self.records: list[Record] = []
        self.ended = False

    def read(self, raw: bytes) -> list[Record]:
        """All records of a file, in its order; what is wrong is noted."""
        behind: Line | None = None
        for line in lines_of(raw):
            if self.ended:
                behind = behind or line
            else:
                self.take(line)
        self.findings.close(self.records)
        if not self.ended:
            self.lack_end()
        elif behind is not None:
            self.notes.remark(behind.number, "", "there is something behind the end record; left aside")
        overlaps(self.records, self.notes)
        return self.records

    @abstractmethod
    def take(self, line: Line) -> None:
        """Check a line and keep what it holds."""

    @abstractmethod
    def lack_end(self) -> None:
        """Note that there is no end record."""

    def is_sound(self, line: Line, content: bytes) -> bool:
        """Whether the bytes of a line are as many as it states, and give its checksum."""
        held = len(content) - self.besides
        right = (self.total - sum(content[:-1])) % 256
        if content[0] != held:
            message = f"states {content[0]} bytes and holds {held}"
            self.findings.error(line, message, "another length than stated", "The file is damaged.")
        elif content[-1] != right:
            message = f"has the checksum {content[-1]:02X}, its bytes give {right:02X}"
            self.findings.error(line, message, "a wrong checksum", "The file is damaged; fetch it once more.")
        else:
            return True
        return False


def lines_of(raw: bytes) -> Iterator[Line]:
    """The lines that hold something; they end in CR, LF or both."""
    at = 0
    for number, line in enumerate(raw.splitlines(keepends=True), 1):
        text = line.strip(_NOTHING)
        if text:
            yield Line(number, text, at + line.find(text[:1]))
        at += len(line)


def octets(digits: bytes) -> bytes | None:
    """The bytes that hexadecimal digits stand for, None where they are none."""
    try:
        found = bytes.fromhex(digits.decode("ascii"))
    except ValueError:
        return None
    return found if 2 * len(found) == len(digits) else None


def overlaps(records: list[Record], notes: Findings) -> None:
    """Tell where records give the same memory twice."""
    found: list[Record] = []
    end = -1
    for record in sorted(records, key=lambda one: one.address):
        if record.address < end:
            found.append(record)
        end = max(end, record.end)
    if found:
        first = min(found, key=lambda one: one.line)
        message = f"{count_noun(len(found), 'record')} overlap with others, the first at 0x{first.address:X}"
        notes.remark(first.line, "", f"{message}; of each byte the last record counts")


def read_s_records(raw: bytes, name: str, notes: Findings) -> Image:
    """The image in a file of S-records; errors are noted for every line that is wrong."""
    return Image(name, "S-records", raw, SRecordReader(notes).read(raw))


class SRecordReader(RecordReader):
    total = 255

    def __init__(self, notes: Findings) -> None:
        super().__init__(notes)
        self.lines = 0  # of bytes

    def take(self, line: Line) -> None:
        kind = line.text[1:2].decode("latin-1")
        content = octets(line.text[2:]) if line.text[:1] == b"S" else None
        if content is None or kind not in _ADDRESSES or len(content) < _ADDRESSES[kind] + 2:
            self.findings.error(line, "is no S-record", "no record", "The file is damaged.")
        elif self.is_sound(line, content):
            self._record(line, kind, content)

    def lack_end(self) -> None:
        self.notes.remark(0, "", "has no end record (S7, S8 or S9)", "See whether the file is cut off.")

    def _record(self, line: Line, kind: str, content: bytes) -> None:
        size = _ADDRESSES[kind]
        address, data = int.from_bytes(content[1 : 1 + size], "big"), content[1 + size : -1]
        if kind in "123":
            self.lines += 1
            digits = line.at + 4 + 2 * size
            if data:
                self.records.append(Record(address, data, digits, digits + 2 * len(data), line.number))
        elif kind in "56" and address != self.lines % (1 << (8 * size)):
            message = f"counts {count_noun(address, 'record')}, there were {self.lines}"
            self.findings.error(line, message, "a wrong count", "The file is damaged or cut.")
        elif kind in "789":
            self.ended = True


def read_intel_hex(raw: bytes, name: str, notes: Findings) -> Image:
    """The image in an Intel HEX file; errors are noted for every line that is wrong, and for a missing end."""
    return Image(name, "Intel HEX", raw, IntelHexReader(notes).read(raw))


class IntelHexReader(RecordReader):
    besides = 5  # length, address, type and checksum

    def __init__(self, notes: Findings) -> None:
        super().__init__(notes)
        self.base, self.segmented = 0, False

    def take(self, line: Line) -> None:
        content = octets(line.text[1:]) if line.text.startswith(b":") else None
        if content is None or len(content) < self.besides:
            self.findings.error(line, "is no record of Intel HEX", "no record", "The file is damaged.")
        elif self.is_sound(line, content):
            self._record(line, content)

    def lack_end(self) -> None:
        self.notes.error(0, "", "has no end record (:00000001FF)", "The file is cut off; fetch it once more.")

    def _record(self, line: Line, content: bytes) -> None:
        kind, data = content[3], content[4:-1]
        if kind == 0:
            self.records += self._data(line, int.from_bytes(content[1:3], "big"), data)
        elif kind not in _SIZES or len(data) != _SIZES[kind]:
            message = f"is a record of type {kind:02X} with {len(data)} bytes, which Intel HEX does not have"
            self.findings.error(line, message, "an unknown type")
        elif kind == 1:
            self.ended = True
        elif kind in (2, 4):
            self.segmented = kind == 2
            self.base = int.from_bytes(data, "big") << (4 if self.segmented else 16)

    def _data(self, line: Line, offset: int, data: bytes) -> Iterator[Record]:
        """The bytes of one line: within a segment addresses begin anew behind 0xFFFF."""
        digits, checksum = line.at + 9, line.at + 9 + 2 * len(data)
        room = _HALF - offset if self.segmented else 2**32 - self.base - offset
        if data[:room]:
            yield Record(self.base + offset, data[:room], digits, checksum, line.number)
        if data[room:]:
            begin = self.base if self.segmented else 0
            yield Record(begin, data[room:], digits + 2 * room, checksum, line.number)


def recognises_image(head: bytes) -> bool:
    """Whether a file begins like Intel HEX or S-records."""
    return _INTEL.match(head) is not None or _MOTOROLA.match(head) is not None


def read_image(raw: bytes, name: str, notes: Findings) -> Image:
    """The image in a file; notes an error for each line that is wrong.

    Whoever reads on calls `notes.settle()` first.
    """
    if _MOTOROLA.match(raw):
        return read_s_records(raw, name, notes)
    if raw.lstrip().startswith(b":"):
        return read_intel_hex(raw, name, notes)
    notes.error(0, "", "is neither Intel HEX nor a file of S-records" if raw.strip() else "is empty")
    return Image(name, "", raw, ())
