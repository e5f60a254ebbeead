"""The lines of a file of records, and the findings about them."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from kennfeld.calfiles.format import Notes, counted
from kennfeld.calfiles.images.image import Record

__all__ = ["Line", "RecordReader", "octets"]

_MOST = 20  # findings of one kind that are told
_NOTHING = b" \t\r\n\x1a\0"  # what stands between lines and behind the last one


@dataclass(frozen=True, slots=True)
class Line:
    """A line that is not empty: its text without blanks around it, and where that begins in the file."""

    number: int
    text: bytes
    at: int


@dataclass
class Findings:
    """Notes on lines; of many alike only the first are told, with how many there are."""

    notes: Notes
    counts: dict[str, int] = field(default_factory=dict)
    last: dict[str, int] = field(default_factory=dict)

    def error(self, line: Line, what: str, kind: str, mend: str = "") -> None:
        """Note what makes the file unusable."""
        self.counts[kind] = self.counts.get(kind, 0) + 1
        self.last[kind] = line.number
        if self.counts[kind] <= _MOST:
            self.notes.error(line.number, "", what, mend, line.text[:80].decode("latin-1"))

    def close(self, records: Sequence[Record]) -> None:
        """Tell how many findings were not told one by one, or that there is nothing in the file."""
        if not self.counts and not records:
            self.notes.error(0, "", "holds no bytes of any memory")
        for kind, count in self.counts.items():
            if count > _MOST:
                more = counted(count - _MOST, "further line")
                self.notes.error(self.last[kind], "", f"{more} up to here with {kind}")


class RecordReader(ABC):
    """Reads a file of records; a format says how a line is taken, and what it means that the end is missing.

    `besides` is how many bytes of a line its stated length leaves out, `total` what its bytes add up to, modulo 256.
    """

    besides = 1
    total = 0

    def __init__(self, notes: Notes) -> None:
        self.notes = notes
        self.findings = Findings(notes)
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
            what = f"states {content[0]} bytes and holds {held}"
            self.findings.error(line, what, "another length than stated", "The file is damaged.")
        elif content[-1] != right:
            what = f"has the checksum {content[-1]:02X}, its bytes give {right:02X}"
            self.findings.error(line, what, "a wrong checksum", "The file is damaged; fetch it once more.")
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


def overlaps(records: list[Record], notes: Notes) -> None:
    """Tell where records give the same memory twice."""
    found: list[Record] = []
    end = -1
    for record in sorted(records, key=lambda one: one.address):
        if record.address < end:
            found.append(record)
        end = max(end, record.end)
    if found:
        first = min(found, key=lambda one: one.line)
        what = f"{counted(len(found), 'record')} overlap with others, the first at 0x{first.address:X}"
        notes.remark(first.line, "", f"{what}; of each byte the last record counts")
