"""Reads Intel HEX and Motorola S-records, line by line.

An S-record is `Stllaa..dd..cc`: type, length, address, bytes and checksum. S1, S2 and S3 contain bytes at addresses of
16, 24 and 32 bits, S0 a title, S5 and S6 the number of records, S7, S8 and S9 end the file.

An Intel HEX record is `:llaaaattdd..cc`: length, address, type, bytes and checksum. Types: 00 data, 01 end, 02 segment
(address x 16), 03 and 05 start of the program, 04 upper half of the address (Intel: Hexadecimal Object File Format
Specification, revision A, 1988). Surrounding content of tools, such as a closing 0x1A, empty lines and any line ends,
is accepted and kept.
"""

import re
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Iterator, Sequence

from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.flash.image import Image, Record
from kennfeld.calfiles.format import FileFindings

_MAX_LISTED = 20  # findings of one kind that are listed
_FILLER = b" \t\r\n\x1a\0"  # between lines and after the last one
_ADDRESS_SIZES = {"0": 2, "1": 2, "2": 3, "3": 4, "5": 2, "6": 3, "7": 4, "8": 3, "9": 2}  # bytes of each type
_SEGMENT_SIZE = 1 << 16
_DATA_SIZES = {1: 0, 2: 2, 3: 4, 4: 2, 5: 4}  # bytes of each type but data

_INTEL = re.compile(rb"\s*:[0-9A-Fa-f]{10}")
_MOTOROLA = re.compile(rb"\s*S[0-9][0-9A-Fa-f]{6}")


@dataclass(frozen=True, slots=True)
class Line:
    """A non-empty line: its stripped text, and the offset of that text in the file."""

    number: int
    text: bytes
    at: int


class RecordReader(ABC):
    """Base of the readers; a format defines how a line is read, and what a missing end record means.

    `overhead` is how many bytes of a line its stated length leaves out, `total` what its bytes add up to, modulo 256.
    """

    overhead = 1
    total = 0
    mark = b":"  # what a line begins with; the digits follow
    record_name = "Intel HEX record"

    def __init__(self, findings: FileFindings) -> None:
        self.findings = findings
        self.records: list[Record] = []
        self.ended = False
        self.faults: dict[str, list[int]] = {}  # the lines of each kind of fault

    def read(self, raw: bytes) -> list[Record]:
        """Return all records of a file, in its order; what is wrong is reported."""
        trailing: Line | None = None
        for line in lines_of(raw):
            if self.ended:
                trailing = trailing or line
            else:
                self.take(line)
        if not self.faults and not self.records:
            self.findings.error(0, "", "contains no data")
        for kind, lines in self.faults.items():
            if len(lines) > _MAX_LISTED:
                more = count_noun(len(lines) - _MAX_LISTED, "further line")
                self.findings.error(lines[-1], "", f"{more} up to here with {kind}")
        if not self.ended:
            self.lack_end()
        elif trailing is not None:
            self.findings.warning(trailing.number, "", "content after the end record; skipped")
        report_overlaps(self.records, self.findings)
        return self.records

    def error(self, line: Line, message: str, kind: str, remedy: str = "") -> None:
        """Add an error in a line; of many of one kind only the first are reported, with their number."""
        lines = self.faults.setdefault(kind, [])
        lines.append(line.number)
        if len(lines) <= _MAX_LISTED:
            self.findings.error(line.number, "", message, remedy, line.text[:80].decode("latin-1"))

    def take(self, line: Line) -> None:
        """Check a line and add its content."""
        # the mark of an S-record includes its type, which is not a digit of the content
        content = decode_hex(line.text[len(self.mark) :]) if line.text.startswith(self.mark[:1]) else None
        if content is None or not self.is_long_enough(line, content):
            self.error(line, f"is not an {self.record_name}", "no valid record", "The file is damaged.")
        elif self.is_sound(line, content):
            self.add(line, content)

    @abstractmethod
    def is_long_enough(self, line: Line, content: bytes) -> bool:
        """Check whether a line has all parts of a record of its type."""

    @abstractmethod
    def add(self, line: Line, content: bytes) -> None:
        """Add the content of a record."""

    @abstractmethod
    def lack_end(self) -> None:
        """Report a missing end record."""

    def is_sound(self, line: Line, content: bytes) -> bool:
        """Check the length and checksum of a line."""
        size = len(content) - self.overhead
        checksum = (self.total - sum(content[:-1])) % 256
        if content[0] != size:
            message = f"states {content[0]} bytes, but contains {size}"
            self.error(line, message, "a wrong length", "The file is damaged.")
            return False
        if content[-1] != checksum:
            message = f"has the checksum {content[-1]:02X}, but its bytes give {checksum:02X}"
            self.error(line, message, "a wrong checksum", "The file is damaged; transfer it again.")
        return content[-1] == checksum


def lines_of(raw: bytes) -> Iterator[Line]:
    """Yield the non-empty lines; they end in CR, LF or both."""
    at = 0
    for number, line in enumerate(raw.splitlines(keepends=True), 1):
        text = line.strip(_FILLER)
        if text:
            # the filler before the text does not contain its first character
            yield Line(number, text, at + line.find(text[:1]))
        at += len(line)


