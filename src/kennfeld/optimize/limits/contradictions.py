"""Limits that cannot be kept together, in words: each with what it asks for, and what stands against it."""

from collections.abc import Iterator

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.optimize.limits.limits import Limits

__all__ = ["contradictions"]

MOST = 3  # limits that are named
SLACK = 1e-9  # of the size of a limit: how near to its side a row counts as met


def contradictions(limits: Limits, nearest: Float, missed: Int) -> str:
    """Return a clause for each of the first rows that are missed, such as "pin of C at 0 must be 3, but ...".

    Args:
        limits: bounds and rows.
        nearest: the values that come nearest to keeping them all.
        missed: the rows that these values miss, worst first.
    """
    return "; ".join(_clause(limits, nearest, int(row)) for row in missed[:MOST])


def _clause(limits: Limits, nearest: Float, row: int) -> str:
    rows = limits.rows
    low, high = _reach(limits, row)
    slack = SLACK * max(abs(side) for side in (low, high, rows.lower[row], rows.upper[row], 1.0) if np.isfinite(side))
    if rows.lower[row] > high + slack or rows.upper[row] < low - slack:
        against = (
            f"bounds and locks hold it at {low:g}" if low == high else f"bounds and locks keep it {_side(low, high)}"
        )
    else:
        others = [f"{rows.names[other]} ({_required(limits, other)})" for other in _rivals(limits, nearest, row)]
        against = f"that contradicts {' and '.join(others)}" if others else "other limits keep it from that"
    return f"{rows.names[row]} {_required(limits, row)}, but {against}"


def _required(limits: Limits, row: int) -> str:
    low, high = limits.rows.lower[row], limits.rows.upper[row]
    return f"must be {low:g}" if low == high else f"must be {_side(low, high)}"


def _side(low: float, high: float) -> str:
    if np.isinf(high):
        return f">= {low:g}"
    return f"<= {high:g}" if np.isinf(low) else f"between {low:g} and {high:g}"


def _reach(limits: Limits, row: int) -> tuple[float, float]:
    """Return the least and the largest value that the bounds of its values allow a row."""
    used = limits.rows.coefficients[row] != 0
    factors, columns = limits.rows.coefficients[row][used], limits.rows.columns[row][used]
    ends = np.sort(factors[:, None] * np.stack([limits.lower[columns], limits.upper[columns]], axis=1), axis=1)
    low, high = ends.sum(axis=0)
    return float(low), float(high)


def _rivals(limits: Limits, nearest: Float, row: int) -> Iterator[int]:
    """Yield the first other rows that share a value with a row and are at one of their sides, or miss it."""
    rows = limits.rows
    touched = set(rows.columns[row][rows.coefficients[row] != 0].tolist())
    product, slack = rows.times(nearest), SLACK * (rows.size(nearest) + 1e-300)
    tight = np.flatnonzero((product <= rows.lower + slack) | (product >= rows.upper - slack))
    left = MOST - 1
    for other in tight.tolist():
        used = rows.columns[other][rows.coefficients[other] != 0].tolist()
        if other != row and left and touched.intersection(used):
            left -= 1
            yield other
