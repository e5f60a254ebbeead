"""The cost of a compiled problem as a function of its free values.

Derivatives of values whose effect on the scored outputs is mere rounding count as 0. There are two causes. The effect
may have decayed before the first scored sample, as that of an initial state after a warm-up much longer than its time
constant: its derivatives are correct, but tiny compared with those on simulated samples that are not scored, or with
those of the other values of its table. Or the effect cancels within the model, as that of `k` in `(k*x) / (k*z)`: the
derivatives are rounding errors and change with the last digits of the values. In both cases a least-squares step would
divide noise by noise.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK
from kennfeld.native.cholesky import Cholesky
from kennfeld.native.samples import Piece, Samples
from kennfeld.native.symmetric import SymmetricMatrix, zero
from kennfeld.optimize.limits.linear_limits import breakpoint_order, is_ordered
from kennfeld.optimize.sums.compiled import CompiledProblem

SMALL_VALUES, SMALL_ENTRIES = 64, 1_000_000  # up to these sizes the Jacobian itself is factored
MAX_SECANT_VALUES = 128  # large tables have more kinks than curvature
MAX_SECANT_VALUES_OF_A_GOAL = 512  # of outputs whose target is a number: all curvature is that of the residuals
FADED = 1e-6  # derivative that has faded, relative to the start or the largest of the parameter on simulated samples
TINY = 1e-14  # the same on the scored samples alone
SUSPECT = 1e-12  # share of the targets by which a change of a value by its size moves the outputs
NUDGE = 1e-12  # relative change of the values that changes rounding errors but not true derivatives
NUDGES = 8  # rounding errors are few different numbers, which one nudge may leave unchanged by chance
UNSTEADY = 1e-4  # relative change of the curvature under a nudge from which it counts as rounding

Curvature = Callable[[Float], Float]  # that of the data along each free value, at all values


class LeastSquaresObjective:
    """Data cost plus roughness; see `gauss_newton_model.Objective`.

    Derivatives that are rounding errors count as 0, so that no value moves by them (see `_Sensitivity`).
    """

    def __init__(self, compiled: CompiledProblem, *, by_rows: bool = True) -> None:
        """Without `by_rows`, normal equations are used for small problems too: faster, with half the digits."""
        self._compiled, self._sums = compiled, compiled.sums
        self._full = compiled.start.copy()
        self._free = compiled.values.free
        self._order = breakpoint_order(compiled.problem.free_axes, compiled.values)
        outputs = compiled.kernel.outputs
        entries = compiled.sample_count * len(outputs) * self._free
        self.uses_qr = by_rows and self._free <= SMALL_VALUES and entries <= SMALL_ENTRIES
        # a robust loss would change the weights of the residuals
        self.supports_acceleration = self.uses_qr and all(output.loss == "square" for output in outputs)
        most = MAX_SECANT_VALUES_OF_A_GOAL if compiled.problem.has_goals else MAX_SECANT_VALUES
        self.supports_secant = self._free <= most
        self._sensitivity = _Sensitivity(compiled)
        self._last_curvature: tuple[Float, Float] | None = None  # the values it belongs to, and itself
        self._cholesky = Cholesky(0 if self.uses_qr else self._free)
        if not self.uses_qr:
            self._sums.prepare()

    @property
    def start(self) -> Float:
        """The free values at the start, Float[free]."""
        return self._compiled.start[: self._free].copy()

    def _values(self, free: Float) -> Float:
        self._full[: self._free] = free
        return self._full

    def cost(self, values: Float) -> float:
        """Compute losses plus roughness at free values, Float[free]; infinite if breakpoints are out of order."""
        if not is_ordered(self._order, values):
            return np.inf
        cost = self._sums.cost(self._values(values)) + self._compiled.roughness.cost(values)
        if not np.isfinite(cost):
            self._compiled.rejected.add(values)
        return cost

    def data_cost(self, values: Float) -> float:
        """Compute the cost without roughness at free values, Float[free]."""
        return self.cost(values) - self._compiled.roughness.cost(values)

    def normal(self, values: Float) -> tuple[Float, SymmetricMatrix]:
        """Compute half the gradient, Float[free], and the Gauss-Newton matrix [free, free]."""
        data = self._sums.normal(self._values(values))
        diagonal = data.matrix.diagonal().copy()
        faint = self._faint(diagonal) & (diagonal > 0)
        if faint.any():
            data = self._sums.normal(self._full)  # judging may have computed it elsewhere
            data.gradient[faint] = 0.0
            zero(data.matrix, faint)
        self._compiled.roughness.add(values, data.gradient, data.matrix)
        return data.gradient, data.matrix

    def residual(self, values: Float) -> Float:
        """Compute residuals, Float[residuals], with those of the roughness below."""
        residual = self._sums.residual(self._values(values))
        self._check(residual, values)
        rough = self._compiled.roughness.rows(values)[0]
        return np.concatenate([residual, rough]) if rough.size else residual

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, Float[residuals, free], with those of the roughness below."""
        residual, jacobian = self._sums.rows(self._values(values))
        self._check(residual, values)
        jacobian[:, self._faint(_squares(jacobian))] = 0.0
        rough, rows = self._compiled.roughness.rows(values)
        return (np.concatenate([residual, rough]), np.vstack([jacobian, rows])) if rough.size else (residual, jacobian)

    def _check(self, residual: Float, values: Float) -> None:
        if not np.isfinite(residual).all():
            self._compiled.rejected.add(values)

    def faint(self, values: Float) -> Bool:
        """Mark the values, Bool[free], that move the scored outputs by rounding errors only."""
        return self._faint(self._curvature(self._values(values)))

    def with_effect(self, values: Float, start: Float) -> Float:
        """Set parameters to their start if their whole effect has faded since by the share `FADED`; Float[free] each.

        Single values of a table also lose their effect when samples move to other cells.
        """
        before = self._curvature(self._values(start)).copy()
        # curvatures are squares of derivatives
        faded = self._curvature(self._values(values)) <= FADED**2 * before
        return np.where(self._sensitivity.all_of_parameter(faded), start, values)

    def sloped(self, values: Float) -> Bool | None:
        """Mark values, Bool[free], with a derivative at a scored sample, roughness aside; None if one is not finite."""
        full = self._values(values)
        if self.uses_qr:
            jacobian = self._sums.rows(full)[1]
            return _squares(jacobian) > 0 if np.isfinite(jacobian).all() else None
        curvature = self._curvature(full)
        return curvature > 0 if np.isfinite(curvature).all() else None

    def informed(self, values: Float) -> Bool:
        """Mark the values on which the cost depends, Bool[free]."""
        informed = (self.rows(values)[1] != 0).any(axis=0) if self.uses_qr else self.normal(values)[1].diagonal() > 0
        return np.asarray(informed)

    def _faint(self, curvature: Float) -> Bool:
        return self._sensitivity.faint(self._full, curvature, self._curvature)

    def _curvature(self, full: Float) -> Float:
        """Return the curvature of the data along each free value, cached for repeated calls at the end of a fit."""
        last = self._last_curvature
        if last is not None and np.array_equal(last[0], full):
            return last[1]
        curvature = (
            _squares(self._sums.rows(full)[1]) if self.uses_qr else self._sums.normal(full).matrix.diagonal().copy()
        )
        self._last_curvature = full.copy(), curvature
        return curvature

    def cholesky(self, size: int) -> Cholesky:
        """Return the factorisation for the matrix of `size` values."""
        if self._cholesky.size != size:
            self._cholesky = Cholesky(size)
        return self._cholesky

    @property
    def target_squares(self) -> float:
        """The weighted sum of squares of all targets."""
        return self._sensitivity.target_squares

    def mean_curvature(self, diagonal: Float) -> Float:
        """Return for each value, Float[free], the mean of the diagonal over its table; 0 for scalars.

        If some simulated samples are not scored, it is at least the largest curvature on all of them.
        """
        return self._sensitivity.mean_curvature(self._full, diagonal)


