"""Tail, quantile and power of the F distribution; a calibration that ends with a score does not wait for scipy to load.

With I the regularized incomplete beta function, P(F > x) = I_z(n/2, m/2) with z = n / (n + m x) for m and n degrees of
freedom. I follows from its continued fraction (DLMF 8.17.22), evaluated as W. Lentz did (Applied Optics 15, 1976).
"""

import math
from collections.abc import Callable

ROUNDS = 10_000
DIGITS = 1e-15
TINY = 1e-300  # instead of a denominator of 0
DOUBLINGS = 1000  # until a bracket is found


def f_tail(x: float, m: float, n: float) -> float:
    """Return the probability of a larger value of the F distribution.

    Args:
        x: the value.
        m: degrees of freedom of the numerator, > 0.
        n: degrees of freedom of the denominator, > 0.

    >>> round(f_tail(4.96, 1, 10), 4)
    0.0501
    """
    if not x > 0:
        return 1.0
    if math.isinf(x):
        return 0.0
    return _beta_share(n / (n + m * x), m * x / (n + m * x), n / 2, m / 2)


def f_quantile(p: float, m: float, n: float) -> float:
    """Return the value that is exceeded with probability p, 0 < p < 1; see `f_tail`.

    >>> round(f_quantile(0.05, 1, 10), 2)
    4.96
    """
    return _least(lambda x: f_tail(x, m, n) < p)


def detected_noncentrality(level: float, power: float, m: float, n: float) -> float:
    """Return the noncentrality with which an F test of a level, 0 < level < 1, has a power, level < power < 1.

    The noncentral distribution with noncentrality d is that of (1 + d / m) F, where F has (m + d)^2 / (m + 2 d) degrees
    of freedom in its numerator, nearly (Patnaik, Biometrika 36, 1949); the power is right to 0.02.

    >>> round(detected_noncentrality(0.01, 0.9, 5, 60), 1)
    24.6
    """
    limit = f_quantile(level, m, n)

    def detects(d: float) -> bool:
        return f_tail(limit / (1 + d / m), (m + d) ** 2 / (m + 2 * d), n) >= power

    return _least(detects)


def _least(holds: Callable[[float], bool]) -> float:
    """Return the least number >= 0 from which on a condition holds."""
    low, high = 0.0, 1.0
    for _ in range(DOUBLINGS):
        if holds(high):
            break
        low, high = high, 2 * high
    while (middle := (low + high) / 2) not in (low, high):
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _beta_share(x: float, rest: float, a: float, b: float) -> float:
    """Return I_x(a, b); `rest` is 1 - x, which loses its digits if computed from an x close to 1."""
    if not x > 0:
        return 0.0
    if not rest > 0:
        return 1.0
    # the fraction converges fast on this side of the mean
    if x > (a + 1) / (a + b + 2):
        return 1 - _beta_share(rest, x, b, a)
    logarithm = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log(rest)
    return math.exp(logarithm) * _fraction(x, a, b) / a


def _fraction(x: float, a: float, b: float) -> float:
    c, d = 1.0, 1 / _nonzero(1 - (a + b) * x / (a + 1))
    value = d
    for m in range(1, ROUNDS):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for term in (even, odd):
            d = 1 / _nonzero(1 + term * d)
            c = _nonzero(1 + term / c)
            value *= c * d
        if abs(c * d - 1) < DIGITS:
            break
    return value


def _nonzero(x: float) -> float:
    return x if abs(x) > TINY else TINY
