"""The numbers of one part of an object: how they lie in the memory, raw, and physical."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.calfiles.a2l.conversion import Conversion
from kennfeld.calfiles.a2l.datatypes import BYTE_ORDERS, Raw, decoded, is_float, native, span_of

__all__ = ["Kept", "Part", "order_of"]


@dataclass(frozen=True)
class Kept:
    """How a number is kept: everything between its bytes and its physical value, and its hard limits."""

    data_type: str
    byte_order: str
    conversion: Conversion
    bit_mask: int | None = None
    difference: bool = False  # each point as the distance from the one before
    lower: float = -inf
    upper: float = inf

    def physical(self, raw: Raw) -> Float:
        """Physical numbers of raw ones; NaN where a number has none."""
        values = np.asarray(self.conversion.physical(np.asarray(raw, dtype=np.float64)), dtype=np.float64)
        return np.where(np.isfinite(values), values, np.nan)

    @property
    def integer(self) -> bool:
        """Whether raw numbers are whole."""
        return not is_float(self.data_type)

    @cached_property
    def span(self) -> tuple[float, float]:
        """The least and the largest raw number."""
        if self.integer:
            low, high = span_of(self.data_type, self.bit_mask)
            return float(low), float(high)
        largest = float(np.finfo(native(self.data_type)).max)
        return -largest, largest

    @cached_property
    def range(self) -> tuple[float, float]:
        """The least and the largest physical number, NaN where a conversion does not say."""
        ends = self.physical(np.array(self.span))
        return float(ends.min()), float(ends.max())

    def step(self, raw: Float) -> Float:
        """The distance of the next storable number, 0 for floating-point ones."""
        if not self.integer:
            return np.zeros(np.shape(raw))
        low, high = self.span
        beside = np.where(raw < high, raw + 1, np.maximum(raw - 1, low))
        return np.nan_to_num(np.abs(np.asarray(self.physical(beside) - self.physical(raw))))

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        """Limits as bounds of a parameter: none where they are the range of the data type or say nothing."""
        least, largest = self.range
        if not lower < upper:
            return -inf, inf
        slack = self.step(np.array(self.span)).max() + 1e-6 * (largest - least)
        full = lower <= least + slack and upper >= largest - slack
        return (-inf, inf) if full else (_bound(lower), _bound(upper))


def _bound(limit: float) -> float:
    return limit if abs(limit) < 1e300 else np.copysign(inf, limit)


@dataclass(frozen=True)
class Part:
    """The numbers of one part, in the shape of the table, in the order of the memory."""

    kept: Kept
    offsets: Int
    stored: Raw  # as they lie in the memory

    @classmethod
    def of(cls, memory: bytes, offsets: Int, kept: Kept) -> "Part":
        """The part at byte offsets of a piece of memory."""
        return cls(kept, offsets, decoded(memory, offsets, kept.data_type, kept.byte_order, kept.bit_mask))

    @cached_property
    def raw(self) -> Raw:
        """Raw numbers, points kept as distances added up."""
        return np.cumsum(self.stored) if self.kept.difference else self.stored

    @cached_property
    def physical(self) -> Float:
        """Physical numbers."""
        return self.kept.physical(self.raw)

    def unlike(self, values: Float) -> Bool:
        """Which numbers differ from those in the memory; two that are missing are alike."""
        alike: Bool = (values == self.physical) | (np.isnan(values) & np.isnan(self.physical))
        return ~alike


def order_of(*given: str, known: Mapping[str, str] = BYTE_ORDERS) -> str:
    """The first byte order that is given and known; the standard has MSB_LAST where nothing says otherwise."""
    return next((order for order in given if order in known), "MSB_LAST")
