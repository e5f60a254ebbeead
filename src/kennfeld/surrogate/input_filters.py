"""First-order filters of the inputs of a dynamic model: a memory without feedback, which is bounded for any input.

Each time constant T adds the filtered inputs x_k = x_{k-1} + (1 - exp(-step / T)) (u_k - x_{k-1}), which begin at the
first u: the exact response to inputs that are constant within each step.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.surrogate.recursion import run_through


def filter_share(step: float, time_constant: float) -> float:
    """Return 1 - exp(-step / T), both in s.

    >>> round(filter_share(0.1, 1.0), 6)
    0.095163
    """
    return float(-np.expm1(-step / time_constant))


def filtered_points(u: Float, delay: int, step: float, time_constants: Sequence[float]) -> Float:
    """Filter inputs by each time constant; the inputs themselves come first: Float[samples, inputs * (1 + filters)].

    `u` Float[samples, inputs] is read `delay` samples late, and has its first value before the recording.
    """
    late = np.concatenate([np.repeat(u[:1], min(delay, len(u)), axis=0), u[: max(len(u) - delay, 0)]])
    filtered = [_low_passed(late, filter_share(step, time_constant)) for time_constant in time_constants]
    return np.concatenate([late, *filtered], axis=1)


def _low_passed(u: Float, share: float) -> Float:
    """Return x_k = (1 - share) x_{k-1} + share u_k, which begins at the first u: Float[samples, inputs]."""
    # the state before the first sample is the first u, which the first step then returns unchanged
    rows = np.concatenate([u[:1], share * u])[:, None, :]
    run_through(rows, np.full((len(u), 1, 1), 1.0 - share), (1,))
    return rows[1:, 0]
