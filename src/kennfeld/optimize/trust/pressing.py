"""Which limits of outputs hold the values at the end of a fit, as rows that the values then keep with equality.

Near the end, keeping the limits A p <= b in a quadratic cost is a small problem in the multipliers l of the samples at
which they are met: the least l'Gl / 2 - l'v over l >= 0, with G = A C A', C the inverse of the curvature, and v how far
the best step without the limits would exceed them (J. Nocedal and S. Wright, Numerical Optimization, chapter 16; the
search is that of C. Lawson and R. Hanson, Solving Least Squares Problems, 1974, chapter 23).

Neighbouring samples have nearly equal rows, and which of them is met is a matter of noise. So of the samples with a
multiplier only those count without which the cost would fall by more than its noise, l^2 / (G^-1)_ii > phi: that is
the square of how many standard deviations the values would come to lie beyond the limit. What the others hold is held
by their neighbours, or not held at all.
"""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.optimize.limits.output_limits import Touched

__all__ = ["Pressed", "multipliers", "pressing"]

NOTHING = 1e-12  # of the largest, what is rounding
FIRM = 1.0  # square of the standard deviations by which a limit must be pressed


@dataclass(frozen=True)
class Pressed:
    """Samples at which limits of outputs are met, and which of them hold a direction of the values each."""

    touched: Touched
    holds: Bool  # Bool[samples]

    @property
    def rows(self) -> Float:
        """The slopes of what is held, shape (held, values)."""
        found: Float = self.touched.rows[self.holds]
        return found


def pressing(touched: Touched, rows: Float, inverse: Float, gradient: Float, dispersion: float) -> Pressed:
    """Which of the samples hold values; rows, inverse of the curvature and half the gradient are over those that move.

    `dispersion` is the noise of the cost, phi.
    """
    gram = rows @ inverse @ rows.T
    beyond = touched.excess - rows @ (inverse @ gradient)
    found = np.flatnonzero(multipliers(gram, beyond) > 0)
    holds = np.zeros(beyond.size, dtype=bool)
    holds[_firm(gram, beyond, found, FIRM * np.nan_to_num(dispersion))] = True
    return Pressed(touched, holds)


def _firm(gram: Float, beyond: Float, kept: Int, least: float) -> Int:
    """Of some rows those that are each needed, the least needed one taken out again and again."""
    while kept.size:
        inner = np.linalg.pinv(gram[np.ix_(kept, kept)], rcond=NOTHING, hermitian=True)
        forces = inner @ beyond[kept]
        own = np.maximum(np.diag(inner), 1e-300)
        need = np.where(forces > 0, forces**2 / own, 0.0)
        weakest = int(need.argmin())
        if need[weakest] > least:
            break
        kept = np.delete(kept, weakest)
    return kept


def multipliers(gram: Float, beyond: Float) -> Float:
    """The l >= 0 of least l'Gl / 2 - l'v; few of them are not 0.

    >>> multipliers(np.eye(2), np.array([3.0, -1.0])).tolist()
    [3.0, 0.0]
    """
    units = np.sqrt(np.maximum(np.diag(gram), 0.0))
    usable = np.flatnonzero(units > NOTHING * units.max(initial=0.0))
    scaled = gram[np.ix_(usable, usable)] / np.outer(units[usable], units[usable])
    found = np.zeros(beyond.size)
    found[usable] = _lawson_hanson(scaled, beyond[usable] / units[usable]) / units[usable]
    return found


def _lawson_hanson(gram: Float, wanted: Float) -> Float:
    """For a diagonal of ones."""
    size = wanted.size
    at, inside = np.zeros(size), np.zeros(size, dtype=bool)
    enough = 1e-10 * float(np.abs(wanted).max(initial=0.0))
    for _ in range(3 * size):
        slope = np.where(inside, -np.inf, wanted - gram @ at)
        best = int(slope.argmax())
        if not slope[best] > enough:
            break
        inside[best] = True
        at = _within(gram, wanted, at, inside)
        if not inside[best]:  # it says nothing that those inside do not say
            wanted = np.where(np.arange(size) == best, -np.inf, wanted)
    return at


def _within(gram: Float, wanted: Float, at: Float, inside: Bool) -> Float:
    """The best point of those inside, from `at`; what turns negative on the way leaves, in place."""
    while inside.any():
        aim = np.zeros(at.size)
        block = gram[np.ix_(inside, inside)]
        aim[inside] = np.linalg.lstsq(block, wanted[inside], rcond=NOTHING)[0]
        low = inside & (aim <= 0)
        if not low.any():
            return aim
        share = float(np.min(at[low] / np.maximum(at[low] - aim[low], 1e-300)))
        at = np.where(inside, at + share * (aim - at), 0.0)
        inside &= ~(low & (at <= NOTHING * np.abs(at).max(initial=0.0)))
        at = np.where(inside, at, 0.0)
    return at
