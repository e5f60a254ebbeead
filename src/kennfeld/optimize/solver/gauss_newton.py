"""Gauss-Newton with Levenberg-Marquardt damping, within limits.

Every iteration solves a convex quadratic program in the damped Gauss-Newton model. The damping follows the ratio of
actual to predicted gain (H. B. Nielsen, Damping parameter in Marquardt's method, 1999); it is measured in each value's
own scale, the diagonal of the Gauss-Newton matrix with a floor, so values of any unit are treated alike.
Small problems are factored by QR of the Jacobian, which keeps the digits that the normal equations square away.
Where the residuals' own curvature matters, a second model adds what `Secant` has learnt of it; of the two, the one that
predicted the last trial better is in use.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.native import Cholesky, Factor
from kennfeld.optimize.limits.limits import Limits
from kennfeld.optimize.solver.quadratic import Solution, solve
from kennfeld.optimize.solver.secant import Secant

__all__ = ["Descent", "Iteration", "Objective", "Settings", "Status", "Stop", "gauss_newton"]

Status = Literal["converged", "max_iterations", "stopped", "infeasible", "failed"]


class Objective(Protocol):
    """A sum of squares and what the solver needs of it. Gradients are halved: J'Wr."""

    @property
    def small(self) -> bool:
        """Whether `rows` fits memory and its digits are worth a QR."""

    @property
    def bends(self) -> bool:
        """Whether `rows` changes smoothly enough to measure the curvature of the residuals."""

    @property
    def learns(self) -> bool:
        """Whether the residuals' second derivatives are worth a dense matrix of all values."""

    def cost(self, values: Float) -> float:
        """The cost; not finite where the model fails."""

    def normal(self, values: Float) -> tuple[Float, Float]:
        """Half the gradient, and the Gauss-Newton matrix. They hold until the next call."""

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Weighted residuals and their Jacobian."""

    def mean_curvature(self, diagonal: Float) -> Float:
        """For each value the mean over its table of the diagonal of the Gauss-Newton matrix; 0 for scalars."""

    def cholesky(self, size: int) -> Cholesky:
        """What factors the matrix of `size` of its values; it knows the zeros of those before."""


@dataclass(frozen=True)
class Settings:
    """When to stop, and where the damping starts.

    A descent has converged when `patience` steps in a row lower the cost by less than `tolerance`, relatively, or when
    the predicted gain is below the square of `tolerance`. Small gains under heavy damping do not count where the actual
    gain is at least `trusted` times the predicted one: then it is the damping that keeps them small.
    """

    max_iterations: int = 200
    tolerance: float = 1e-8
    patience: int = 3
    damping: float = 1e-4
    trusted: float = 0.9


@dataclass(frozen=True)
class Iteration:
    """One line of the trace."""

    iteration: int
    cost: float
    step: float  # relative to the values' own scale
    damping: float
    active: int


class Stop(Exception):  # noqa: N818
    """Raised by a callback to end the descent at the best values so far."""


@dataclass(frozen=True)
class Descent:
    """Where a descent ended, and why."""

    values: Float
    cost: float
    status: Status
    message: str
    iterations: int
    evaluations: int


MEMORY = 0.5  # share of a value's scale that it keeps at least from one iteration to the next
MOST_DAMPING = 1e40  # steps have vanished long before
PROBE = 0.1  # share of a step at which its curvature is measured
MOST_BEND = 0.75
LITTLE_DAMPING = 1e-12
PROMISED = 0.5  # share of the cost that a step with little damping may promise to gain at a minimum, say at a crease
FLOOR = 1e-6  # of the mean curvature in its table: the least scale of a value, so that it does not run away
HELD = 1e-9  # of the mean curvature: the least damping where limits hold, so that their products keep their digits
FEASIBLE = 1e-10  # of a limit's scale: what a trial step may miss it by, a tenth of what is promised
EXACT = 1e3  # times the rounding of the residuals: a model with residuals this small reproduces the data exactly
SOLVED = 1e-12  # share of the first cost that is mere rounding where residuals vanish


class _Linearised:
    """The Gauss-Newton model at one point: gradient, matrix or triangular factor, and the values' scales."""

    def __init__(self, objective: Objective, at: Float, movable: Int, scale: Float | None) -> None:
        self.movable = movable
        self.objective, self.at = objective, at
        if objective.small:
            residual, jacobian = objective.rows(at)
            jacobian = jacobian[:, movable]
            self.residual, self.jacobian = residual, jacobian
            self.root, self.rotated = _triangle(jacobian, residual)
            self.matrix: Float | None = None
            self.gradient = jacobian.T @ residual
            diagonal = np.einsum("ij,ij->j", jacobian, jacobian)
        else:
            gradient, matrix = objective.normal(at)
            everything = movable.size == at.size
            self.gradient = gradient if everything else gradient[movable]
            self.matrix = matrix if everything else matrix[np.ix_(movable, movable)]
            diagonal = np.diag(self.matrix)
        self.diagonal = diagonal
        full = np.zeros(at.size)
        full[movable] = diagonal
        mean = objective.mean_curvature(full)[movable]
        self.scale = np.maximum(diagonal, FLOOR * mean)
        self.scale[self.scale <= 0] = 1.0
        if scale is not None:
            self.scale = np.maximum(self.scale, MEMORY * scale)
        self.curvature = np.maximum(self.scale, mean)

    @property
    def finite(self) -> bool:
        return bool(np.all(np.isfinite(self.gradient)) and np.all(np.isfinite(self.scale)))

    @property
    def rounding(self) -> float:
        """How exactly the residuals are known: they are differences of predictions of the size |J p|."""
        return float(np.finfo(float).eps * np.linalg.norm(np.sqrt(self.diagonal) * self.at[self.movable]))

    def factor(self, damping: float, secant: Secant | None = None, *, held: bool) -> tuple[Factor, Float] | None:
        """Factor of the damped matrix and the step without limits; None where it is not positive definite.

        Where limits hold, `held`, the damping has a floor: limits tie values that no data inform to those that data
        do, and the smaller the curvature of the former, the fewer digits are left of the latter.
        """
        damped = np.maximum(damping * self.scale, HELD * self.curvature) if held else damping * self.scale
        if secant is not None:
            whole = (self.root.T @ self.root if self.matrix is None else self.matrix) + secant.matrix
            curved = Cholesky(self.movable.size).factor(whole, damped)
            return None if curved is None else (curved, curved.solve(-self.gradient))
        if self.matrix is not None:
            factor = self.objective.cholesky(self.movable.size).factor(self.matrix, damped)
            return None if factor is None else (factor, factor.solve(-self.gradient))
        stacked = np.vstack([self.root, np.diag(np.sqrt(damped))])
        upper, rotated = _triangle(stacked, np.concatenate([self.rotated, np.zeros(self.scale.size)]))
        diagonal = np.abs(np.diag(upper))
        if diagonal.min(initial=1.0) <= 0:
            return None
        sign = np.where(np.diag(upper) < 0, -1.0, 1.0)
        lower = np.ascontiguousarray((sign[:, None] * upper).T)
        return Factor.of(lower), np.asarray(np.linalg.solve(upper, -rotated), dtype=np.float64)

    def bend(self, factor: Factor, step: Float) -> Float:
        """Geodesic acceleration: the correction of a step for the curvature of the residuals along it.

        M. Transtrum, J. Sethna: Improvements to the Levenberg-Marquardt algorithm, 2012. Small problems only.
        """
        trial = self.at.copy()
        trial[self.movable] += PROBE * step
        ahead, _ = self.objective.rows(trial)
        if not np.all(np.isfinite(ahead)):
            return np.full(step.size, np.inf)
        curved = (2 / PROBE) * ((ahead - self.residual) / PROBE - self.jacobian @ step)
        return factor.solve(-(self.jacobian.T @ curved))

    def explained(self, step: Float) -> Float:
        """Change of the gradient over a step that the Gauss-Newton matrix predicts."""
        return self.root.T @ (self.root @ step) if self.matrix is None else self.matrix @ step

    def gain(self, step: Float) -> float:
        """Predicted decrease of the cost."""
        bend = np.sum((self.root @ step) ** 2) if self.matrix is None else step @ (self.matrix @ step)
        return float(-2 * (self.gradient @ step) - bend)

    def length(self, step: Float) -> float:
        """Length of a step in the values' own scales."""
        with np.errstate(over="ignore"):
            return float(np.sqrt(np.sum(self.scale * step * step)))


