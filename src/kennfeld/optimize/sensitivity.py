"""Values whose effect on the scored outputs is mere rounding, although their derivatives are not exactly zero.

There are two causes. The effect of a value may have decayed before the first scored sample, as that of an initial state
after a warm-up much longer than its time constant: its derivatives are correct, but tiny compared with those on
simulated samples that are not scored, or with those of the other values of its table. Or the effect cancels within the
model, as that of `k` in `(k*x) / (k*z)`: the derivatives are rounding errors and change with the last digits of the
values. In both cases a least-squares step would divide noise by noise.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.samples import Piece, Samples
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.quality import SAMPLES_PER_BLOCK, Quality
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult

UNDERFLOW = 1e-290  # a cost below has lost digits
REACHED = 1e-10  # share of the cost at the start below which a fit is as good as exact
UNDERFLOW_MESSAGE = "The weighted squares of the errors underflow. Use larger weights, a smaller scale or other units."

FADED = (
    1e-6  # derivative relative to the largest of the same parameter on all simulated samples, below which it is faded
)
TINY = 1e-14  # the same on the scored samples alone
SUSPECT = 1e-12  # share of the targets by which a change of a value by its size moves the outputs
NUDGE = 1e-12  # relative change of the values that changes rounding errors but not true derivatives
NUDGES = 4  # rounding errors are few different numbers, which one nudge may leave unchanged by chance
UNSTEADY = 1e-4  # relative change of the curvature under a nudge from which it counts as rounding

Curvature = Callable[[Float], Float]  # that of the data along each free value, at all values


def without_vanished(
    end: SolverResult, before: float, quality: Sequence[Quality], scored: Collection[str]
) -> SolverResult:
    """Mark an end as failed if errors remain whose squares underflow, so that the search did not see them.

    Args:
        end: the end of the search.
        before: the cost at the start.
        quality: the errors at the end.
        scored: the criteria with a weight > 0.
    """
    left = any(q.max_abs_after > 0 for q in quality if q.use == "training" and q.criterion in scored)
    if end.status != "converged" or not left or not REACHED * before <= end.cost < UNDERFLOW:
        return end
    return replace(end, status="failed", message=UNDERFLOW_MESSAGE)


class Sensitivity:
    """Finds the values of a compiled problem whose derivatives are rounding errors."""

    def __init__(self, compiled: CompiledProblem) -> None:
        self._compiled = compiled
        values = compiled.values
        starts = sorted(at for at in (*values.offsets.values(), *values.moving.values()) if at < values.free)
        self._starts = np.array(starts, dtype=np.int64)
        self._sizes = np.diff([*starts, values.free])
        self._everywhere: Float | None = None
        self._target_size: float | None = None

    def faint(self, values: Float, curvature: Float, curvature_at: Curvature) -> Bool:
        """Mark the free values whose effect is at the level of rounding.

        Args:
            values: the free and the fixed values, Float[values].
            curvature: that of the data along each free value there, Float[free].
            curvature_at: computes it at other values.
        """
        if not np.all(np.isfinite(curvature)):
            return np.zeros(curvature.size, dtype=bool)
        least = np.maximum(FADED**2 * self.everywhere(values), TINY**2 * self._largest(curvature))
        found: Bool = curvature <= least
        suspect = self._suspect(values, curvature) & ~found
        for number in range(1, NUDGES + 1):
            if not suspect.any():
                break
            nudged = curvature_at(self._nudged(values, number))
            unsteady = suspect & (np.abs(nudged - curvature) > UNSTEADY * curvature)
            found |= unsteady
            suspect &= ~unsteady
        return found

    def everywhere(self, values: Float) -> Float:
        """Return the largest curvature in the parameter of each value on all simulated samples; 0 if all are scored.

        It is computed once, at the first values.
        """
        if self._everywhere is None:
            samples = _all_scored(self._compiled.samples) if self._compiled.accumulator.stateful else None
            if samples is None:
                self._everywhere = np.zeros(self._compiled.values.free)
            else:
                matrix = Accumulator(self._compiled.kernel, samples).normal(values).matrix
                self._everywhere = self._largest(np.nan_to_num(np.diag(matrix), posinf=0.0))
        return self._everywhere

    def _largest(self, each: Float) -> Float:
        """Return for each value the largest number of its parameter."""
        if not each.size:
            return each
        return np.repeat(np.maximum.reduceat(each, self._starts), self._sizes)

    def _suspect(self, values: Float, curvature: Float) -> Bool:
        """Mark values that hardly move the outputs when they change by their own size, or by 1 if that is 0."""
        size = self._largest(np.abs(values[: curvature.size]))
        size[size == 0] = 1.0
        with np.errstate(over="ignore"):
            suspect: Bool = (curvature > 0) & (curvature * size**2 <= SUSPECT**2 * self._targets())
        return suspect

    def _targets(self) -> float:
        """Return the weighted sum of squares of all targets."""
        if self._target_size is None:
            scales = np.array([output.scale for output in self._compiled.kernel.outputs])
            blocks = _target_blocks(self._compiled.samples)
            parts = [(piece.scores / scales**2) @ np.nansum(block**2, axis=1) for piece, _, block in blocks]
            self._target_size = float(sum(parts))
        return self._target_size

    def _nudged(self, values: Float, number: int) -> Float:
        """Change the free values in their last digits, each by another share, different for each number."""
        nudged = values.copy()
        free = self._compiled.values.free
        nudged[:free] *= 1 + NUDGE * (number + np.modf(np.arange(free) * 0.618034)[0])
        return nudged


def _all_scored(samples: Samples) -> Samples | None:
    """Return the samples with each piece scored up to its last scored sample; None if they are already."""
    scored = np.full((len(samples.targets), samples.count), np.nan)
    known, ends = 0, {}
    for piece, first, block in _target_blocks(samples):
        finite = np.isfinite(block)
        known += int(finite.sum())
        at = np.flatnonzero(finite.any(axis=0))
        if at.size:
            ends[piece.first] = first + int(at[-1]) + 1
    for first, last in ends.items():
        scored[:, first:last] = 0.0
    if known == np.count_nonzero(scored == 0.0):
        return None
    return Samples(samples.inputs.parts, list(scored), samples.pieces)


def _target_blocks(samples: Samples) -> Iterator[tuple[Piece, int, Float]]:
    """Yield pieces, the first sample of a block, and its targets Float[outputs, samples]."""
    for piece in samples.pieces:
        for first in range(piece.first, piece.last, SAMPLES_PER_BLOCK):
            yield piece, first, samples.targets_of(np.arange(first, min(first + SAMPLES_PER_BLOCK, piece.last)))
