"""Gauss-Newton with Levenberg-Marquardt damping, within limits.

Every iteration solves a convex quadratic program in the damped Gauss-Newton model. The damping follows the ratio of
actual to predicted gain (H. B. Nielsen, Damping parameter in Marquardt's method, 1999); it is measured in each value's
own scale, the diagonal of the Gauss-Newton matrix with a floor, so values of any unit are treated alike.
Where the residuals' own curvature matters, a second model adds what `Secant` has learnt of it; of the two, the one that
predicted the last trial better is in use.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.native import Factor
from kennfeld.optimize.solver.gauss_newton_model import GaussNewtonModel, Objective, SecantCorrection
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import QpSolution, solve

__all__ = ["Iteration", "SolverResult", "SolverSettings", "Status", "Stop", "levenberg_marquardt"]

Status = Literal["converged", "max_iterations", "stopped", "infeasible", "failed"]

MOST_DAMPING = 1e40  # steps have vanished long before
MOST_BEND = 0.75
LITTLE_DAMPING = 1e-12
PROMISED = 0.5  # share of the cost that a step with little damping may promise to gain at a minimum, say at a crease
HELD = 1e-9  # of the mean curvature: the least damping where limits hold, so that their products keep their digits
LEAST_HELD = 1e-15  # the same where steps go on, but slowly
FEASIBLE = 1e-10  # of a limit's scale: what a trial step may miss it by, a tenth of what is promised
EXACT = 1e3  # times the rounding of the residuals: a model with residuals this small reproduces the data exactly
SOLVED = 1e-12  # share of the first cost that is mere rounding where residuals vanish
NOTHING = 1e-12  # of the step without limits: a table this small is rounding around 0


@dataclass(frozen=True)
class SolverSettings:
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
class SolverResult:
    """Where a descent ended, and why."""

    values: Float
    cost: float
    status: Status
    message: str
    iterations: int
    evaluations: int


def _keeps(limits: LinearLimits, here: Float, trial: Float) -> bool:
    """Whether a trial keeps the rows; rounding is that of the sizes on both ends of the step."""
    if limits.keeps(trial):
        return True
    sizes = np.maximum(limits.sizes(here), limits.sizes(trial))
    return bool(np.all(limits.violations(trial, sizes) <= FEASIBLE))


def _kept(limits: LinearLimits, here: Float, trial: Float, free_step: Float) -> Float | None:
    """The trial if it keeps the rows, else None; a table that limits force to 0 becomes exactly 0.

    What the step leaves of such a table is rounding, which breaks rows between its values by as much as it is large.
    """
    if _keeps(limits, here, trial):
        return trial
    nothing = limits.sizes(trial) <= NOTHING * limits.sizes(free_step)
    zeroed = np.where(nothing, limits.clip(np.zeros_like(trial)), trial)
    return zeroed if nothing.any() and _keeps(limits, here, zeroed) else None


def levenberg_marquardt(
    objective: Objective,
    start: Float,
    limits: LinearLimits,
    settings: SolverSettings,
    report: Callable[[Iteration, Float], None] = lambda line, values: None,
) -> SolverResult:
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
        limits: LinearLimits,
        settings: SolverSettings,
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
        self.floor = HELD
        self.lowered = False
        self.scale: Float | None = None
        self.secant: SecantCorrection | None = None
        self.curved = False
        self.last: tuple[Float, Float, Float] | None = None

    def run(self) -> SolverResult:
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

    def _iterate(self, movable: Int) -> SolverResult:
        narrow = self.limits.narrowed(movable, self.at)
        if self.objective.learns:
            self.secant = SecantCorrection(movable.size)
        while self.iterations < self.settings.max_iterations:
            line = GaussNewtonModel(self.objective, self.at, movable, self.scale)
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

    def _learn(self, line: GaussNewtonModel) -> None:
        if self.secant is not None and self.last is not None:
            step, gradient, explained = self.last
            self.secant.learn(step, line.gradient - gradient, explained)
            self.last = None

    def _descend(self, line: GaussNewtonModel, limits: LinearLimits) -> SolverResult | None:
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
            reached = _kept(limits, here, solution.reached(here, limits), free_step)
            if reached is None:
                self._harder()
                continue
            trial = self.at.copy()
            trial[line.movable] = reached
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

    def _exact(self, line: GaussNewtonModel, gain: float) -> bool:
        """Whether residuals are all but rounding, of which the cost r'r is uncertain by twice |r| times theirs."""
        size, rounding = float(np.sqrt(self.cost)), line.rounding
        return size <= EXACT * rounding and gain <= 2 * size * rounding

    def _solved(
        self, line: GaussNewtonModel, here: Float, limits: LinearLimits
    ) -> tuple[Factor, Float, QpSolution] | None:
        """The factor of the damped model, its step without limits, and the solution within them."""
        while True:
            found = line.factor(self.damping, self.secant if self.curved else None, self._least_damping)
            if found is None:
                return None
            solution = solve(*found, here, limits, self.active)
            before, self.held = self.held, bool(solution.active.any() or limits.rows.equal.any())
            if before or not self.held:
                return *found, solution

    def _stuck(self, line: GaussNewtonModel, limits: LinearLimits, message: str) -> SolverResult:
        """The end where damping leaves no step: at a minimum, or where all but the shortest steps lead astray."""
        found = line.factor(LITTLE_DAMPING, floor=self._least_damping) if self.cost > SOLVED * self.first_cost else None
        if found is not None and np.all(np.isfinite(found[1])):
            step = solve(*found, self.at[line.movable], limits, self.active).step
            if line.gain(step) > PROMISED * self.cost:
                return self._end(
                    "failed",
                    "No step lowers the cost, though its slopes promise much: the values are too far from what the "
                    "data ask for, or the model jumps. Start from other values, or give bounds.",
                )
        return self._end("converged", message)

    def _gains(self, line: GaussNewtonModel, step: Float) -> tuple[float, float]:
        """Gain of a step predicted by the model in use, and by the other one."""
        plain = line.gain(step)
        curved = plain if self.secant is None else plain - self.secant.bend(step)
        return (curved, plain) if self.curved else (plain, curved)

    @property
    def _least_damping(self) -> float:
        """The floor of the damping where limits hold.

        They tie values that no data inform to those that data do, and the smaller the curvature of the former, the
        fewer digits are left of the latter. Where smoothness outweighs data that alone tell a slope, the same floor
        makes steps tiny: it falls while they succeed, and rises again with the first that does not.
        """
        return self.floor if self.held else 0.0

    def _harder(self) -> None:
        self.damping *= self.growth
        self.growth *= 2.0
        self.floor = min(10 * self.floor, HELD)

    def _accept(self, line: GaussNewtonModel, solution: QpSolution, trial: Float, cost: float, ratio: float) -> None:
        relative = (self.cost - cost) / self.cost if self.cost else 0.0
        held_back = self.damping > 1.0 and ratio > self.settings.trusted
        if relative >= self.settings.tolerance:
            self.calm, self.lowered = 0, False
        elif not held_back:
            self.calm += 1
        size = line.length(trial[line.movable] - self.at[line.movable]) / max(np.sqrt(cost), 1e-300)
        self.at, self.cost, self.active = trial, cost, solution.active
        self.iterations += 1
        used = self.damping
        if self.damping < self.floor and ratio > self.settings.trusted:
            self.floor = max(0.1 * self.floor, LEAST_HELD)
        self.damping = max(self.damping * max(1 / 3, 1 - (2 * min(ratio, 2.0) - 1) ** 3), 1e-15)
        self.growth = 2.0
        self.report(Iteration(self.iterations, cost, size, used, int(np.count_nonzero(solution.active))), self.at)

    def _settled(self) -> SolverResult | None:
        if self.calm < self.settings.patience:
            return None
        if self.held and self.damping < self.floor and not self.lowered:
            self.floor, self.lowered = LEAST_HELD, True
            return None
        return self._end("converged", "The cost no longer falls.")

    def _end(self, status: Status, message: str) -> SolverResult:
        return SolverResult(self.at, self.cost, status, message, self.iterations, self.evaluations)
