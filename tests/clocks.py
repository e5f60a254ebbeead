"""Steps and time of samples, as columns of the interpreter and of machine code."""

import numpy as np


def even_clock(step, samples):
    """The clock of samples that are `step` seconds apart."""
    return {"dt": np.full(samples, step), "dt_next": np.full(samples, step), "t": step * np.arange(samples)}


def clock_at(times):
    """The clock of samples at these times in s, of which the first is 0."""
    times = np.asarray(times, dtype=float)
    steps = np.diff(times)
    return {"dt": np.append(steps[:1], steps), "dt_next": np.append(steps, steps[-1:]), "t": times - times[0]}