def _squares(jacobian: Float) -> Float:
    return np.asarray(np.einsum("ij,ij->j", jacobian, jacobian))


class _Sensitivity:
    """Finds the values of a compiled problem whose derivatives are rounding errors."""

    def __init__(self, compiled: CompiledProblem) -> None:
        self._compiled = compiled
        values = compiled.values
        starts = sorted(at for at in (*values.offsets.values(), *values.moving.values()) if at < values.free)
        self._starts = np.array(starts, dtype=np.int64)
        self._sizes = np.diff([*starts, values.free])
        self._moving = np.isin(self._starts, [*values.moving.values()])
        self._everywhere: Float | None = None

    def mean_curvature(self, values: Float, diagonal: Float) -> Float:
        """Return `LeastSquaresObjective.mean_curvature`."""
        if not self._starts.size:
            return np.zeros(diagonal.size)
        # sums over each parameter, whose values follow each other from its start
        mean = np.where(self._sizes > 1, np.add.reduceat(diagonal, self._starts) / self._sizes, 0.0)
        least = np.where(self._moving, 0.0, self.everywhere(values)[self._starts])
        return np.repeat(np.maximum(mean, least), self._sizes)

    def faint(self, values: Float, curvature: Float, curvature_at: Curvature) -> Bool:
        """Mark the free values whose effect is at the level of rounding.

        Args:
            values: the free and the fixed values, Float[values].
            curvature: that of the data along each free value there, Float[free].
            curvature_at: computes it at other values.
        """
        if not np.isfinite(curvature).all():
            return np.zeros(curvature.size, dtype=bool)
        least = np.maximum(FADED**2 * self.everywhere(values), TINY**2 * self._largest(curvature))
        faint: Bool = curvature <= least
        suspect = self._suspect(values, curvature) & ~faint
        for number in range(1, NUDGES + 1):
            if not suspect.any():
                break
            # the last digits of the free values change, each by another share, different for each number
            nudged, free = values.copy(), curvature.size
            nudged[:free] *= 1 + NUDGE * (number + np.modf(np.arange(free) * 0.618034)[0])
            unsteady = suspect & (np.abs(curvature_at(nudged) - curvature) > UNSTEADY * curvature)
            faint |= unsteady
            suspect &= ~unsteady
        return faint

    def everywhere(self, values: Float) -> Float:
        """Return the largest curvature in the parameter of each value on all simulated samples; 0 if all are scored.

        It is computed once, at the first values.
        """
        if self._everywhere is None:
            self._everywhere = np.zeros(self._compiled.values.free)
            sums = self._compiled.sums
            if sums.stateful:
                unscored = [each for each in self._compiled.each(_unscored_curvature, values) if each is not None]
                if unscored:
                    # unscored samples as if they were scored, and those that are
                    diagonal = sum(unscored) + sums.normal(values).matrix.diagonal()
                    self._everywhere = self._largest(np.nan_to_num(diagonal, posinf=0.0))
        return self._everywhere

    def all_of_parameter(self, each: Bool) -> Bool:
        """Mark the values of the parameters of which all values are marked."""
        if not each.size:
            return each
        return np.repeat(np.logical_and.reduceat(each, self._starts), self._sizes)

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
            # squares of the change of all outputs, if the value changes by its size, against those of the targets
            return np.asarray((curvature > 0) & (curvature * size**2 <= SUSPECT**2 * self.target_squares))

    @cached_property
    def target_squares(self) -> float:
        """The weighted sum of squares of all targets."""
        return float(sum(self._compiled.each(_sum_target_squares)))


