"""Motorola S-records: `Stllaa..dd..cc`, each line a record with its type, length, address, bytes and checksum.

S1, S2 and S3 hold bytes at addresses of 16, 24 and 32 bits, S0 a title, S5 and S6 how many of them there were,
S7, S8 and S9 end the file.
"""

from kennfeld.calfiles.format import Notes, counted
from kennfeld.calfiles.images.image import Image, Record
from kennfeld.calfiles.images.lines import Findings, Line, lines_of, octets, overlaps

__all__ = ["read_s_records"]

_ADDRESSES = {"0": 2, "1": 2, "2": 3, "3": 4, "5": 2, "6": 3, "7": 4, "8": 3, "9": 2}  # bytes of each type


def read_s_records(raw: bytes, name: str, notes: Notes) -> Image:
    """The image in a file of S-records; errors are noted for every line that is wrong."""
    reader = _Reader(Findings(notes))
    for line in lines_of(raw):
        reader.take(line)
    reader.findings.close(reader.records)
    if not reader.ended:
        notes.remark(0, "", "has no end record (S7, S8 or S9)", "See whether the file is cut off.")
    elif reader.behind is not None:
        notes.remark(reader.behind.number, "", "there is something behind the end record; left aside")
    overlaps(reader.records, notes)
    return Image(name, "S-records", raw, reader.records)


class _Reader:
    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        self.records: list[Record] = []
        self.lines = 0  # of bytes
        self.ended = False
        self.behind: Line | None = None

    def take(self, line: Line) -> None:
        """Check a line and keep what it holds."""
        if self.ended:
            self.behind = self.behind or line
            return
        kind = line.text[1:2].decode("latin-1")
        content = octets(line.text[2:]) if line.text[:1] == b"S" else None
        if content is None or kind not in _ADDRESSES or len(content) < _ADDRESSES[kind] + 2:
            self.findings.error(line, "is no S-record", "no record", "The file is damaged.")
        elif len(content) != content[0] + 1:
            what = f"states {content[0]} bytes and holds {len(content) - 1}"
            self.findings.error(line, what, "another length than stated", "The file is damaged.")
        elif sum(content) % 256 != 255:
            right = 255 - sum(content[:-1]) % 256
            what = f"has the checksum {content[-1]:02X}, its bytes give {right:02X}"
            self.findings.error(line, what, "a wrong checksum", "The file is damaged; fetch it once more.")
        else:
            self._record(line, kind, content)

    def _record(self, line: Line, kind: str, content: bytes) -> None:
        size = _ADDRESSES[kind]
        address, data = int.from_bytes(content[1 : 1 + size], "big"), content[1 + size : -1]
        if kind in "123":
            self.lines += 1
            digits = line.at + 4 + 2 * size
            if data:
                self.records.append(Record(address, data, digits, digits + 2 * len(data), line.number))
        elif kind in "56" and address != self.lines % (1 << (8 * size)):
            what = f"counts {counted(address, 'record')}, there were {self.lines}"
            self.findings.error(line, what, "a wrong count", "The file is damaged or cut.")
        elif kind in "789":
            self.ended = True
