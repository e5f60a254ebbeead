"""Conversions of MDF channels from raw to physical values, by ASAM MDF 4.2 (CC block) and 3.3 (CCBLOCK).

All are computed in double precision, whatever the type of the raw values. A table of texts that has a scale for other
raw values (65535 = "SNA", else linear) describes a number: its texts stand for missing values. A table of texts alone
is an enumeration, whose raw values are its numbers.
"""

from collections.abc import Callable, Iterator, Sequence
from enum import Enum, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.conversion_formulas import parse_formula

_NO_UNITS = ("", "-", "1")
_LEAST_TEXTS = (0.0, 1.0)  # raw values of which one has a text in an enumeration


class ConversionKind(Enum):
    """The formulas and tables of the standards; the comments state their parameters."""

    IDENTITY = auto()
    LINEAR = auto()  # offset, factor
    RATIONAL = auto()  # (P1 x^2 + P2 x + P3) / (P4 x^2 + P5 x + P6)
    FORMULA = auto()  # one reference: the text
    INTERPOLATED = auto()  # raw, physical, raw, physical, ...
    NEAREST = auto()  # the same
    RANGES = auto()  # lower, upper, physical, ..., default
    TEXTS = auto()  # raw, ...; a reference for each, and that of the default
    TEXT_RANGES = auto()  # lower, upper, ...; likewise
    TEXT_VALUES = auto()  # physical, ..., default; a text for each value but the default
    TRANSLATION = auto()  # of texts to texts
    BITS = auto()  # of parts of a number to texts
    POLYNOMIAL = auto()  # P1 ... P6, version 3
    EXPONENTIAL = auto()  # P1 ... P7, version 3
    LOGARITHMIC = auto()  # the same


# by the numbers of version 4
KINDS_4 = {
    0: ConversionKind.IDENTITY,
    1: ConversionKind.LINEAR,
    2: ConversionKind.RATIONAL,
    3: ConversionKind.FORMULA,
    4: ConversionKind.INTERPOLATED,
    5: ConversionKind.NEAREST,
    6: ConversionKind.RANGES,
    7: ConversionKind.TEXTS,
    8: ConversionKind.TEXT_RANGES,
    9: ConversionKind.TEXT_VALUES,
    10: ConversionKind.TRANSLATION,
    11: ConversionKind.BITS,
}
_TABLES = (ConversionKind.TEXTS, ConversionKind.TEXT_RANGES)


class UnsupportedConversionError(Exception):
    """A conversion cannot be computed; the text says which."""