def _sum_target_squares(compiled: CompiledProblem) -> float:
    scales = np.array([output.scale for output in compiled.kernel.outputs])
    return float(
        sum(
            (piece.scores / scales**2) @ np.nansum(block**2, axis=1)
            for piece in compiled.samples.pieces
            for block in _target_blocks(compiled.samples, piece)
        )
    )


def _unscored_curvature(compiled: CompiledProblem, values: Float) -> Float | None:
    """Return the curvature along each free value at the samples that are simulated only, Float[free]; None without."""
    samples = _unscored(compiled.samples)
    return None if samples is None else compiled.sums_over(samples).normal(values).matrix.diagonal().copy()


def _unscored(samples: Samples) -> Samples | None:
    """Return the samples that are simulated only, as scored ones; None without.

    What follows the last scored sample of a piece is not simulated.
    """
    targets, pieces = np.zeros((len(samples.targets), samples.count)), []
    for piece in samples.pieces:
        scored = np.hstack([np.isfinite(block) for block in _target_blocks(samples, piece)] or [np.zeros((1, 0), bool)])
        reached = np.flatnonzero(scored.any(axis=0))
        # up to the last scored sample, behind which nothing is simulated
        missing = np.flatnonzero(~scored[:, : reached[-1] + 1].all(axis=0)) if reached.size else reached
        if missing.size:
            end = int(missing[-1]) + 1
            # the other way round: a target of 0 where there was none, none where there was one
            targets[:, piece.first : piece.first + end][scored[:, :end]] = np.nan
            pieces.append(replace(piece, last=piece.first + end))
    return Samples(samples.inputs.parts, list(targets), pieces, samples.order) if pieces else None


def _target_blocks(samples: Samples, piece: Piece) -> Iterator[Float]:
    """Yield the targets of a piece in blocks, Float[outputs, samples]."""
    for first in range(piece.first, piece.last, SAMPLES_PER_BLOCK):
        yield samples.targets_of(np.arange(first, min(first + SAMPLES_PER_BLOCK, piece.last)))
