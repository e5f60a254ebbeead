"""How well a criterion is met."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float

__all__ = ["CONSTANT", "Quality", "r2_text", "spread"]

CONSTANT = "constant target"  # in place of R2, which compares with the target's variance

_BLOCK = 65536  # samples at once, so that memory does not grow with the data


@dataclass(frozen=True)
class Quality:
    """How well one criterion is met on one dataset, in the unit of its target, before and after.

    `r2_after` is NaN if the target is constant, for then there is no variance to explain.
    """

    criterion: str
    dataset: str
    use: str
    samples: int
    rmse_before: float
    rmse_after: float
    r2_after: float
    max_abs_after: float


def r2_text(r2: float, samples: int, rmse: float) -> str:
    """Return R2 for a table: a number, or why there is none.

    >>> r2_text(0.98765, 20, 0.1), r2_text(float("nan"), 20, 0.1), r2_text(float("nan"), 0, float("nan"))
    ('0.9877', 'constant target', '-')
    """
    if np.isfinite(r2):
        return f"{r2:.4f}"
    return CONSTANT if samples and np.isfinite(rmse) else "-"


def spread(target: Float) -> float:
    """Return the sum of squared distances from the mean, where the target is known; exactly 0 if it is constant.

    Args:
        target: NaN where a sample is not scored; Float[samples].
    """
    count, total = 0, 0.0
    first = next((float(part[0]) for part in _known(target)), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        for part in _known(target):
            count += part.size
            total += float(np.sum(part - first))
        mean = first + total / max(count, 1)
        return float(sum(np.sum((part - mean) ** 2) for part in _known(target)))


def _known(target: Float) -> Iterator[Float]:
    """The values that are there, block by block."""
    for at in range(0, target.size, _BLOCK):
        part = target[at : at + _BLOCK]
        known = part[np.isfinite(part)]
        if known.size:
            yield known
