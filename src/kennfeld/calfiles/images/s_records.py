"""Motorola S-records: `Stllaa..dd..cc`, each line a record with its type, length, address, bytes and checksum.

S1, S2 and S3 hold bytes at addresses of 16, 24 and 32 bits, S0 a title, S5 and S6 how many of them there were,
S7, S8 and S9 end the file.
"""

from kennfeld.calfiles.format import Notes, counted
from kennfeld.calfiles.images.image import Image, Record
from kennfeld.calfiles.images.lines import Line, RecordReader, octets

__all__ = ["read_s_records"]

_ADDRESSES = {"0": 2, "1": 2, "2": 3, "3": 4, "5": 2, "6": 3, "7": 4, "8": 3, "9": 2}  # bytes of each type


def read_s_records(raw: bytes, name: str, notes: Notes) -> Image:
    """The image in a file of S-records; errors are noted for every line that is wrong."""
    return Image(name, "S-records", raw, _Reader(notes).read(raw))


class _Reader(RecordReader):
    total = 255

    def __init__(self, notes: Notes) -> None:
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
            what = f"counts {counted(address, 'record')}, there were {self.lines}"
            self.findings.error(line, what, "a wrong count", "The file is damaged or cut.")
        elif kind in "789":
            self.ended = True
