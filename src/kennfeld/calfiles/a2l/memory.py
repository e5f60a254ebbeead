"""Bytes to be put into an image, gathered over all labels; no bit gets two values."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.calfiles.a2l.datatypes import Raw, encoded, native
from kennfeld.calfiles.a2l.parts import Part
from kennfeld.calfiles.format import Notes
from kennfeld.calfiles.images.image import Image

__all__ = ["Memory"]


@dataclass
class Memory:
    """What labels put at which address: the bits, which of them count, and who wants them."""

    notes: Notes
    cells: dict[int, tuple[int, int, str]] = field(default_factory=dict)
    clashes: set[tuple[str, str]] = field(default_factory=set)

    def put(self, name: str, address: int, part: Part, raw: Any, where: Bool) -> None:
        """Put raw numbers of a part of an object at an address, those of `where`."""
        kept = part.kept
        stored: Raw = np.asarray(raw)
        if kept.difference:
            stored, where = np.diff(stored, prepend=stored.dtype.type(0)), np.full(stored.shape, bool(where.any()))
        chosen = np.asarray(where)
        content, bits = encoded(stored.astype(native(kept.data_type)), kept.data_type, kept.byte_order, kept.bit_mask)
        places = part.offsets[chosen][..., None] + np.arange(content.shape[-1]) + address
        columns = (places, content[chosen], bits[chosen])
        for at, value, mask in zip(*(column.ravel().tolist() for column in columns), strict=True):
            self._cell(name, at, value, mask)

    def _cell(self, name: str, at: int, value: int, mask: int) -> None:
        before, known, other = self.cells.get(at, (0, 0, name))
        if (before ^ value) & mask & known and other != name and (other, name) not in self.clashes:
            self.clashes.add((other, name))
            what = f"lies in the same memory as {other} at 0x{at:X}, which shall have another value"
            self.notes.error(0, name, what, "Give both the same.")
        self.cells[at] = ((before & ~mask) | (value & mask), known | mask, name)

    def changes(self, image: Image) -> dict[int, bytes]:
        """The bytes of the image to be changed, by address."""
        made = {}
        for run in _runs(sorted(self.cells)):
            held = image.read(run[0], len(run))
            if held is None:
                continue
            cells = (self.cells[at] for at in run)
            new = bytes((old & ~mask & 255) | value for old, (value, mask, _) in zip(held, cells, strict=True))
            if new != held:
                made[run[0]] = new
        return made


def _runs(addresses: list[int]) -> Iterator[list[int]]:
    """Addresses that follow each other."""
    start = 0
    for at in range(1, len(addresses) + 1):
        if at == len(addresses) or addresses[at] != addresses[at - 1] + 1:
            yield addresses[start:at]
            start = at
