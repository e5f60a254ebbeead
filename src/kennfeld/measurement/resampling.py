"""Resampling of recordings to an even time raster."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.domain.dataset import PAUSE, SAMPLES_PER_BLOCK, longest_usual_step

_SAME_INSTANT = 1e-9  # s; a grid point this close to a time stamp is that sample
_MAX_LEVELS = 16  # of a gear, a mode or a switch
_PER_LEVEL = 4  # samples
_KEPT = 0.75  # share of the samples at which a stepped channel does not change
_JUMP = 0.05  # of its range, by which it changes otherwise
_FEWEST_JUMPS = 3


def samples_on(time: Float, raster: float) -> float:
    """Count the points of a raster in s over the range of `time`, Float[samples] in s; a float, as it may be huge."""
    with np.errstate(over="ignore"):
        # the quotient of 0.3 and 0.1 is below 3 by rounding, and the last point must not be lost
        return float(np.floor((time[-1] - time[0]) / raster + 1e-6)) + 1.0


def even_grid(time: Float, raster: float) -> Float:
    """Compute the even raster, Float[points] in s, from the first of the time stamps, Float[samples], to the last.

    >>> even_grid(np.array([0.0, 0.3]), 0.1)
    array([0. , 0.1, 0.2, 0.3])
    """
    even: Float = time[0] + np.arange(int(samples_on(time, raster))) * raster
    return even


def is_stepped(values: Float) -> bool:
    """Return whether a channel, Float[samples], jumps between levels and stays there: it must not be interpolated.

    It is a switch, has few whole levels, or keeps its value for most of the time and then changes by more than a
    quantum: a slow signal of a coarse sensor keeps its value as well, but changes by small steps.

    >>> is_stepped(np.array([0.0, 1.0, 1.0])), is_stepped(np.array([0.0, 0.5])), is_stepped(np.arange(100.0))
    (True, False, False)
    >>> is_stepped(np.repeat(np.sin(np.arange(30.0)), 10)), is_stepped(np.round(np.sin(np.linspace(0, 9, 900)), 2))
    (True, False)
    """
    levels, count = _few_whole_levels(values)
    if levels is not None and count > 0 and (np.isin(levels, (0, 1)).all() or count >= _PER_LEVEL * levels.size):
        return True
    return _keeps_levels(values)


def _few_whole_levels(values: Float) -> tuple[Float | None, int]:
    """Return the levels of a channel, None if they are many or not whole, and the number of its valid samples."""
    levels, count = np.empty(0), 0
    for first in range(0, values.size, SAMPLES_PER_BLOCK):
        block = values[first : first + SAMPLES_PER_BLOCK]
        valid = block[~np.isnan(block)]
        levels, count = np.union1d(levels, valid), count + valid.size
        if levels.size > _MAX_LEVELS or np.any(levels != np.round(levels)):
            return None, count
    return levels, count


def _keeps_levels(values: Float) -> bool:
    """Return whether a channel keeps its value at most samples, and half of its changes are large."""
    changes, kept, before, low, high = [], 0, np.empty(0), np.inf, -np.inf
    for first in range(0, values.size, SAMPLES_PER_BLOCK):
        block = values[first : first + SAMPLES_PER_BLOCK]
        # with the last value of the block before, so that no change is missed between blocks
        known = np.concatenate([before, block[np.isfinite(block)]])
        if not known.size:
            continue
        change = np.abs(np.diff(known))
        changed = change[change > 0]
        kept += change.size - changed.size
        changes.append(changed)
        if sum(part.size for part in changes) > (1 - _KEPT) * values.size:
            return False
        before, low, high = known[-1:], min(low, known.min()), max(high, known.max())
    jumps = np.concatenate(changes) if changes else np.empty(0)
    often = jumps.size >= _FEWEST_JUMPS and kept >= _KEPT * (kept + jumps.size)
    return often and bool(np.median(jumps) >= _JUMP * (high - low))


def resample_all(time: Float, columns: Sequence[Float], at: Float, held: Sequence[bool]) -> list[Float]:
    """Resample channels, Float[samples] each, from common stamps to other times, Float[points], both in s.

    Each becomes Float[points], as by `resample`.
    """
    exact = _snap(time, at)  # once for all channels without gaps
    return [
        _interpolate(time, values, exact, hold) if not np.isnan(values).any() else resample(time, values, at, hold)
        for values, hold in zip(columns, held, strict=True)
    ]


def resample(time: Float, values: Float, at: Float, held: bool = False) -> Float:
    """Resample a channel: linear between valid samples, held if it is stepped, NaN outside them.

    Stamps and values are Float[samples], the other times Float[points], like the result; times are in s.

    The channel is stepped if `held` is true or `is_stepped(values)`. In pauses, which are longer than `PAUSE` usual
    steps, a channel that is not stepped is NaN.

    >>> resample(np.array([0.0, 1.0]), np.array([0.0, 5.0]), np.array([0.5, 2.0]))
    array([2.5, nan])
    """
    valid = ~np.isnan(values)
    if not valid.any():
        return np.full(at.shape, np.nan)
    stamps = time[valid]
    return _interpolate(stamps, values[valid], _snap(stamps, at), held)


def _interpolate(stamps: Float, known: Float, exact: Float, held: bool) -> Float:
    """Return the values at points that are set to the stamps they are near to; none is missing."""
    if not (held or is_stepped(known)):
        values = np.interp(exact, stamps, known, left=np.nan, right=np.nan)
        return np.where(_in_pause(stamps, exact), np.nan, values)
    before = np.searchsorted(stamps, exact, side="right") - 1
    inside = (before >= 0) & (exact <= stamps[-1])
    return np.where(inside, known[np.maximum(before, 0)], np.nan)


def _in_pause(stamps: Float, at: Float) -> Bool:
    """Return whether the points lie between two stamps that are a pause apart."""
    steps = np.diff(stamps)
    # most recordings are even and have no pause, so the usual step is not needed
    if not steps.size or steps.max() <= PAUSE * steps.min() or steps.max() <= (longest := longest_usual_step(steps)):
        return np.zeros(at.shape, dtype=bool)
    after = np.clip(np.searchsorted(stamps, at), 1, stamps.size - 1)
    inside: Bool = (steps[after - 1] > longest) & (at > stamps[after - 1]) & (at < stamps[after])
    return inside


def _snap(stamps: Float, at: Float) -> Float:
    """Return `at` with points set to a time stamp if they differ from it by rounding only."""
    after = np.minimum(np.searchsorted(stamps, at), stamps.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(stamps[before] - at) < np.abs(stamps[after] - at), stamps[before], stamps[after])
    # 1e-14 is 45 roundings of a double, for times that count from a distant date
    return np.where(np.abs(nearest - at) <= _SAME_INSTANT + 1e-14 * np.abs(at), nearest, at)