@dataclass(frozen=True)
class MdfConversion:
    """A conversion of one channel, with its parameters as `ConversionKind` lists them."""

    kind: ConversionKind
    values: tuple[float, ...] = ()
    references: "tuple[str | MdfConversion | None, ...]" = ()
    unit: str = ""

    @property
    def is_identity(self) -> bool:
        """True if raw and physical values are equal."""
        kind, values = self.kind, self.values
        if kind is ConversionKind.LINEAR:
            return values == (0.0, 1.0)
        if kind is ConversionKind.RATIONAL:
            return _simplified(values) == (0.0, 1.0)
        if kind is ConversionKind.POLYNOMIAL:
            # P2 = P3 = P5 = P6 = 0 leave P4 x / P1
            return values[1:3] == values[4:6] == (0.0, 0.0) and values[0] == values[3]
        return kind is ConversionKind.IDENTITY

    @property
    def has_texts(self) -> bool:
        """True if raw values may stand for texts."""
        return self.kind in _TABLES

    def is_enumeration(self, unit: str) -> bool:
        """Return whether the raw values of a channel in this unit are numbers of texts.

        Tools add an identical scale to the texts of a state, for values without a text. It makes a number of the
        channel only if that has a unit, or if its least values have no texts.
        """
        if self.kind is ConversionKind.BITS:
            return True
        if self.kind not in _TABLES:
            return False
        scales = list(self._scales())
        if not all(scale.is_identity for scale in scales):
            return False
        starts = self.values[:: 2 if self.kind is ConversionKind.TEXT_RANGES else 1]
        texts = (low for low, text in zip(starts, self.references, strict=False) if isinstance(text, str))
        return not scales or (unit in _NO_UNITS and any(low in _LEAST_TEXTS for low in texts))

    def _scales(self) -> "Iterator[MdfConversion]":
        """Yield the conversions to numbers in a table of texts."""
        for reference in self.references:
            if isinstance(reference, MdfConversion):
                if reference.kind in _TABLES:
                    yield from reference._scales()
                else:
                    yield reference

    def texts(self) -> Iterator[tuple[float, float, str]]:
        """Yield the texts of a table with the least and the largest raw value of each."""
        if self.kind not in _TABLES:
            return
        step = 2 if self.kind is ConversionKind.TEXT_RANGES else 1
        lows, highs = self.values[::step], self.values[step - 1 :: step]
        for low, high, text in zip(lows, highs, self.references, strict=False):
            if isinstance(text, str):
                yield low, high, text

    def convert(self, raw: NDArray[Any]) -> Float:
        """Convert raw values, any[samples], to physical ones: Float[samples], NaN for a text.

        Raises:
            UnsupportedConversionError: it is not known how to compute them.
        """
        with np.errstate(all="ignore"):
            if self.kind is ConversionKind.TEXT_VALUES:
                return self._values_of_texts(raw)
            if raw.dtype.kind not in "buif":
                raise UnsupportedConversionError("a text that is translated")
            numbers = raw.astype(np.float64)
            if self.kind in _TABLES:
                return self._convert_table(raw, numbers)
            if self.kind is ConversionKind.RANGES:
                return self._values_of_ranges(raw, numbers)
            compute = _FORMULAS.get(self.kind)
            if compute is not None:
                return compute(self.values, numbers)
        if self.kind is ConversionKind.FORMULA:
            return self._evaluate(numbers)
        return numbers

    def _evaluate(self, raw: Float) -> Float:
        text = next((str(reference) for reference in self.references), "")
        formula = parse_formula(text.strip())
        if formula is None:
            raise UnsupportedConversionError(f"values of the formula {text[:60]!r}, which is not supported")
        return formula(raw)

    def _values_of_texts(self, raw: NDArray[Any]) -> Float:
        if raw.dtype.kind not in "SU":
            raise UnsupportedConversionError("a number that is translated as a text")
        keys = {text: value for text, value in zip(self.references, self.values, strict=False) if isinstance(text, str)}
        default = self.values[-1] if len(self.values) > len(self.references) else np.nan
        unique, index = np.unique(raw, return_inverse=True)
        texts = (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in unique.tolist())
        values = [keys.get(text.split("\0", 1)[0], default) for text in texts]
        return np.array(values, dtype=np.float64)[index]

    def _values_of_ranges(self, raw: NDArray[Any], numbers: Float) -> Float:
        lower, upper, physical = (np.array(self.values[k:-1:3]) for k in range(3))
        table = np.append(physical, self.values[-1])
        return np.asarray(table[_find_range(raw, numbers, lower, upper)], np.float64)

    def _convert_table(self, raw: NDArray[Any], numbers: Float) -> Float:
        entry = self.entries(raw)
        values = np.full(numbers.shape, np.nan)
        # one conversion for all samples of a reference
        for place in np.unique(entry).tolist():
            reference = self.references[place] if place < len(self.references) else None
            if isinstance(reference, MdfConversion):
                rows = entry == place
                values[rows] = reference.convert(raw[rows])
        return values

    def entries(self, raw: NDArray[Any]) -> Int:
        """Return the reference of each raw value in a table of texts, Int[samples]."""
        numbers = raw.astype(np.float64)
        if self.kind is ConversionKind.TEXT_RANGES:
            return _find_range(raw, numbers, np.array(self.values[::2]), np.array(self.values[1::2]))
        keys = np.array(self.values)
        # stable, so that of equal keys the first one counts
        order = np.argsort(keys, kind="stable")
        at = np.searchsorted(keys[order], numbers)
        # NaN sorts behind all keys
        known = at < keys.size
        entry = np.full(numbers.shape, keys.size, dtype=np.int64)
        known[known] = keys[order][at[known]] == numbers[known]
        entry[known] = order[at[known]]
        return entry

    def text_counts(self, raw: NDArray[Any]) -> dict[str, int]:
        """Count the samples with each text of a table of texts; `raw` are raw values, any[samples]."""
        counts: dict[str, int] = {}
        places, sizes = np.unique(self.entries(raw), return_counts=True)
        for place, size in zip(places.tolist(), sizes.tolist(), strict=True):
            reference = self.references[place] if place < len(self.references) else None
            if reference is None or isinstance(reference, str):
                counts[reference or ""] = counts.get(reference or "", 0) + size
            elif reference.kind in _TABLES:
                for text, count in reference.text_counts(raw[self.entries(raw) == place]).items():
                    counts[text] = counts.get(text, 0) + count
        return counts


