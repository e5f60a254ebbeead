"""Storage of numbers in a control unit: bytes, raw values and physical values, and rounding to storable values."""

from collections.abc import Mapping
from dataclasses import field
from functools import cached_property
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.conversion import CompuConversion
from kennfeld.calfiles.a2l.objects import open_limit
from kennfeld.calfiles.format import FileFindings

Raw = NDArray[Any]  # whole numbers of 64 bits, or floats

_CODES = {"UBYTE": "u1", "SBYTE": "i1", "UWORD": "u2", "SWORD": "i2", "ULONG": "u4", "SLONG": "i4"}
_CODES |= {"A_UINT64": "u8", "A_INT64": "i8", "FLOAT16_IEEE": "f2", "FLOAT32_IEEE": "f4", "FLOAT64_IEEE": "f8"}
NUMBERS = tuple(_CODES)
SIZES = {name: int(code[1]) for name, code in _CODES.items()} | {"BYTE": 1, "WORD": 2, "LONG": 4}  # of RESERVED
_BYTE_ORDERS = ("MSB_LAST", "MSB_FIRST", "MSB_LAST_MSW_FIRST", "MSB_FIRST_MSW_LAST", "LITTLE_ENDIAN", "BIG_ENDIAN")
_ALIGNMENT_KINDS = {"A_UINT64": "INT64", "A_INT64": "INT64"}
_ALIGNMENT_KINDS |= {f"{sign}{kind}": kind for sign in "US" for kind in ("BYTE", "WORD", "LONG")}
# if neither the layout nor the module says anything
_DEFAULT_ALIGNMENTS = {"BYTE": 1, "WORD": 2, "LONG": 4, "INT64": 8}
_DEFAULT_ALIGNMENTS |= {"FLOAT16_IEEE": 2, "FLOAT32_IEEE": 4, "FLOAT64_IEEE": 4}
_MAX_LISTED = 5  # values of one label that are listed
# rounding moves a value by half a step at most; more is due to the conversion
_HALF_STEP = 0.5 * (1 + 1e-6)


def alignment_of(data_type: str, *alignments: Mapping[str, int]) -> int:
    """Return the alignment of a data type in bytes; the first mapping with an entry is used."""
    kind = _ALIGNMENT_KINDS.get(data_type, data_type)
    known = (*alignments, _DEFAULT_ALIGNMENTS)
    return next((borders[kind] for borders in known if kind in borders), 1)


def is_float(data_type: str) -> bool:
    return data_type.startswith("FLOAT")


def native(data_type: str) -> "np.dtype[Any]":
    return np.dtype(_CODES[data_type])


def shift_of(bit_mask: int) -> int:
    """Return the number of zero bits to the right of a mask, 0 for an empty one.

    >>> shift_of(0b1100)
    2
    """
    return max((bit_mask & -bit_mask).bit_length() - 1, 0)


def _effective_mask(data_type: str, bit_mask: int | None) -> int | None:
    """Return the bits of a mask that a number has; None for floating-point numbers and if the mask covers all."""
    every = (1 << 8 * SIZES[data_type]) - 1
    if bit_mask is None or is_float(data_type) or bit_mask & every == every:
        return None
    return bit_mask & every


def decode_raw(memory: bytes, offsets: Int, data_type: str, byte_order: str, bit_mask: int | None = None) -> Raw:
    """Decode the raw numbers at byte offsets of a piece of memory, Int[...]; Raw[...] of the same shape."""
    size = SIZES[data_type]
    # uint8[..., bytes of a number], as in the memory, then with the least significant byte first
    cells = np.frombuffer(memory, dtype=np.uint8)[offsets[..., None] + np.arange(size)]
    cells = np.ascontiguousarray(cells[..., _byte_positions(size, byte_order)])
    mask = _effective_mask(data_type, bit_mask)
    if mask is None:
        results: Raw = cells.view(f"<{_CODES[data_type]}")[..., 0].astype(native(data_type))
        return results
    # bits under a mask are an unsigned number, whatever the type
    unsigned = cells.view(f"<u{size}")[..., 0].astype(np.uint64)
    return np.asarray((unsigned & np.uint64(mask)) >> np.uint64(shift_of(mask)))


def encode_raw(raw: Raw, data_type: str, byte_order: str, bit_mask: int | None = None) -> tuple[Any, Any]:
    """Encode raw numbers, Raw[...], as bytes, and the bits of them that count, both uint8[..., size of a number]."""
    size, mask = SIZES[data_type], _effective_mask(data_type, bit_mask)
    order = _byte_positions(size, byte_order)
    bits = np.full((*raw.shape, size), 255, dtype=np.uint8)
    if mask is None:
        cells = np.ascontiguousarray(raw.astype(f"<{_CODES[data_type]}"))[..., None].view(np.uint8)
    else:
        shifted = (raw.astype(np.uint64) << np.uint64(shift_of(mask))) & np.uint64(mask)
        bits[...] = np.frombuffer(mask.to_bytes(size, "little"), dtype=np.uint8)
        cells = shifted.astype(f"<u{size}")[..., None].view(np.uint8)
    placed, counting = np.empty_like(cells), np.empty_like(bits)
    # the inverse of the order in which they are read
    placed[..., order], counting[..., order] = cells, bits
    return placed, counting


