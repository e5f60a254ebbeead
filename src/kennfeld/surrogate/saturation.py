"""Saturation of a recorded output: it stays at its maximum or minimum, where the system or its sensor limits it."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.surrogate.recursion import UNLIMITED

BAND = 0.01  # share of the range that counts as one level
SHARE = 0.01  # of the samples that at least lie at a limit
FEWEST = 10  # samples there
VISITS = 2  # separate times that the output arrives there
PEAK = 5.0  # times as many samples as in the bands beside it; the turning points of a sine have 3 times as many
BESIDE = 3  # of these bands


@dataclass(frozen=True)
class Saturation:
    """A level that the output does not pass: `limit`, with the number of its `samples`; `upper` is a maximum."""

    limit: float
    samples: int
    upper: bool

    def __str__(self) -> str:
        return f"stays at its {'maximum' if self.upper else 'minimum'} {self.limit:g} for {self.samples} samples"


def find_saturation(outputs: Sequence[Float]) -> list[Saturation]:
    """Find where the outputs of recordings, Float[samples] each, saturate: at most one minimum and one maximum.

    An output saturates where many more samples lie at the end of its range than just inside of it, which also holds for
    a level with noise. An output that jumps between levels has gaps beside all of them, not only at the ends, and does
    not saturate.

    >>> wave = np.sin(np.linspace(0, 60, 1000))
    >>> [str(end) for end in find_saturation([np.minimum(wave, 0.8)])], find_saturation([wave])
    (['stays at its maximum 0.8 for 224 samples'], [])
    """
    whole = np.concatenate(outputs)
    span = float(np.ptp(whole))
    if not span > 0 or _jumps(whole, span):
        return []
    ends = [_saturation([sign * y for y in outputs], BAND * span, sign) for sign in (-1.0, 1.0)]
    return [end for end in ends if end is not None]


def _saturation(outputs: Sequence[Float], band: float, sign: float) -> Saturation | None:
    """Return the saturation at the maximum of these; `sign` turns them back."""
    whole = np.concatenate(outputs)
    below = whole.max() - whole
    there = int(np.count_nonzero(below <= band))
    beside = int(np.count_nonzero((below > band) & (below <= (1 + BESIDE) * band)))
    # an output that arrives there only once may have reached the end of a run-up
    visits = sum(int(np.count_nonzero(np.diff((whole.max() - y <= band).astype(int), prepend=0) > 0)) for y in outputs)
    if there < max(FEWEST, SHARE * whole.size) or visits < VISITS or there * BESIDE < PEAK * beside:
        return None
    return Saturation(sign * float(np.median(whole[below <= band])), there, sign > 0)


def _jumps(whole: Float, span: float) -> bool:
    """Return whether the output takes a few separate levels, as a gear or a switch does."""
    filled = np.count_nonzero(np.histogram(whole, bins=round(1 / BAND))[0])
    return bool(filled < 0.5 / BAND)


def limits_of(ends: Sequence[Saturation]) -> tuple[float, float]:
    """Return the lower and the upper limit."""
    lower, upper = UNLIMITED
    for end in ends:
        lower, upper = (lower, end.limit) if end.upper else (end.limit, upper)
    return lower, upper
