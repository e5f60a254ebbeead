"""The cost of a compiled problem as a function of its free values."""

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.native.cholesky import Cholesky
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.linear_limits import breakpoint_order, is_ordered
from kennfeld.optimize.sensitivity import Sensitivity

SMALL_VALUES, SMALL_ENTRIES = 64, 1_000_000  # up to these sizes the Jacobian itself is factored
MAX_SECANT_VALUES = 128


class LeastSquaresObjective:
    """Data cost plus roughness; see `gauss_newton_model.Objective`.

    Derivatives that are rounding errors count as 0, so that no value moves by them (see `Sensitivity`).
    """

    def __init__(self, compiled: CompiledProblem, *, by_rows: bool = True) -> None:
        """Without `by_rows`, normal equations are used for small problems too: faster, with half the digits."""
        self._compiled = compiled
        self._full = compiled.start.copy()
        self._free = compiled.values.free
        self._order = breakpoint_order(compiled.problem.free_axes, compiled.values)
        entries = compiled.samples.count * len(compiled.kernel.outputs) * self._free
        self._small = by_rows and self._free <= SMALL_VALUES and entries <= SMALL_ENTRIES
        self._sensitivity = Sensitivity(compiled)
        self._last_curvature: tuple[Float, Float] | None = None  # the values it belongs to, and itself
        self._cholesky = Cholesky(0 if self._small else self._free)
        if not self._small:
            compiled.accumulator.prepare()

    @property
    def uses_qr(self) -> bool:
        """True if the Jacobian itself is factored."""
        return self._small

    @property
    def supports_acceleration(self) -> bool:
        """True if `rows` gives the curvature of the residuals; a robust loss would change their weights."""
        return self._small and all(output.loss == "square" for output in self._compiled.kernel.outputs)

    @property
    def supports_secant(self) -> bool:
        """True for few values: the secant matrix is dense, and large tables have more kinks than curvature."""
        return self._free <= MAX_SECANT_VALUES

    @property
    def start(self) -> Float:
        """The free values at the start."""
        return self._compiled.start[: self._free].copy()

    def _values(self, free: Float) -> Float:
        self._full[: self._free] = free
        return self._full

    def cost(self, values: Float) -> float:
        """Return the sum of losses plus roughness; infinite if breakpoints are out of order."""
        if not is_ordered(self._order, values):
            return np.inf
        cost = self._compiled.accumulator.cost(self._values(values)) + self._compiled.roughness.cost(values)
        if not np.isfinite(cost):
            self._compiled.rejected.add(values)
        return cost

    def normal(self, values: Float) -> tuple[Float, Float]:
        """Return half the gradient and the Gauss-Newton matrix."""
        accumulator, roughness = self._compiled.accumulator, self._compiled.roughness
        found = accumulator.normal(self._values(values))
        diagonal = np.diag(found.matrix).copy()
        faint = self._faint(diagonal) & (diagonal > 0)
        if faint.any():
            found = accumulator.normal(self._full)  # judging may have computed it elsewhere
            found.gradient[faint] = 0.0
            found.matrix[faint, :] = 0.0
            found.matrix[:, faint] = 0.0
        roughness.add(values, found.gradient, found.matrix)
        return found.gradient, found.matrix

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Return residuals and Jacobian, with those of the roughness below."""
        residual, jacobian = self._compiled.accumulator.rows(self._values(values))
        if not np.all(np.isfinite(residual)):
            self._compiled.rejected.add(values)
        jacobian[:, self._faint(_squares(jacobian))] = 0.0
        rough, rows = self._compiled.roughness.rows(values)
        return np.concatenate([residual, rough]), np.vstack([jacobian, rows])

    def faint(self, values: Float) -> Bool:
        """Mark the values that move the scored outputs by rounding errors only."""
        return self._faint(self._curvature(self._values(values)))

    def sloped(self, values: Float) -> Bool | None:
        """Mark the values with a derivative at a scored sample, without roughness; None if one is not finite."""
        accumulator, full = self._compiled.accumulator, self._values(values)
        if self._small:
            jacobian = accumulator.rows(full)[1]
            return (jacobian != 0).any(axis=0) if np.isfinite(jacobian).all() else None
        curvature = self._curvature(full)
        return curvature > 0 if np.isfinite(curvature).all() else None

    def _faint(self, curvature: Float) -> Bool:
        return self._sensitivity.faint(self._full, curvature, self._curvature)

    def _curvature(self, full: Float) -> Float:
        """Return the curvature of the data along each free value, cached for repeated calls at the end of a fit."""
        last = self._last_curvature
        if last is not None and np.array_equal(last[0], full):
            return last[1]
        accumulator = self._compiled.accumulator
        found = _squares(accumulator.rows(full)[1]) if self._small else np.diag(accumulator.normal(full).matrix).copy()
        self._last_curvature = full.copy(), found
        return found

    def cholesky(self, size: int) -> Cholesky:
        """Return the factorisation for the matrix of `size` values."""
        if self._cholesky.size != size:
            self._cholesky = Cholesky(size)
        return self._cholesky

    def mean_curvature(self, diagonal: Float) -> Float:
        """Return for each value the mean of the diagonal over its table; 0 for scalars.

        If some simulated samples are not scored, it is at least the largest curvature on all of them.
        """
        mean = np.zeros(self._free)
        for name, at in self._compiled.values.offsets.items():
            if at < self._free:
                size = self._compiled.problem.parameters[name].size
                part = slice(at, at + size)
                own = diagonal[part].mean() if size > 1 else 0.0
                mean[part] = max(own, self._sensitivity.everywhere(self._full)[at])
        for key, at in self._compiled.values.moving.items():
            if at < self._free:
                part = slice(at, at + len(self._compiled.problem.free_axes[key].axis))
                mean[part] = diagonal[part].mean()
        return mean


def _squares(jacobian: Float) -> Float:
    """Return the sum of squares of each column."""
    found: Float = np.einsum("ij,ij->j", jacobian, jacobian)
    return found
