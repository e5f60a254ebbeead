"""First-order filters of the inputs of a dynamic model: a memory without feedback, which is bounded for any input.

Each time constant T adds the filtered inputs x_k = x_{k-1} + (1 - exp(-step / T)) (u_k - x_{k-1}), which begin at the
first u: the exact response to inputs that are constant within each step.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Float


def filter_share(step: float, time_constant: float) -> float:
    """Return 1 - exp(-step / T), both in s.

    >>> round(filter_share(0.1, 1.0), 6)
    0.095163
    """
    return float(-np.expm1(-step / time_constant))


def filtered_points(u: Float, delay: int, step: float, time_constants: Sequence[float]) -> Float:
    """Return the inputs, then the inputs filtered by each time constant: Float[samples, inputs * (1 + filters)].

    `u` Float[samples, inputs] is read `delay` samples late, and has its first value before the recording.
    """
    from scipy.signal import lfilter

    late = np.concatenate([np.repeat(u[:1], min(delay, len(u)), axis=0), u[: max(len(u) - delay, 0)]])
    columns = [late]
    for time_constant in time_constants:
        share = filter_share(step, time_constant)
        columns.append(lfilter([share], [1.0, share - 1.0], late, axis=0, zi=(1 - share) * late[:1])[0])
    return np.concatenate(columns, axis=1)
