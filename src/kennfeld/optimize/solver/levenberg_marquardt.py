"""Levenberg-Marquardt: damped Gauss-Newton steps within bounds and linear limits.

Each iteration solves the convex quadratic program

    min_d  g'd + 1/2 d'(J'J + lambda D) d    subject to the limits at p + d,    g = J'r,

and accepts p + d if it lowers the cost f = r'r. The damping lambda follows the ratio of actual to predicted reduction
(H. B. Nielsen: Damping parameter in Marquardt's method, 1999). D is the diagonal of J'J with a floor, so the result
does not depend on the units of the values. A secant model adds the learnt second derivatives of the residuals to J'J
(see `SecantCorrection`); the model that predicted the last trial better proposes the next step.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from kennfeld.base.arrays import Float, Int, ignore_floating_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.costs_beside import certificate_of_costs
from kennfeld.optimize.solver.gauss_newton_model import (
    EPSILON,
    DampedModel,
    GaussNewtonModel,
    Objective,
    SecantCorrection,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import QpSolution, QuadraticProgram

Status = Literal["converged", "max_iterations", "stopped", "infeasible", "failed"]

MAX_DAMPING = 1e300  # columns of the Jacobian may be that small, and steps that long
MIN_DAMPING = 1e-3  # of `little_damping`
MAX_ACCELERATION = 0.75  # ratio of twice the geodesic acceleration to the step
PROMISED_SHARE = 0.5  # share of the cost that an almost undamped step may promise at a minimum, for example at a kink
STEEP = 0.1  # cosine between residuals and a column of J at a start; kinks of tables leave a tenth of it
LIMIT_DAMPING = 1e-9  # of the mean curvature: least damping while limits are active, keeps the digits of A H^-1 A'
SLOW_LIMIT_DAMPING = 1e-15  # the same while steps succeed, but slowly
TRIAL_TOLERANCE = 1e-10  # of a limit's scale: violation allowed to a trial, a tenth of what is promised to the user
EXACT_FIT = 1e3  # times their rounding error: residuals this small reproduce the data exactly
SLIGHT, MAX_SLOPED = 1e-3, 64  # cosine of a value with a slope, and number of those that are looked at one by one
ZERO_TABLE = 1e-12  # of the step without limits: a table this small is rounding around 0

RESTARTS = (False, True)  # see `_State.untried`
STALLED = "The cost no longer decreases."
STOPPED = "Stopped on request; these are the best values so far."
UNFULFILLED = (
    "No step lowers the cost although the gradient predicts a large decrease. Likely causes: (a) the start is far from "
    "the solution; (b) the model is discontinuous. Try another start, or set bounds."
)


@dataclass(frozen=True)
class SolverSettings:
    """Termination criteria and the initial damping.

    A descent comes to an end when `patience` steps in a row lower the cost by less than `tolerance`, relatively, or
    when the predicted reduction is below the square of `tolerance`. Small reductions at a damping above 1 do not count
    if the actual reduction is at least `damping_limited_ratio` times the predicted one: then the damping keeps them
    small.

    It has converged if the undamped step promises less than `tolerance` there, or than `doubtful_promise` if that is
    larger. Otherwise it goes on from the undamped step, with what it has learnt forgotten: first with a damping in the
    scale of the columns of J as they are, then in that of the columns on the way. The first one matters if long steps
    have made all columns smaller by many orders, as that of an exponent does: the scale of the way would damp every
    step to nothing. The second one matters if one column has shrunk, as that of a rate does where the output has
    saturated: its value would run so far that no step succeeds at a damping that lets the others move. It has converged
    if both end before they have lowered the cost by `tolerance`.
    """

    max_iterations: int = 200
    tolerance: float = 1e-8
    patience: int = 3
    damping: float = 1e-4
    damping_limited_ratio: float = 0.9
    remembers_scale: bool = False  # begin with a damping in the scale of the columns on the way
    doubtful_promise: float = 0.0


@dataclass(frozen=True)
class Iteration:
    """One line of the trace."""

    iteration: int
    cost: float
    step: float  # relative to the values' own scale
    damping: float
    active: int  # number of active bounds and rows


Report = Callable[[Iteration, Float], None]  # called after each accepted step with the new values
StageReport = Callable[[str, Iteration, Float], None]  # the same with the stage of the search


class Stop(Exception):  # noqa: N818
    """Raised by a callback to end the descent at the best values so far; its text is the message of the result.

    >>> from kennfeld import calibrate
    >>> def stop_at_once(line):
    ...     raise Stop
    >>> data = {"x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}
    >>> calibrate("y = k * x", data, {"k": 0.0}, target="m", progress=stop_at_once).status
    'stopped'
    """


@dataclass(frozen=True)
class SolverResult:
    """The end of a descent: its values, and the reason as status and sentence."""

    values: Float  # Float[values]
    cost: float
    status: Status
    message: str
    iterations: int
    evaluations: int
    damping: float = SolverSettings.damping  # of the last accepted step
    certificate: Certificate | None = None  # of `values`, unless they were moved after a descent

    def moved(self, values: Float, cost: float) -> "SolverResult":
        """Return this result with other values, which no descent has certified."""
        return replace(self, values=values, cost=cost, certificate=None)

    @property
    def cut_short(self) -> bool:
        """True if the user stopped the descent, or the model failed."""
        return self.status in ("stopped", "failed")

    def with_effort_of(self, results: "Sequence[SolverResult]") -> "SolverResult":
        """Return this result with the iterations and evaluations of all `results`."""
        if len(results) == 1 and results[0] is self:
            return self
        iterations = sum(result.iterations for result in results)
        return replace(self, iterations=iterations, evaluations=sum(result.evaluations for result in results))


def levenberg_marquardt(
    objective: Objective,
    start: Float,
    limits: LinearLimits,
    settings: SolverSettings,
    report: Report = lambda line, values: None,
) -> SolverResult:
    """Minimise a sum of squares from `start` until the cost no longer decreases.

    Args:
        objective: cost, residuals and derivatives.
        start: values that keep the limits, Float[values].
        limits: bounds and linear rows, kept at every iterate.
        settings: termination criteria.
        report: called after each accepted step with the new values; may raise `Stop`.

    Returns:
        The best values. A failure is a status of the result, never an exception.
    """
    return _LevenbergMarquardt(objective, start, limits, settings, report).run()


def certificate_at(objective: Objective, values: Float, limits: LinearLimits) -> Certificate | None:
    """Measure how far values, Float[values], are from a minimum within the limits; None without finite derivatives."""
    return _LevenbergMarquardt(objective, values, limits, SolverSettings(), lambda line, values: None).certify()


def is_rounding(objective: Objective, cost: float) -> bool:
    """Return if residuals of this cost are as small as the rounding of the targets.

    |J p| may be smaller than these: a time constant of 0 has no share in the output that it leaves as it is.
    """
    return bool(cost <= (EXACT_FIT * EPSILON) ** 2 * objective.target_squares)


@dataclass(kw_only=True)
class _State:
    """Everything that changes during a descent, grouped by when it changes."""

    # Updated when a step is accepted
    values: Float  # iterate p, all values
    cost: float = np.inf  # f(p)
    pending_secant_pair: tuple[Float, Float, Float] | None = None  # step, gradient, J'J step; until the next gradient
    # Updated by every trial
    damping: float  # lambda
    damping_growth: float = 2.0  # factor of the next rejection; doubles with each
    limit_damping: float = LIMIT_DAMPING  # least damping while limits are active, as a share of the mean curvature
    limits_hold: bool  # the last quadratic program had active limits or equalities
    use_secant: bool = False  # which of the two models proposes the next step
    active_set: Int | None = None  # warm start of the quadratic program: -1, 0 or +1 for each limit
    # Used for termination
    stalled_steps: int = 0  # accepted steps below the tolerance in a row
    limit_damping_dropped: bool = False  # the stall was answered by a lower `limit_damping` already
    remembers_scale: bool  # columns count as at least `remembered_scale`
    remembered_scale: Float | None = None  # of earlier columns, halved with each iterate
    untried: tuple[bool, ...] = RESTARTS  # choices of `remembers_scale` for another try from the same values
    certificate: Certificate | None = None  # of the last end
    # Reported
    iterations: int = 0  # accepted steps
    accepted_damping: float = SolverSettings.damping  # of the last of them
    evaluations: int = 1  # evaluations of f


class _Proposal(NamedTuple):
    """A step of the damped model within the limits."""

    damped: DampedModel
    solution: QpSolution
    target: Float  # movable values after the step
    step: Float  # of the movable values
    reduction: float  # of the cost, predicted by the model in use
    other_reduction: float  # predicted by the other model


class _Trial(NamedTuple):
    values: Float
    cost: float
    reduction: float  # actual
    lowers_cost: bool
    other_model_better: bool


class _LevenbergMarquardt:
    def __init__(
        self,
        objective: Objective,
        start: Float,
        limits: LinearLimits,
        settings: SolverSettings,
        report: Report,
    ) -> None:
        self.objective, self.settings, self.report, self.start = objective, settings, report, start
        self.movable = np.flatnonzero(limits.movable)
        self.limits = limits.restricted_to(self.movable, start)
        self.program = QuadraticProgram(self.limits)
        self.secant = SecantCorrection(self.movable.size) if objective.supports_secant else None
        limits_hold = bool(limits.rows.equal.any())
        self.state = _State(
            values=start,
            damping=settings.damping,
            limits_hold=limits_hold,
            remembers_scale=settings.remembers_scale,
        )

    def run(self) -> SolverResult:
        try:
            # once, not at each of the operations that may overflow: entering it takes as long as one of them
            with ignore_floating_errors():
                return self._search()
        except (Stop, KeyboardInterrupt) as request:
            return self._end("stopped", str(request) or STOPPED)

    def _search(self) -> SolverResult:
        state = self.state
        state.cost = self.objective.cost(state.values)
        if not np.isfinite(state.cost):
            return self._end("failed", "The cost is not a finite number at the start.")
        return self._iterate() if self.movable.size else self._end("converged", "No value is free to move.")

    def certify(self) -> Certificate | None:
        state = self.state
        with ignore_floating_errors():
            state.cost = self.objective.cost(state.values)
            if not np.isfinite(state.cost) or not self.movable.size:
                return None
            model = GaussNewtonModel(self.objective, state.values, self.movable)
            return self._certificate(model, self._undamped_step(model)) if model.finite else None

    def _iterate(self) -> SolverResult:
        state = self.state
        while state.iterations < self.settings.max_iterations:
            least_scale = state.remembered_scale if state.remembers_scale else None
            model = GaussNewtonModel(self.objective, state.values, self.movable, least_scale)
            if not model.finite:
                return self._end("failed", "A derivative of the model is not a finite number at the best values.")
            state.remembered_scale = model.remembered_scale(state.remembered_scale)
            if self.secant is not None and state.pending_secant_pair is not None:
                step, gradient, explained = state.pending_secant_pair
                self.secant.learn(step, model.gradient - gradient, explained)
                state.pending_secant_pair = None
            end = self._end_if_confirmed(model, STALLED) if self._is_stalled() else self._take_step(model)
            if end is not None:
                return end
        message = f"The cost was still decreasing after {state.iterations} iterations. Increase max_iterations."
        return self._end("max_iterations", message)

    def _take_step(self, model: GaussNewtonModel) -> SolverResult | None:
        """Increase the damping, or switch the model, until a step lowers the cost; None to go on from there.

        If none does, the descent ends, or goes on from the same values with what it has not tried yet.
        """
        state = self.state
        may_switch = True  # once for each accepted step
        while True:
            proposal = self._propose(model) if state.damping < MAX_DAMPING else None
            reason = self._reason_to_end(model, proposal)
            if reason is not None:
                if state.use_secant:  # it may be wrong: only the Gauss-Newton model may end the descent
                    state.use_secant, may_switch = False, False
                    continue
                return self._end_if_confirmed(model, reason)
            if proposal is None:  # not positive definite
                self._increase_damping()
                continue
            solution = self._accelerate(model, proposal)
            target = None if solution is None else self._target(solution, proposal)
            if solution is None or target is None:
                self._increase_damping()
                continue
            trial = self._evaluate(target, proposal)
            if trial.lowers_cost:
                # The ratio is that of the step before acceleration, whose reduction the model predicts.
                ratio = trial.reduction / proposal.reduction if proposal.reduction > 0 else 0.0
                self._accept(model, solution, trial, ratio)
                # the model that predicted this trial better proposes the next step
                state.use_secant ^= trial.other_model_better
                return None
            # the other model has its chance with the same damping, once
            if trial.other_model_better and may_switch:
                state.use_secant, may_switch = not state.use_secant, False
            else:
                self._increase_damping()

    def _reason_to_end(self, model: GaussNewtonModel, proposal: _Proposal | None) -> str | None:
        """Return why no step is worth a trial, None if one is."""
        state = self.state
        if state.damping >= MAX_DAMPING:
            return "No step lowers the cost any further."
        if proposal is None:
            return None
        if not proposal.step.any():
            return "No step changes the values any further."
        if proposal.reduction <= self.settings.tolerance**2 * state.cost and state.damping <= 1.0:
            return "The gradient is zero within the tolerance."
        # residuals that are all but rounding make r'r uncertain by twice |r| times their error
        rounding = 2 * float(np.sqrt(state.cost)) * model.rounding
        if self._fits_exactly(model) and proposal.reduction <= rounding:
            return "The cost decreases by no more than its rounding error."
        return None

    def _propose(self, model: GaussNewtonModel) -> _Proposal | None:
        """Solve the quadratic program of the model in use; None if the damped matrix is not positive definite.

        If limits turn out to be active only now, it is solved again with the damping that they need.
        """
        state, here = self.state, self._here
        while True:
            secant = self.secant if state.use_secant else None
            damped = model.damped_factor(state.damping, secant, self._least_damping)
            if damped is None:
                return None
            solution = self._within_limits(damped, damped.step, state.active_set)
            damped_for_limits = state.limits_hold
            state.limits_hold = bool(solution.active.any() or self.limits.rows.equal.any())
            # factored with the floor of the damping already, or in no need of it
            if damped_for_limits or not state.limits_hold:
                break
        state.active_set = solution.active  # kept even if the step is rejected
        target = solution.apply_to(here, self.limits)
        step = target - here
        # the cheap form, which needs no product with J'J, knows one model only
        if self.secant is None:
            plain = with_secant = model.damped_reduction(step, damped, solution.push)
        else:
            plain = model.predicted_reduction(step)
            with_secant = plain - self.secant.curvature(step)
        reductions = (with_secant, plain) if state.use_secant else (plain, with_secant)
        return _Proposal(damped, solution, target, step, *reductions)

    def _within_limits(self, damped: DampedModel, step: Float, guess: Int | None) -> QpSolution:
        """Solve the quadratic program, given its step without limits; if there are none, it needs no factor."""
        if self.program.unlimited:
            return self.program.free(step)
        return self.program.solve(damped.factor, step, self._here, guess)

    def _fits_exactly(self, model: GaussNewtonModel) -> bool:
        return bool(np.sqrt(self.state.cost) <= EXACT_FIT * model.rounding)

    def _accelerate(self, model: GaussNewtonModel, proposal: _Proposal) -> QpSolution | None:
        """Correct a Gauss-Newton step by half its geodesic acceleration; None if that is too large for the step."""
        if not self.objective.supports_acceleration or self.state.use_secant:
            return proposal.solution
        damped = proposal.damped
        acceleration = model.geodesic_acceleration(damped.factor, proposal.step)
        if not 2 * model.scaled_norm(acceleration) <= MAX_ACCELERATION * model.scaled_norm(proposal.step):
            return None
        corrected = damped.step + 0.5 * acceleration
        return self._within_limits(damped, corrected, proposal.solution.active)

    def _target(self, solution: QpSolution, proposal: _Proposal) -> Float | None:
        """Return the movable values after a step, or None if they violate rows.

        A table that limits force to 0 becomes exactly 0: what the step leaves of it is rounding, which violates rows
        between its values by as much as it is large.
        """
        here, limits = self._here, self.limits
        target = proposal.target if solution is proposal.solution else solution.apply_to(here, limits)
        if _keeps_rows(limits, here, target):
            return target
        vanished = limits.sizes(target) <= ZERO_TABLE * limits.sizes(proposal.damped.step)
        zeroed = np.where(vanished, limits.clip(np.zeros_like(target)), target)
        return zeroed if vanished.any() and _keeps_rows(limits, here, zeroed) else None

    def _evaluate(self, target: Float, proposal: _Proposal) -> _Trial:
        state = self.state
        values = state.values.copy()
        values[self.movable] = target
        cost = self.objective.cost(values)
        state.evaluations += 1
        reduction = state.cost - cost
        finite = bool(np.isfinite(cost))
        other_model_better = abs(reduction - proposal.other_reduction) < abs(reduction - proposal.reduction)
        return _Trial(values, cost, reduction, finite and cost < state.cost, finite and bool(other_model_better))

    def _accept(self, model: GaussNewtonModel, solution: QpSolution, trial: _Trial, ratio: float) -> None:
        """Move to a trial and adapt the damping to the ratio of actual to predicted reduction (Nielsen 1999)."""
        state = self.state
        step = trial.values[self.movable] - self._here
        if self.secant is not None:
            state.pending_secant_pair = step, model.gradient.copy(), model.hessian_product(step)
        relative = trial.reduction / state.cost if state.cost else 0.0
        damping_limited = state.damping > 1.0 and ratio > self.settings.damping_limited_ratio
        state.certificate = None
        if relative >= self.settings.tolerance:
            state.stalled_steps, state.limit_damping_dropped, state.untried = 0, False, RESTARTS
        elif not damping_limited:
            state.stalled_steps += 1
        step_size = model.scaled_norm(step) / max(np.sqrt(trial.cost), 1e-300)
        state.values, state.cost, state.active_set = trial.values, trial.cost, solution.active
        state.iterations += 1
        # the damping of this step, before it is adapted for the next one
        used = state.accepted_damping = state.damping
        # steps succeed as predicted while the floor holds them back
        if state.damping < state.limit_damping and ratio > self.settings.damping_limited_ratio:
            state.limit_damping = max(0.1 * state.limit_damping, SLOW_LIMIT_DAMPING)
        # lambda *= max(1/3, 1 - (2 rho - 1)^3)
        least = MIN_DAMPING * model.little_damping
        state.damping = max(state.damping * max(1 / 3, 1 - (2 * min(ratio, 2.0) - 1) ** 3), least)
        # after a rejection it doubles with each: 2, 8, 64, ... times the damping
        state.damping_growth = 2.0
        active = int(np.count_nonzero(solution.active))
        self.report(Iteration(state.iterations, trial.cost, step_size, used, active), state.values)

    def _increase_damping(self) -> None:
        self.state.damping *= self.state.damping_growth
        self.state.damping_growth *= 2.0
        self.state.limit_damping = min(10 * self.state.limit_damping, LIMIT_DAMPING)

    @property
    def _here(self) -> Float:
        return self.state.values[self.movable]

    @property
    def _least_damping(self) -> float:
        """Least damping while limits are active.

        Limits tie values that are not determined by data to those that are, and the smaller the curvature of the
        former, the fewer digits remain of the latter. If smoothness outweighs data that alone determine a slope, the
        same damping makes steps tiny: it falls while they succeed and rises again with the first that does not.
        """
        return self.state.limit_damping if self.state.limits_hold else 0.0

    def _is_stalled(self) -> bool:
        """Return if the last steps gained too little; with limits, only if less damping has not helped either."""
        state = self.state
        if state.stalled_steps < self.settings.patience:
            return False
        if state.limits_hold and state.damping < state.limit_damping and not state.limit_damping_dropped:
            state.limit_damping, state.limit_damping_dropped = SLOW_LIMIT_DAMPING, True
            return False
        return True

    def _end_if_confirmed(self, model: GaussNewtonModel, message: str) -> SolverResult | None:
        """End as converged where the undamped step promises nothing, or was tried; otherwise go on.

        The descent has failed if trying has not helped though it promises to halve a cost that is not rounding, or if
        no step at all was possible from a steep start; unless the cost rises to both sides of each value.
        """
        state = self.state
        # columns on the way would hide a gradient, see `certificate`
        if state.remembers_scale:
            model = GaussNewtonModel(self.objective, state.values, self.movable)
        step = self._undamped_step(model)
        state.certificate = self._certificate(model, step)
        # an end whose model cannot be factored promises everything
        slope, promise = (1.0, 1.0) if state.certificate is None else state.certificate[:2]
        # before the end is believed, a descent from the undamped step has to fail
        if promise > max(self.settings.tolerance, self.settings.doubtful_promise) and state.untried:
            self._restart(model)
            return None
        failed = promise > PROMISED_SHARE or (state.iterations == 0 and slope > STEEP)
        if failed and is_rounding(self.objective, state.cost):
            state.certificate = Certificate(0.0, 0.0)
        elif failed:
            by_costs = self._certificate_by_costs(model)
            if by_costs is None or by_costs.predicted_decrease > PROMISED_SHARE:
                state.certificate = Certificate(slope, promise)
                return self._end("failed", UNFULFILLED)
            state.certificate = by_costs
        return self._end("converged", message)

    def _restart(self, model: GaussNewtonModel) -> None:
        """Go on from the same values with the undamped step, and without the secant model."""
        state = self.state
        state.remembers_scale, state.untried = state.untried[0], state.untried[1:]
        state.stalled_steps, state.damping, state.damping_growth = 0, model.little_damping, 2.0
        state.use_secant, state.pending_secant_pair = False, None
        if self.secant is not None:
            self.secant = SecantCorrection(self.movable.size)

    def _undamped_step(self, model: GaussNewtonModel) -> Float | None:
        """Return the step of the undamped model within the limits; None if its matrix cannot be factored."""
        damped = model.damped_factor(model.little_damping, least=self._least_damping)
        if damped is None or not np.all(np.isfinite(damped.step)):
            return None
        return self._within_limits(damped, damped.step, self.state.active_set).step

    def _certificate(self, model: GaussNewtonModel, step: Float | None) -> Certificate | None:
        """Return how far the iterate is from stationary; None if that is unknown."""
        if self._fits_exactly(model):
            return Certificate(0.0, 0.0)
        return None if step is None else Certificate.of(model, step, self.state.cost)

    def _certificate_by_costs(self, model: GaussNewtonModel) -> Certificate | None:
        """Return the certificate by costs beside the values with a slope; None without a minimum there."""
        state = self.state
        with np.errstate(all="ignore"):
            slopes = np.abs(model.gradient) / np.sqrt(model.diagonal * state.cost)
        sloped = np.flatnonzero(slopes > SLIGHT)
        if state.limits_hold or sloped.size > MAX_SLOPED:
            return None
        here = self._here
        # a value that has run to 0 keeps the size that it had at the start
        sizes = np.maximum(np.abs(here), np.abs(self.start[self.movable]))
        sizes[sizes == 0] = 1.0
        return certificate_of_costs(self._cost_at, here, state.cost, sizes, sloped.tolist(), self.limits)

    def _cost_at(self, target: Float) -> float:
        """Return the cost with other movable values."""
        values = self.state.values.copy()
        values[self.movable] = target
        return self.objective.cost(values)

    def _end(self, status: Status, message: str) -> SolverResult:
        state = self.state
        effort = state.iterations, state.evaluations
        return SolverResult(
            state.values, state.cost, status, message, *effort, state.accepted_damping, state.certificate
        )


def _keeps_rows(limits: LinearLimits, here: Float, target: Float) -> bool:
    """Return if a step keeps the rows; rounding is relative to the sizes at both of its ends."""
    if limits.keeps(target):
        return True
    sizes = np.maximum(limits.sizes(here), limits.sizes(target))
    return bool(np.all(limits.violations(target, sizes) <= TRIAL_TOLERANCE))
