"""Extraction of signals from the bytes of bus frames, for all frames of a message at once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float
from kennfeld.measurement.bus_messages import BusSignal

_WORD = 64  # bits
# the largest raw value of J1939 that is a measured value, by length in bits (SAE J1939-71, table 1)
_LARGEST = {8: 0xFA, 10: 0x3FA, 12: 0xFAF, 16: 0xFAFF, 20: 0xFAFFF, 24: 0xFAFFFF, 28: 0xFAFFFFF, 32: 0xFAFFFFFF}


def words_of(payload: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the bytes of frames, uint8[frames, bytes], with zeros up to a whole number of 64-bit words."""
    frames, width = payload.shape
    whole = max(-(-width // 8) * 8, 8)
    if whole == width and payload.flags.c_contiguous:
        return payload
    padded = np.zeros((frames, whole), dtype=np.uint8)
    padded[:, :width] = payload
    return padded


def extract_raw(payload: NDArray[np.uint8], signal: BusSignal) -> NDArray[np.uint64]:
    """Extract the raw bits of a signal, UInt64[frames], with its lowest bit in bit 0.

    Args:
        payload: uint8[frames, bytes], contiguous, a multiple of 8 bytes that contains the signal.
        signal: its layout.
    """
    # in words of the signal's own byte order its bits are consecutive
    words = payload.view(">u8" if signal.big_endian else "<u8")
    index, shift = divmod(signal.first, _WORD)
    end = shift + signal.length
    first = words[:, index].astype(np.uint64)
    # a signal of at most 64 bits lies in two words at most
    if signal.big_endian and end > _WORD:
        raw = (first << np.uint64(end - _WORD)) | (words[:, index + 1].astype(np.uint64) >> np.uint64(2 * _WORD - end))
    elif signal.big_endian:
        raw = first >> np.uint64(_WORD - end)
    elif end > _WORD:
        raw = (first >> np.uint64(shift)) | (words[:, index + 1].astype(np.uint64) << np.uint64(_WORD - shift))
    else:
        raw = first >> np.uint64(shift)
    if signal.length < _WORD:
        raw &= np.uint64((1 << signal.length) - 1)
    return raw


def to_numbers(raw: NDArray[np.uint64], signal: BusSignal) -> NDArray[Any]:
    """Interpret raw bits, UInt64[frames], as the numbers of a signal, [frames]: unsigned, signed or floating-point.

    >>> to_numbers(np.array([3, 15], dtype=np.uint64), BusSignal("T", 0, 4, kind="i"))
    array([ 3, -1])
    """
    if signal.kind == "f":
        return raw.astype(np.uint32).view(np.float32) if signal.length == 32 else raw.view(np.float64)
    if signal.kind == "u":
        return raw
    # shifted up to the sign of the word and back down, which copies the sign
    unused = _WORD - signal.length
    return (raw << np.uint64(unused)).view(np.int64) >> np.int64(unused)


def to_physical(raw: NDArray[np.uint64], signal: BusSignal, is_j1939: bool = False) -> Float:
    """Convert raw bits, UInt64[frames], to Float[frames] in the unit of the signal; NaN if J1939 says there is none."""
    # any bits may be a NaN that signals, and a factor of a damaged database very large
    with np.errstate(invalid="ignore", over="ignore"):
        numbers = to_numbers(raw, signal).astype(np.float64)
        values = numbers * signal.factor + signal.offset if signal.is_scaled else numbers
    if is_j1939:
        values[_is_unavailable(raw, signal)] = np.nan
    values[np.isnan(values)] = np.nan  # a NaN that signals would set off warnings later
    return values


def _is_unavailable(raw: NDArray[np.uint64], signal: BusSignal) -> Bool:
    """Return where a raw value of J1939 is none: all bits set, and for measured values the range below, of errors."""
    # one bit has no value to spare for `not available`
    if signal.kind != "u" or signal.length == 1:
        return np.zeros(raw.shape, dtype=bool)
    most = (1 << signal.length) - 1
    largest = most - 1
    if signal.length in _LARGEST and not signal.texts:
        largest = _LARGEST[signal.length]
    elif signal.length % 8 == 0 and signal.length <= 32:  # a state: its error range is one value of the first byte
        largest = (0xFE << (signal.length - 8)) - 1
    return np.asarray(raw > np.uint64(largest))
