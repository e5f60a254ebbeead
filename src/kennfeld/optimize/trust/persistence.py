"""Number of consecutive correlated samples that are worth one independent sample.

The variance of a sum of n correlated errors is that of independent ones times

    1 + 2 sum_k w(k) r(k),    w(k) = pairs(k) / n

over the lags k, where r is their autocorrelation and pairs(k) counts the pairs of known samples k apart in one piece.
Two biases are corrected. The sum of the estimates of r over all lags is -1/2 whatever r is, so the sum ends at the
first pair of neighbouring autocorrelations that is not positive, and pairs must not increase (the initial monotone
sequence of C. Geyer: Practical Markov Chain Monte Carlo, Statistical Science 7, 1992). And subtracting the mean of the
errors, as a fit does, lowers each autocovariance by the variance of the mean, which is added again (F. H. C. Marriott
and J. A. Pope: Bias in the estimation of autocorrelations, Biometrika 41, 1954). So does each further fitted value of a
slowly varying effect, see `Correlation.inflation`.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Complex, Float, Int
from kennfeld.base.lazy_dataclass import dataclass

SAMPLES_PER_BLOCK = 65536  # transformed at once, so that memory does not grow with the data
MAX_LAGS = 1 << 17
MIN_SAMPLES = 8
MIN_PAIRS = 0.05  # per sample, for a lag to be used
MIN_CORRELATION = 2.0  # at lag 1, in standard deviations of the autocorrelation of white noise
MAX_MEAN_FACTOR = 4.0  # by which the correction for the mean may raise the sum


def persistence(residual: Float, starts: Sequence[int] | Int = (0,)) -> tuple[float, int]:
    """Estimate the number of samples worth one independent sample, and count the known samples.

    Args:
        residual: residuals of an evenly sampled recording, NaN if unknown; shape (samples,).
        starts: first sample of each piece; no pair crosses it.

    >>> persistence(np.array([1.0, -1.0] * 50))
    (1.0, 100)
    >>> length, _ = persistence(np.repeat(np.random.default_rng(0).normal(size=2000), 10))
    >>> bool(abs(length - 10) < 1)
    True
    """
    known = residual[np.isfinite(residual)]
    if known.size < MIN_SAMPLES:
        return 1.0, known.size
    products = LaggedProducts.of(residual, starts, float(known.mean()), persistence_lags(starts, residual.size))
    return inflation(products.sums, products.pairs), known.size


def persistence_lags(starts: Sequence[int] | Int, samples: int) -> int:
    """Limit the lags over which persistence is estimated by the longest piece, given its starts, Int[pieces]."""
    edges = [*(int(start) for start in starts), samples]
    return min(max(b - a for a, b in pairwise(edges)) - 1, MAX_LAGS)


@dataclass
class LaggedProducts:
    """Sums of products of errors minus a mean and their numbers, by lag from 0; see `inflation`.

    `ends` are the sums of both factors of the products: with them, another mean needs no errors.
    """

    sums: Float  # Float[lags]
    pairs: Float  # Float[lags]
    ends: Float  # Float[lags]
    mean: float

    @classmethod
    def of(cls, errors: Float, starts: Sequence[int] | Int, mean: float, lags: int) -> "LaggedProducts":
        """Return the products of errors minus their mean over all lags up to `lags`.

        Args:
            errors: evenly sampled, NaN if unknown; shape (samples,).
            starts: first sample of each piece; no pair crosses it.
            mean: subtracted from the errors.
            lags: the greatest lag.
        """
        products = cls(np.zeros(lags + 1), np.zeros(lags + 1), np.zeros(lags + 1), mean)
        known = np.isfinite(errors)
        centred, spectra = np.where(known, errors - mean, 0.0), _CrossSpectra()
        for a, b in pairwise([*(int(start) for start in starts), errors.size]):
            reach = min(b - a, lags + 1)
            spectra.add(centred[a:b], reach - 1)
            products.pairs[:reach] += _count_pairs(known[a:b], reach - 1)
            products.ends[:reach] += _sum_ends(centred[a:b], known[a:b], reach - 1)
        spectra.add_products(products.sums)
        return products

    def merge(self, later: "LaggedProducts") -> None:
        """Take in the products of other pieces, at more or fewer lags and about another mean."""
        other = later.about(self.mean)
        size = max(self.sums.size, other.sums.size)
        for name in ("sums", "pairs", "ends"):
            total = np.zeros(size)
            for part in (getattr(self, name), getattr(other, name)):
                total[: part.size] += part
            setattr(self, name, total)

    @property
    def count(self) -> int:
        """The number of known errors."""
        return round(float(self.pairs[0]))

    @property
    def centred(self) -> "LaggedProducts":
        """The products of the errors minus the mean of all."""
        # at lag 0, both factors of a product are the same error
        return self.about(self.mean + float(self.ends[0]) / max(2 * self.count, 1))

    def about(self, mean: float) -> "LaggedProducts":
        """Return the products of the errors minus another mean."""
        rise = mean - self.mean
        # sum of (e - h)(e' - h) = sum of e e' - h sum of (e + e') + h^2 pairs
        sums = self.sums - rise * self.ends + rise**2 * self.pairs
        return LaggedProducts(sums, self.pairs, self.ends - 2 * rise * self.pairs, mean)


def _is_without_gap(known: Int) -> bool:
    """Return if the known samples, by number, follow each other."""
    return bool(known.size and known[-1] - known[0] < known.size)


def _count_pairs(known: Bool, lags: int) -> Float:
    at = np.flatnonzero(known)
    if _is_without_gap(at):
        return np.asarray(np.maximum(float(at.size) - np.arange(lags + 1), 0.0))
    return np.round(lagged_products(known.astype(np.float64), lags))


def _sum_ends(values: Float, known: Bool, lags: int) -> Float:
    """Return the sums of values[i] + values[i + k] over the pairs of known ones, for k from 0 to `lags`.

    >>> _sum_ends(np.array([1.0, 2.0, 4.0]), np.array([True, True, True]), 2)
    array([14.,  9.,  5.])
    >>> _sum_ends(np.array([1.0, 0.0, 4.0]), np.array([True, False, True]), 2).round(9) + 0.0
    array([10.,  0.,  5.])
    """
    at = np.flatnonzero(known)
    size = float(np.abs(values).max(initial=0.0))
    if not at.size or not size:
        return np.zeros(lags + 1)
    if not _is_without_gap(at):
        # (u + k)(u' + k') - (u - k)(u' - k') = 2 (u k' + k u'), with values u, 0 where unknown, and k of 1 or 0
        unit = values / size  # so that neither summand is rounding beside the other
        return 0.5 * size * (lagged_products(unit + known, lags) - lagged_products(unit - known, lags))
    # without gaps, the sum of the first and of the last n - k values
    before = np.concatenate([[0.0], np.cumsum(values[at[0] : at[-1] + 1])])
    left = np.clip(at.size - np.arange(lags + 1), 0, None)  # number of pairs
    return np.asarray(before[left] + before[-1] - before[at.size - left])


@dataclass(frozen=True)
class Correlation:
    """The correlation of the errors of a recording, summed over the lags at which it is positive.

    `plain` is 1 + 2 sum_k w(k) r(k) over these lags, `window` the same for r = 1.
    """

    plain: float = 1.0
    window: float = 1.0

    @classmethod
    def of(cls, sums: Float, pairs: Float) -> "Correlation":
        """Return the correlation.

        Args:
            sums: sums of products of centred errors, by lag from 0; shape (lags,).
            pairs: number of products in each sum; shape (lags,).
        """
        count = float(pairs[0])
        usable = pairs >= MIN_PAIRS * count
        if usable.sum() < 2 or not sums[0] > 0:
            return cls()
        weight = pairs[usable] / count
        correlation = sums[usable] / pairs[usable] / (sums[0] / count)
        # without a correlation at lag 1, later ones are chance
        if correlation[1] * np.sqrt(pairs[usable][1]) < MIN_CORRELATION:
            return cls()
        # Geyer's pairs r(0) + r(1), r(2) + r(3), ...: they are positive and falling for a reversible chain
        even = correlation.size // 2 * 2
        neighbours, weights = (each[:even].reshape(-1, 2) for each in (correlation, weight))
        together = neighbours.sum(axis=1)
        end = int(np.argmax(together <= 0)) if (together <= 0).any() else together.size
        share = weights[:end].mean(axis=1)
        # lag 0 counts once, all others for both signs of the lag
        plain = 2 * float(share @ np.minimum.accumulate(together[:end])) - 1
        return cls(plain, 2 * float(weights[:end].sum()) - 1)

    def inflation(self, count: float, fitted: float = 1.0, smooth: float = 1.0) -> float:
        """Return the factor, at least 1, by which correlation raises the variance of a sum.

        A fit takes from the autocovariance at each lag k the part (v / n) c(k), where v is the variance of the fitted
        values' share in units of that of one error, and c(k) the sum of the elements of the projection onto the fitted
        functions that are k samples apart. If these vary slowly, v is the factor itself, and c(k) their number; if they
        are independent from sample to sample, v is 1, and c(k) is 0 but for k = 0.

        Args:
            count: number of errors, n.
            fitted: number of fitted values; 1 for the mean.
            smooth: mean of c(k) / c(0) over the lags of the sum.
        """
        if self.window <= 1:
            return 1.0
        # whole = plain + v excess, with the variance v = 1 + smooth (whole - 1) of a fitted value, solved for whole
        excess = fitted / count * (1 + smooth * (self.window - 1) - self.plain)
        whole = (self.plain + (1 - smooth) * excess) / max(1 - smooth * excess, 1 / MAX_MEAN_FACTOR)
        return max(whole, 1.0)


def inflation(sums: Float, pairs: Float) -> float:
    """Estimate the factor by which correlation raises the variance of a sum, for errors whose mean was subtracted.

    Args:
        sums: sums of products of the errors, by lag from 0; shape (lags,).
        pairs: number of products in each sum; shape (lags,).
    """
    return Correlation.of(sums, pairs).inflation(float(pairs[0]))


def lagged_products(values: Float, lags: int) -> Float:
    """Sum values[i] values[i + k] over i for k from 0 to `lags`, Float[lags + 1], blockwise by FFT."""
    total, spectra = np.zeros(lags + 1), _CrossSpectra()
    spectra.add(values, lags)
    spectra.add_products(total)
    return total


class _CrossSpectra:
    """The spectra of lagged products, summed over pieces and blocks by the size of their FFT and their lags."""

    def __init__(self) -> None:
        self._sums: dict[tuple[int, int], Complex] = {}

    def add(self, values: Float, lags: int) -> None:
        """Add the products of a piece at lags up to `lags`."""
        # each block with the lags behind it, in which the later factors lie
        block = max(SAMPLES_PER_BLOCK, lags)
        for first in range(0, values.size, block):
            left, right = values[first : first + block], values[first : first + block + lags]
            # at least left + lags, so that no product up to the last lag wraps around
            size = 1 << int(left.size + lags - 1).bit_length()
            spectrum = np.fft.rfft(left, size)
            product = np.conj(spectrum) * (spectrum if right.size == left.size else np.fft.rfft(right, size))
            known = self._sums.get((size, lags))
            self._sums[size, lags] = product if known is None else known + product

    def add_products(self, total: Float) -> None:
        """Add the products to their sums by lag."""
        for (size, lags), spectrum in self._sums.items():
            total[: lags + 1] += np.fft.irfft(spectrum, size)[: lags + 1]