def _byte_positions(size: int, byte_order: str) -> list[int]:
    """Return the memory position of each byte, least significant first."""
    places = list(range(size))
    if byte_order in ("MSB_FIRST", "BIG_ENDIAN"):
        return places[::-1]
    # words of two bytes, each with its least significant byte first, from the most significant word on
    if byte_order == "MSB_LAST_MSW_FIRST" and size > 1:
        return [i for at in range(size - 2, -1, -2) for i in (at, at + 1)]
    if byte_order == "MSB_FIRST_MSW_LAST" and size > 1:
        return [i for at in range(0, size, 2) for i in (at + 1, at)]
    return places[::-1] if byte_order == "MSB_FIRST_MSW_LAST" else places


@dataclass(frozen=True)
class StorageFormat:
    """The data type, byte order, conversion and hard limits of a stored number."""

    data_type: str
    byte_order: str
    conversion: CompuConversion
    bit_mask: int | None = None
    difference: bool = False  # each point as the distance from the one before
    lower: float = -inf
    upper: float = inf

    def physical(self, raw: Raw) -> Float:
        """Convert raw to physical values, Float[...] of the same shape; NaN if a raw value has none."""
        values = np.asarray(self.conversion.physical(np.asarray(raw, dtype=np.float64)), dtype=np.float64)
        return np.where(np.isfinite(values), values, np.nan)

    @property
    def integer(self) -> bool:
        return not is_float(self.data_type)

    @cached_property
    def span(self) -> tuple[float, float]:
        """The least and the largest raw number."""
        mask = _effective_mask(self.data_type, self.bit_mask)
        if mask is not None:
            return 0.0, float(mask >> shift_of(mask))
        info = (np.iinfo if self.integer else np.finfo)(native(self.data_type))
        return float(info.min), float(info.max)

    @cached_property
    def range(self) -> tuple[float, float]:
        """The least and the largest physical number, NaN if a conversion does not say."""
        ends = self.physical(np.array(self.span))
        return float(ends.min()), float(ends.max())

    def step(self, raw: Float) -> Float:
        """Compute the physical distance from raw numbers, Float[...], to the next storable ones; 0 for floats."""
        if not self.integer:
            return np.zeros(np.shape(raw))
        low, high = self.span
        # the largest raw number has its only neighbour below
        neighbour = np.where(raw < high, raw + 1, np.maximum(raw - 1, low))
        return np.nan_to_num(np.abs(np.asarray(self.physical(neighbour) - self.physical(raw))))

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        """Return limits as parameter bounds; infinite if they equal the data type's range or are empty."""
        least, largest = self.range
        if not lower < upper:
            return -inf, inf
        # limits that a tool wrote may be off by a step, or by the digits they lack
        slack = self.step(np.array(self.span)).max() + 1e-6 * (largest - least)
        full = lower <= least + slack and upper >= largest - slack
        return (-inf, inf) if full else (open_limit(lower), open_limit(upper))


@dataclass(frozen=True)
class ObjectPart:
    """The numbers of one part, in the shape of the table, in the order of the memory."""

    storage: StorageFormat
    offsets: Int
    stored: Raw  # as they lie in the memory

    @cached_property
    def raw(self) -> Raw:
        """Raw numbers, points kept as distances added up."""
        return np.cumsum(self.stored) if self.storage.difference else self.stored

    @cached_property
    def physical(self) -> Float:
        return self.storage.physical(self.raw)

    def unlike(self, values: Float) -> Bool:
        """Return a mask, Bool[...], of the physical values that differ from the memory; two NaN are equal."""
        alike: Bool = (values == self.physical) | (np.isnan(values) & np.isnan(self.physical))
        return ~alike


def first_byte_order(*orders: str) -> str:
    """Return the first byte order that is known; MSB_LAST by default, as in the standard."""
    return next((order for order in orders if order in _BYTE_ORDERS), "MSB_LAST")


@dataclass(frozen=True)
class Rounded:
    """Raw values of a part, and the deviation of their physical values from those requested."""

    raw: Raw
    off: Float  # in physical units; 0 where nothing changes
    steps: Float  # the same in steps of the storage; 0 for floating-point numbers
    requested: Float
    unit: str


