"""Which samples count as training samples of a value."""

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.problem import Compiled

__all__ = ["touching_samples"]


def touching_samples(compiled: Compiled, full: Float) -> Int:
    """For each free value, the scored samples that touch it; `full` are the free and the fixed values.

    A sample that is only simulated, because of `where`, the warmup or a missing target, does not count. A steady-state
    point that is held until the model has settled counts once, for all samples over which it is averaged.
    """
    bounds = compiled.problem.gathered
    averaged = any(bound.hold is not None and bound.hold.window > 1 for bound in bounds)
    parts = averaged and compiled.accumulator.stateful
    return compiled.accumulator.touched(full, _owners(compiled, bounds) if parts else None)


def _owners(compiled: Compiled, bounds: tuple[Bound, ...]) -> Int:
    """For each sample the scored one of which it is a part, -1 where there is none."""
    samples = compiled.samples
    owners = np.full(samples.count, -1, dtype=np.int64)
    for piece in samples.pieces:
        visits = np.arange(piece.first, piece.last)
        scored = np.isfinite(samples.targets_of(visits)[piece.scores > 0]).any(axis=0)
        owners[visits[scored]] = visits[scored]
    end = 0
    for bound in bounds:
        first, end = end, end + bound.count
        if bound.hold is not None:
            points = owners[first:end].reshape(-1, bound.hold.samples)
            points[:, -bound.hold.window :] = points[:, -1:]
    return owners