def _keeps(limits: Limits, here: Float, trial: Float) -> bool:
    """Whether a trial keeps the rows; rounding is that of the sizes on both ends of the step."""
    if not limits.rows.count:
        return True
    sizes = np.maximum(limits.sizes(here), limits.sizes(trial))
    return bool(np.all(limits.violations(trial, sizes) <= FEASIBLE))


def _triangle(jacobian: Float, residual: Float) -> tuple[Float, Float]:
    """R and Q'r of a QR factorisation; rows of zeros are added where there are fewer than columns."""
    missing = max(jacobian.shape[1] - jacobian.shape[0], 0)
    if missing:
        jacobian = np.vstack([jacobian, np.zeros((missing, jacobian.shape[1]))])
        residual = np.concatenate([residual, np.zeros(missing)])
    q, r = np.linalg.qr(jacobian)
    return r, q.T @ residual


def gauss_newton(
    objective: Objective,
    start: Float,
    limits: Limits,
    settings: Settings,
    report: Callable[[Iteration, Float], None] = lambda line, values: None,
) -> Descent:
    """Descend from `start`, which keeps the limits, until the cost settles.

    `report` is called after each accepted step with the values; it may raise `Stop`. What ends the descent is a value
    of the result, never an exception.
    """
    return _Descending(objective, start, limits, settings, report).run()