def nearest_raw(
    name: str, part: ObjectPart, values: Float, unlike: Bool, item: str, findings: FileFindings
) -> Rounded | None:
    """Round physical values, Float[...], to the raw numbers to store; those that are not `unlike` stay as they are.

    None, and an error for each of the first values that cannot be stored.
    """
    storage = part.storage
    if storage.conversion.raw is None:
        findings.error(0, name, f"cannot be changed: the conversion {storage.conversion.name} has no inverse")
        return None
    with np.errstate(all="ignore"):
        # 0 stands in for NaN, of which a table would make a number
        exact = np.asarray(storage.conversion.raw(np.where(np.isnan(values), 0.0, values)), dtype=np.float64)
    exact = np.where(np.isnan(values), np.nan, exact)
    rounded = np.rint(exact) if storage.integer else exact
    wrong = _find_unstorable(part, values, rounded, unlike & (rounded != part.raw))
    if wrong.any():
        _report_unstorable(name, storage, values, wrong, item, findings)
        return None
    raw = part.raw.copy()
    # numbers that are stored as distances may exceed the type of these
    raw[unlike] = rounded[unlike].astype(native(storage.data_type) if not storage.difference else raw.dtype)
    off = np.where(unlike, np.abs(storage.physical(raw) - values), 0.0)
    step = storage.step(raw.astype(np.float64))
    alone = np.where((off > 0) & storage.integer, np.inf, 0.0)  # a number without neighbours
    steps = np.divide(off, step, out=alone, where=step > 0)
    return Rounded(raw, off, steps, values, storage.conversion.unit)


def _find_unstorable(part: ObjectPart, values: Float, raw: Float, unlike: Bool) -> Bool:
    """Return a mask of the changed values that are not storable or not allowed."""
    storage = part.storage
    least, largest = storage.span
    with np.errstate(all="ignore"):
        outside = ~((raw >= least) & (raw <= largest))
        if storage.difference:
            # the first number is stored as it is, the others as distances from the one before
            distances = np.diff(raw, prepend=0.0)
            outside |= ~((distances >= least) & (distances <= largest))
        # a limit between two storable numbers allows the nearer one
        slack = 0.5 * storage.step(np.clip(np.nan_to_num(raw), least, largest)) + 1e-9 * np.abs(values)
        beyond = ~((values >= storage.lower - slack) & (values <= storage.upper + slack))
    return unlike & (outside | beyond)


def _report_unstorable(
    name: str, storage: StorageFormat, values: Float, wrong: Bool, item: str, findings: FileFindings
) -> None:
    low, high = float(np.fmax(storage.range[0], storage.lower)), float(np.fmin(storage.range[1], storage.upper))
    places = [tuple(int(i) for i in at) for at in np.argwhere(wrong)]
    for at in places[:_MAX_LISTED]:
        place = f" {[i + 1 for i in at]}" if at else ""
        message = f"the {item}{place} is {values[at]:g} {storage.conversion.unit}".rstrip()
        findings.error(0, name, f"{message}, outside the storable and allowed range {low:g} to {high:g}")
    if len(places) > _MAX_LISTED:
        more = count_noun(len(places) - _MAX_LISTED, f"further {item}")
        findings.error(0, name, f"{more} outside {low:g} to {high:g}")


@dataclass
class Roundings:
    """Rounding errors of all written labels."""

    labels: dict[str, tuple[float, float, str, int]] = field(default_factory=dict)  # share, off, unit, values
    far: dict[str, tuple[float, float, str]] = field(default_factory=dict)

    def keep(self, name: str, rounded: Rounded) -> None:
        size = float(np.nanmax(np.abs(rounded.requested), initial=0.0)) or 1.0
        count = int((rounded.off > 1e-12 * size).sum())
        if not count:
            return
        off = float(np.nanmax(rounded.off))
        before = self.labels.get(name, (0.0, 0.0, "", 0))
        self.labels[name] = max(before, (off / size, off, rounded.unit, count + before[3]))
        if float(np.nanmax(rounded.steps)) > _HALF_STEP:
            at = np.unravel_index(int(np.nanargmax(rounded.steps)), rounded.off.shape)
            self.far[name] = (float(rounded.requested[at]), float(rounded.off[at]), rounded.unit)

    def report(self, findings: FileFindings) -> None:
        """Report the largest rounding error, and each label off by more than half a storage step."""
        if self.labels:
            count = count_noun(sum(values for *_, values in self.labels.values()), "number")
            name, (share, off, unit, _) = max(self.labels.items(), key=lambda item: item[1])
            message = f"{count} of {count_noun(len(self.labels), 'label')} rounded to storable values"
            message = f"{message}, by at most {off:.3g} {unit}".rstrip()
            findings.warning(0, "", f"{message} ({name}, {share:.2g} of its largest value)")
        for name, (requested, off, unit) in self.far.items():
            value = f"{requested:g} {unit}".rstrip()
            findings.warning(0, name, f"the nearest storable value to {value} is {off:.3g} away")
