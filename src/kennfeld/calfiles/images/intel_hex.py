"""Intel HEX: `:llaaaattdd..cc`, each line a record with its length, address, type, bytes and checksum.

Types: 00 data, 01 end, 02 segment (address x 16), 03 and 05 start of the program, 04 upper half of the address
(Intel: Hexadecimal Object File Format Specification, revision A, 1988). What tools write around it, such as a closing
0x1A, empty lines and any ends of lines, is accepted and kept.
"""

from collections.abc import Iterator

from kennfeld.calfiles.format import Notes
from kennfeld.calfiles.images.image import Image, Record
from kennfeld.calfiles.images.lines import Line, RecordReader, octets

__all__ = ["read_intel_hex"]

_HALF = 1 << 16
_SIZES = {1: 0, 2: 2, 3: 4, 4: 2, 5: 4}  # bytes of each type but data


def read_intel_hex(raw: bytes, name: str, notes: Notes) -> Image:
    """The image in an Intel HEX file; errors are noted for every line that is wrong, and for a missing end."""
    return Image(name, "Intel HEX", raw, _Reader(notes).read(raw))


class _Reader(RecordReader):
    besides = 5  # length, address, type and checksum

    def __init__(self, notes: Notes) -> None:
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
            what = f"is a record of type {kind:02X} with {len(data)} bytes, which Intel HEX does not have"
            self.findings.error(line, what, "an unknown type")
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
