"""Raw numbers: the data types of A2L, and in what order their bytes lie in the memory."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Int

__all__ = ["BYTE_ORDERS", "NUMBERS", "SIZES", "alignment_of", "decoded", "encoded", "is_float", "native", "span_of"]

Raw = NDArray[Any]  # whole numbers of 64 bits, or floats

_CODES = {
    "UBYTE": "u1",
    "SBYTE": "i1",
    "UWORD": "u2",
    "SWORD": "i2",
    "ULONG": "u4",
    "SLONG": "i4",
    "A_UINT64": "u8",
    "A_INT64": "i8",
    "FLOAT16_IEEE": "f2",
    "FLOAT32_IEEE": "f4",
    "FLOAT64_IEEE": "f8",
}
NUMBERS = tuple(_CODES)
_SPACES = {"BYTE": 1, "WORD": 2, "LONG": 4}  # sizes of RESERVED
SIZES = {name: int(code[1]) for name, code in _CODES.items()} | _SPACES
BYTE_ORDERS = {
    "MSB_LAST": "<",
    "MSB_FIRST": ">",
    "MSB_LAST_MSW_FIRST": "<",
    "MSB_FIRST_MSW_LAST": ">",
    "LITTLE_ENDIAN": "<",
    "BIG_ENDIAN": ">",
}
_ALIGNED_AS = {"UBYTE": "BYTE", "SBYTE": "BYTE", "UWORD": "WORD", "SWORD": "WORD", "ULONG": "LONG", "SLONG": "LONG"}
_ALIGNED_AS |= {"A_UINT64": "INT64", "A_INT64": "INT64"}
# where neither the layout nor the module says anything
_BORDERS = {"BYTE": 1, "WORD": 2, "LONG": 4, "INT64": 8, "FLOAT16_IEEE": 2, "FLOAT32_IEEE": 4, "FLOAT64_IEEE": 4}


def alignment_of(data_type: str, *given: Mapping[str, int]) -> int:
    """At multiples of how many bytes a data type begins; the first of `given` that says so counts."""
    kind = _ALIGNED_AS.get(data_type, data_type)
    return int(next((borders[kind] for borders in given if kind in borders), _BORDERS.get(kind, 1)))


def is_float(data_type: str) -> bool:
    """Whether a data type holds floating-point numbers."""
    return data_type.startswith("FLOAT")


def native(data_type: str) -> "np.dtype[Any]":
    """The type of array that holds it in this process."""
    return np.dtype(_CODES[data_type])


def span_of(data_type: str, bit_mask: int | None) -> tuple[int, int]:
    """The least and the largest whole number that a data type can hold within a bit mask."""
    info = np.iinfo(native(data_type))
    if bit_mask is None or _covers(data_type, bit_mask):
        return int(info.min), int(info.max)
    return 0, (bit_mask & (2**info.bits - 1)) >> shift_of(bit_mask)


def shift_of(bit_mask: int) -> int:
    """How many bits are to the right of a mask.

    >>> shift_of(0b1100)
    2
    """
    return (bit_mask & -bit_mask).bit_length() - 1


def _covers(data_type: str, bit_mask: int) -> bool:
    every = (1 << 8 * SIZES[data_type]) - 1
    return bit_mask & every == every


def decoded(memory: bytes, offsets: Int, data_type: str, byte_order: str, bit_mask: int | None = None) -> Raw:
    """The raw numbers at byte offsets of a piece of memory, in the shape of `offsets`."""
    size = SIZES[data_type]
    cells = np.frombuffer(memory, dtype=np.uint8)[offsets[..., None] + np.arange(size)]
    cells = np.ascontiguousarray(cells[..., _significance(size, byte_order)])
    found: Raw = cells.view(f"<{_CODES[data_type]}")[..., 0]
    if bit_mask is not None and not is_float(data_type) and not _covers(data_type, bit_mask):
        unsigned = cells.view(f"<u{size}")[..., 0].astype(np.uint64)
        return np.asarray((unsigned & np.uint64(bit_mask & (2**64 - 1))) >> np.uint64(shift_of(bit_mask)))
    return found.astype(native(data_type))


def encoded(raw: Raw, data_type: str, byte_order: str, bit_mask: int | None = None) -> tuple[Any, Any]:
    """The bytes of raw numbers, and which bits of them count, both of shape `raw.shape + (size,)`."""
    size = SIZES[data_type]
    order = _significance(size, byte_order)
    bits = np.full((*raw.shape, size), 255, dtype=np.uint8)
    if bit_mask is not None and not is_float(data_type) and not _covers(data_type, bit_mask):
        mask = bit_mask & (2 ** (8 * size) - 1)
        shifted = (raw.astype(np.uint64) << np.uint64(shift_of(bit_mask))) & np.uint64(mask)
        bits[...] = np.frombuffer(mask.to_bytes(size, "little"), dtype=np.uint8)
        cells = shifted.astype(f"<u{size}")[..., None].view(np.uint8)
    else:
        cells = np.ascontiguousarray(raw.astype(f"<{_CODES[data_type]}"))[..., None].view(np.uint8)
    placed, counting = np.empty_like(cells), np.empty_like(bits)
    placed[..., order], counting[..., order] = cells, bits
    return placed, counting


def _significance(size: int, byte_order: str) -> list[int]:
    """At which place of the memory the byte of each significance is, least first."""
    places = list(range(size))
    if byte_order in ("MSB_FIRST", "BIG_ENDIAN"):
        return places[::-1]
    if byte_order == "MSB_LAST_MSW_FIRST" and size > 1:
        return [i for at in range(size - 2, -1, -2) for i in (at, at + 1)]
    if byte_order == "MSB_FIRST_MSW_LAST" and size > 1:
        return [i for at in range(0, size, 2) for i in (at + 1, at)]
    return places[::-1] if byte_order == "MSB_FIRST_MSW_LAST" else places