def decode_hex(digits: bytes) -> bytes | None:
    """Convert hexadecimal digits to bytes, None if they are invalid."""
    try:
        content = bytes.fromhex(digits.decode("ascii"))
    except ValueError:
        return None
    # Python skips blanks between bytes
    return content if 2 * len(content) == len(digits) else None


def report_overlaps(records: list[Record], findings: FileFindings) -> None:
    """Warn about records that define the same memory twice."""
    overlapping: list[Record] = []
    shared: list[int] = []  # addresses
    end = -1
    for record in sorted(records, key=lambda record: record.address):
        if record.address < end:
            overlapping.append(record)
            shared += range(record.address, min(record.end, end))
        end = max(end, record.end)
    if overlapping:
        first = min(overlapping, key=lambda record: record.line)
        message = f"{count_noun(len(overlapping), 'record')} overlap with others, the first at 0x{first.address:X}"
        differing = _differing_bytes(records, sorted(set(shared)))
        findings.warning(first.line, "", f"{message}; the last record takes precedence; {differing}")


def _differing_bytes(records: Sequence[Record], addresses: Sequence[int]) -> str:
    """Return in how many of these bytes of memory records differ, and the first one."""
    known: dict[int, tuple[int, int]] = {}  # the byte at an address, and its line
    differing: dict[int, str] = {}
    for record in records:
        begin, end = bisect_left(addresses, record.address), bisect_left(addresses, record.end)
        for address in addresses[begin:end]:
            byte = record.content[address - record.address]
            before, line = known.get(address, (byte, record.line))
            if before != byte and address not in differing:
                differing[address] = f"{before:02X} (line {line}) and {byte:02X} (line {record.line})"
            known[address] = (byte, record.line)
    if not differing:
        return "their bytes are equal"
    address = min(differing)
    return f"{count_noun(len(differing), 'byte')} differ, the first at 0x{address:X}: {differing[address]}"


class SRecordReader(RecordReader):
    total = 255
    mark = b"S0"
    record_name = "S-record"

    def __init__(self, findings: FileFindings) -> None:
        super().__init__(findings)
        self.lines = 0  # of bytes

    def is_long_enough(self, line: Line, content: bytes) -> bool:
        size = _ADDRESS_SIZES.get(line.text[1:2].decode("latin-1"))
        return size is not None and len(content) >= size + 2

    def lack_end(self) -> None:
        self.findings.warning(0, "", "has no end record (S7, S8 or S9)", "Check that the file is complete.")

    def add(self, line: Line, content: bytes) -> None:
        kind = line.text[1:2].decode("latin-1")
        size = _ADDRESS_SIZES[kind]
        address, data = int.from_bytes(content[1 : 1 + size], "big"), content[1 + size : -1]
        if kind in "123":
            self.lines += 1
            # behind `S`, type and length
            digits = line.at + 4 + 2 * size
            if data:
                self.records.append(Record(address, data, digits, digits + 2 * len(data), line.number))
        elif kind in "56" and address != self.lines % (1 << (8 * size)):
            message = f"states {count_noun(address, 'record')}, but there are {self.lines}"
            self.error(line, message, "a wrong count", "The file is damaged or truncated.")
        elif kind in "789":
            self.ended = True


class IntelHexReader(RecordReader):
    overhead = 5  # length, address, type and checksum

    def __init__(self, findings: FileFindings) -> None:
        super().__init__(findings)
        self.base, self.segmented = 0, False

    def is_long_enough(self, line: Line, content: bytes) -> bool:
        return len(content) >= self.overhead

    def lack_end(self) -> None:
        self.findings.error(0, "", "has no end record (:00000001FF)", "The file is truncated; transfer it again.")

    def add(self, line: Line, content: bytes) -> None:
        kind, data = content[3], content[4:-1]
        if kind == 0:
            self.records += self._data(line, int.from_bytes(content[1:3], "big"), data)
        elif kind not in _DATA_SIZES or len(data) != _DATA_SIZES[kind]:
            message = f"is a record of unknown type {kind:02X} with {len(data)} bytes"
            self.error(line, message, "an unknown type")
        elif kind == 1:
            self.ended = True
        elif kind in (2, 4):
            self.segmented = kind == 2
            self.base = int.from_bytes(data, "big") << (4 if self.segmented else 16)

    def _data(self, line: Line, offset: int, data: bytes) -> Iterator[Record]:
        """Yield the bytes of one line; within a segment addresses wrap around at 0xFFFF."""
        # behind `:llaaaatt`
        digits, checksum = line.at + 9, line.at + 9 + 2 * len(data)
        room = _SEGMENT_SIZE - offset if self.segmented else 2**32 - self.base - offset
        if data[:room]:
            yield Record(self.base + offset, data[:room], digits, checksum, line.number)
        if data[room:]:
            begin = self.base if self.segmented else 0
            yield Record(begin, data[room:], digits + 2 * room, checksum, line.number)


def read_image(raw: bytes, name: str, findings: FileFindings) -> Image:
    """Return the image in a file; reports each line that is wrong.

    Call `findings.finish()` before using the result.
    """
    if _MOTOROLA.match(raw):
        return Image(name, "S-records", raw, SRecordReader(findings).read(raw))
    if raw.lstrip().startswith(b":"):
        return Image(name, "Intel HEX", raw, IntelHexReader(findings).read(raw))
    findings.error(0, "", "is neither an Intel HEX nor an S-record file" if raw.strip() else "is empty")
    return Image(name, "", raw, ())