def _find_range(raw: NDArray[Any], numbers: Float, lower: Float, upper: Float) -> Int:
    """Return the first range that contains each value; their number if none does.

    The upper limit of a range belongs to it if raw values are whole numbers, and does not if they are floating-point.
    """
    is_whole = raw.dtype.kind in "bui"
    order = np.argsort(lower, kind="stable")
    low, high = lower[order], upper[order]
    # disjoint ranges: only the last one that begins at or below a value can hold it
    if bool(np.all(high[:-1] < low[1:])) or (not is_whole and bool(np.all(high[:-1] <= low[1:]))):
        at = np.searchsorted(low, numbers, side="right") - 1
        inside = (at >= 0) & _within(numbers, low[at], high[at], is_whole) if low.size else np.zeros(raw.shape, bool)
        return np.where(inside, order[at] if low.size else 0, low.size)
    entry = np.full(numbers.shape, lower.size, dtype=np.int64)
    # backwards, so that of ranges that overlap the first one remains
    for place in range(lower.size - 1, -1, -1):
        entry[_within(numbers, lower[place], upper[place], is_whole)] = place
    return entry


def _within(numbers: Float, low: Any, high: Any, is_whole: bool) -> Bool:
    below = numbers <= high if is_whole else (numbers < high) | ((numbers == high) & (low == high))
    return np.asarray((numbers >= low) & below)


def _simplified(values: Sequence[float]) -> tuple[float, float] | None:
    """Return offset and factor of a rational function that is linear."""
    p1, p2, p3, p4, p5, p6 = values[:6]
    # (P2 x + P3) / P6
    if not p1 and not p4 and not p5 and p6:
        return p3 / p6, p2 / p6
    # P1 x^2 / (P5 x), which is 0 at 0
    if not p2 and not p3 and not p4 and not p6 and p5:
        return 0.0, p1 / p5
    return None


def _linear(values: Sequence[float], raw: Float) -> Float:
    """Return scaled values in place of the raw ones."""
    offset, factor = values[:2]
    raw *= factor
    if offset:
        raw += offset
    return raw


def _rational(values: Sequence[float], raw: Float) -> Float:
    simplified = _simplified(values)
    if simplified is not None:
        return _linear(simplified, raw)
    p1, p2, p3, p4, p5, p6 = values[:6]
    return (p1 * raw**2 + p2 * raw + p3) / (p4 * raw**2 + p5 * raw + p6)


def _interpolate(values: Sequence[float], raw: Float) -> Float:
    return np.interp(raw, values[::2], values[1::2])


def _nearest(values: Sequence[float], raw: Float) -> Float:
    """Return the value of the nearest key; of two equally near ones, that of the lower one."""
    keys, physical = np.array(values[::2]), np.array(values[1::2])
    above = np.minimum(np.searchsorted(keys, raw), keys.size - 1)
    below = np.maximum(above - 1, 0)
    nearest = physical[np.where(raw - keys[below] <= keys[above] - raw, below, above)]
    return np.where(np.isnan(raw), np.nan, nearest)


def _polynomial(values: Sequence[float], raw: Float) -> Float:
    p1, p2, p3, p4, p5, p6 = values[:6]
    shifted = raw - p5 - p6
    return (p2 - p4 * shifted) / (p3 * shifted - p1)


def _transcendental(function: np.ufunc, values: Sequence[float], raw: Float) -> Float:
    p1, p2, p3, p4, p5, p6, p7 = values[:7]
    if p4 == 0:
        return np.asarray(function(((raw - p7) * p6 - p3) / p1) / p2)
    if p1 == 0:
        return np.asarray(function((p3 / (raw - p7) - p6) / p4) / p5)
    raise UnsupportedConversionError("values of a damaged conversion")


_FORMULAS: dict[ConversionKind, Callable[[Sequence[float], Float], Float]] = {
    ConversionKind.LINEAR: _linear,
    ConversionKind.RATIONAL: _rational,
    ConversionKind.INTERPOLATED: _interpolate,
    ConversionKind.NEAREST: _nearest,
    ConversionKind.POLYNOMIAL: _polynomial,
    ConversionKind.EXPONENTIAL: lambda values, raw: _transcendental(np.exp, values, raw),
    ConversionKind.LOGARITHMIC: lambda values, raw: _transcendental(np.log, values, raw),
}