class _Descending:
    """The running state of a descent."""

    def __init__(
        self,
        objective: Objective,
        start: Float,
        limits: Limits,
        settings: Settings,
        report: Callable[[Iteration, Float], None],
    ) -> None:
        self.objective, self.limits, self.settings, self.report = objective, limits, settings, report
        self.at = start
        self.cost = self.first_cost = np.inf
        self.evaluations = 1
        self.iterations = 0
        self.damping = settings.damping
        self.growth = 2.0
        self.calm = 0
        self.active: Int | None = None
        self.held = bool(limits.rows.equal.any())
        self.scale: Float | None = None
        self.secant: Secant | None = None
        self.curved = False
        self.last: tuple[Float, Float, Float] | None = None

    def run(self) -> Descent:
        movable = np.flatnonzero(self.limits.movable)
        try:
            self.cost = self.first_cost = self.objective.cost(self.at)
            if not np.isfinite(self.cost):
                return self._end("failed", "The cost is not a finite number at the start.")
            if not movable.size:
                return self._end("converged", "No value is free to move.")
            return self._iterate(movable)
        except (Stop, KeyboardInterrupt):
            return self._end("stopped", "Stopped on request; these are the best values so far.")

    def _iterate(self, movable: Int) -> Descent:
        narrow = self.limits.narrowed(movable, self.at)
        if self.objective.learns:
            self.secant = Secant(movable.size)
        while self.iterations < self.settings.max_iterations:
            line = _Linearised(self.objective, self.at, movable, self.scale)
            self.scale = line.scale
            if not line.finite:
                return self._end("failed", "A derivative of the model is not a finite number at the best values.")
            self._learn(line)
            end = self._descend(line, narrow)
            if end is not None:
                return end
        return self._end(
            "max_iterations", "The cost was still falling when the iterations ran out; raise max_iterations."
        )

    def _learn(self, line: _Linearised) -> None:
        if self.secant is not None and self.last is not None:
            step, gradient, explained = self.last
            self.secant.learn(step, line.gradient - gradient, explained)
            self.last = None

    def _descend(self, line: _Linearised, limits: Limits) -> Descent | None:
        """Raise the damping, or change the model, until a step lowers the cost; None to go on from there."""
        here = self.at[line.movable]
        may_switch = True
        while self.damping < MOST_DAMPING:
            found = self._solved(line, here, limits)
            if found is None:
                self._harder()
                continue
            factor, free_step, solution = found
            self.active = solution.active
            step = solution.reached(here, limits) - here
            gain, other = self._gains(line, step)
            if not step.any():
                return self._stuck(line, limits, "No step changes the values any further.")
            if gain <= self.settings.tolerance**2 * self.cost and self.damping <= 1.0:
                if not self.curved:
                    return self._end("converged", "The gradient is zero within the tolerance.")
                # What was learnt may be wrong: the Gauss-Newton model alone decides that this is the end.
                self.curved, may_switch = False, False
                continue
            if self._exact(line, gain):
                return self._stuck(line, limits, "The cost falls by no more than its rounding error.")
            if self.objective.bends and not self.curved:
                bend = line.bend(factor, step)
                if not 2 * line.length(bend) <= MOST_BEND * line.length(step):
                    self._harder()
                    continue
                solution = solve(factor, free_step + 0.5 * bend, here, limits, solution.active)
            trial = self.at.copy()
            trial[line.movable] = solution.reached(here, limits)
            if not _keeps(limits, here, trial[line.movable]):
                self._harder()
                continue
            cost = self.objective.cost(trial)
            self.evaluations += 1
            actual = self.cost - cost
            worse = np.isfinite(cost) and abs(actual - other) < abs(actual - gain)
            if np.isfinite(cost) and cost < self.cost:
                if self.secant is not None:
                    step = trial[line.movable] - here
                    self.last = (step, line.gradient.copy(), line.explained(step))
                self._accept(line, solution, trial, cost, actual / gain if gain > 0 else 0.0)
                self.curved ^= worse
                return self._settled()
            if worse and may_switch:
                self.curved, may_switch = not self.curved, False
            else:
                self._harder()
        return self._stuck(line, limits, "No step lowers the cost any further.")

    def _exact(self, line: _Linearised, gain: float) -> bool:
        """Whether residuals are all but rounding, of which the cost r'r is uncertain by twice |r| times theirs."""
        size, rounding = float(np.sqrt(self.cost)), line.rounding
        return size <= EXACT * rounding and gain <= 2 * size * rounding

    def _solved(self, line: _Linearised, here: Float, limits: Limits) -> tuple[Factor, Float, Solution] | None:
        """The factor of the damped model, its step without limits, and the solution within them."""
        while True:
            found = line.factor(self.damping, self.secant if self.curved else None, held=self.held)
            if found is None:
                return None
            solution = solve(*found, here, limits, self.active)
            before, self.held = self.held, bool(solution.active.any() or limits.rows.equal.any())
            if before or not self.held:
                return *found, solution

    def _stuck(self, line: _Linearised, limits: Limits, message: str) -> Descent:
        """The end where damping leaves no step: at a minimum, or where all but the shortest steps lead astray."""
        found = line.factor(LITTLE_DAMPING, held=self.held) if self.cost > SOLVED * self.first_cost else None
        if found is not None and np.all(np.isfinite(found[1])):
            step = solve(*found, self.at[line.movable], limits, self.active).step
            if line.gain(step) > PROMISED * self.cost:
                return self._end(
                    "failed",
                    "No step lowers the cost, though its slopes promise much: the values are too far from what the "
                    "data ask for, or the model jumps. Start from other values, or give bounds.",
                )
        return self._end("converged", message)

    def _gains(self, line: _Linearised, step: Float) -> tuple[float, float]:
        """Gain of a step predicted by the model in use, and by the other one."""
        plain = line.gain(step)
        curved = plain if self.secant is None else plain - self.secant.bend(step)
        return (curved, plain) if self.curved else (plain, curved)

    def _harder(self) -> None:
        self.damping *= self.growth
        self.growth *= 2.0

    def _accept(self, line: _Linearised, solution: Solution, trial: Float, cost: float, ratio: float) -> None:
        relative = (self.cost - cost) / self.cost if self.cost else 0.0
        held_back = self.damping > 1.0 and ratio > self.settings.trusted
        if relative >= self.settings.tolerance:
            self.calm = 0
        elif not held_back:
            self.calm += 1
        size = line.length(trial[line.movable] - self.at[line.movable]) / max(np.sqrt(cost), 1e-300)
        self.at, self.cost, self.active = trial, cost, solution.active
        self.iterations += 1
        used = self.damping
        self.damping = max(self.damping * max(1 / 3, 1 - (2 * min(ratio, 2.0) - 1) ** 3), 1e-15)
        self.growth = 2.0
        self.report(Iteration(self.iterations, cost, size, used, int(np.count_nonzero(solution.active))), self.at)

    def _settled(self) -> Descent | None:
        if self.calm >= self.settings.patience:
            return self._end("converged", "The cost no longer falls.")
        return None

    def _end(self, status: Status, message: str) -> Descent:
        return Descent(self.at, self.cost, status, message, self.iterations, self.evaluations)
