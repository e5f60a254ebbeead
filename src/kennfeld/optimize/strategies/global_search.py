"""Global search without gradients, for discontinuous costs: CMA-ES within bounds, with restarts.

If the values of a model shift its events in time (a governor triggered by the crank, a relay, quantised code), its cost
is a step function whose exact derivatives miss the steps. The covariance matrix adaptation evolution strategy
(N. Hansen, A. Ostermeier: Completely Derandomized Self-Adaptation in Evolution Strategies, 2001) only compares costs.
The first run begins at the start, later ones anywhere within the bounds. Runs with populations that double alternate
with runs of the smallest one, so that both take as many evaluations: the former follow the widest valley, the latter
find narrow ones (N. Hansen: Benchmarking a BI-Population CMA-ES on the BBOB-2009 Function Testbed, 2009). A descent
from the best values ends the search.

Under output limits, the lower cost wins between two feasible points, the smaller violation between two infeasible ones,
and a feasible point over an infeasible one (K. Deb: An efficient constraint handling method for genetic algorithms,
2000).
"""

import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Protocol

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.solver.gauss_newton_model import Objective
from kennfeld.optimize.solver.levenberg_marquardt import (
    STOPPED,
    Iteration,
    Report,
    SolverResult,
    SolverSettings,
    StageReport,
    Status,
    Stop,
    levenberg_marquardt,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.limit_excess import FEASIBLE
from kennfeld.optimize.strategies.output_limits import AugmentedLagrangian, OutputLimits
from kennfeld.optimize.sums.objective import LeastSquaresObjective

FEWEST = 5  # values up to which restarts can cover the space; a jagged cost needs them
EVALUATIONS, EVALUATIONS_OF_FEWEST = 500, 2000  # by default, for each value and 4 more
RUNS_SHARE = 0.95  # of the evaluations; the rest compares the end with its neighbours
NEIGHBOURS = (1e-2, 1e-3, 1e-4)  # distances, as shares of the bounds' distance, at which an end must be the lowest
SPREAD = 0.3  # first standard deviation of a run, as a share of the bounds' distance
CONVERGED = 1e-6  # relative differences of the cost at which a run ends
ROUNDING = 1e-12  # relative difference of costs that says nothing about the values
MIN_GAIN = 1e-4  # relative difference of two costs that counts
PATIENCE = 2  # runs in a row that end the search if they end at the lowest cost of those before
PAUSE = 1.0  # s after which the best so far is reported within a generation
SMALLEST = 1e-300  # of a cost, so that it has a logarithm
REJECTED = 1e30  # in place of a cost that is not finite
ABOVE = 1e200  # more than any cost


class CostFunction(Protocol):
    """A function of the values, possibly discontinuous."""

    def cost(self, values: Float) -> float:
        """Return the cost; not finite if the model fails."""


@dataclass(frozen=True)
class GlobalSettings:
    """Budget and seed of a search.

    0 evaluations stand for 2000 (values + 4) up to `FEWEST` values, and for 500 (values + 4) above. The generation in
    which the evaluations run out is completed, and the end is compared with its neighbours.
    """

    max_evaluations: int = 0
    seed: int = 0


def global_search(
    objective: CostFunction,
    start: Float,
    limits: LinearLimits,
    search: GlobalSettings,
    report: Report = lambda line, values: None,
) -> SolverResult:
    """Search for the lowest cost within finite bounds; the same seed gives the same search.

    Args:
        objective: the cost.
        start: values that keep the limits, Float[values].
        limits: bounds, all finite, and linear rows.
        search: budget and seed.
        report: called with the best values after each generation; may raise `Stop`.

    Returns:
        The best values; their cost is never above that of `start`.
    """
    return _Search(objective, start, limits, search, report).run()


def polish(
    objective: Objective, searched: SolverResult, limits: LinearLimits, settings: SolverSettings, report: Report
) -> SolverResult:
    """Descend from the end of a search; return the better of both ends."""
    if searched.cut_short:
        return searched
    end = levenberg_marquardt(objective, searched.values, limits, settings, report)
    if end.status == "stopped":
        best = end
    elif not end.cost < searched.cost:
        best = replace(searched, message=f"{searched.message} A final gradient-based descent did not lower the cost.")
    else:
        remark = f"A final gradient-based descent lowered the cost by {1 - end.cost / searched.cost:.2%}."
        best = replace(
            searched.moved(end.values, end.cost), certificate=end.certificate, message=f"{searched.message} {remark}"
        )
    return best.with_effort_of([searched, end])


class _Search:
    """A search over values scaled to [0, 1] between their bounds."""

    def __init__(
        self, objective: CostFunction, start: Float, limits: LinearLimits, search: GlobalSettings, report: Report
    ) -> None:
        self.objective, self.limits, self.report = objective, limits, report
        self.start = self.best = start
        self.movable = np.flatnonzero(limits.movable)
        self.lower = limits.lower[self.movable]
        self.span = limits.upper[self.movable] - self.lower
        self.random = np.random.default_rng(search.seed)
        size = self.movable.size
        self.budget = search.max_evaluations or (EVALUATIONS_OF_FEWEST if size <= FEWEST else EVALUATIONS) * (size + 4)
        self.cost, self.run_cost, self.highest = np.inf, np.inf, -np.inf  # the lowest, that of a run, the highest
        self.evaluations = self.generations = 0
        self.reported = time.monotonic()

    def run(self) -> SolverResult:
        try:
            self._try(self.start)
            if not self.movable.size:
                return self._end("converged", "No value is free to move.")
            return self._restarted()
        except (Stop, KeyboardInterrupt) as request:
            return self._end("stopped", str(request) or STOPPED)

    def _restarted(self) -> SolverResult:
        first = (self.start[self.movable] - self.lower) / self.span
        agreeing = runs = larger = 0
        effort = {True: 0, False: 0}  # evaluations of runs with growing and with the smallest population
        while agreeing < PATIENCE and self.evaluations < RUNS_SHARE * self.budget:
            before = self.cost
            # from the start until a run has converged, then from anywhere
            origin = first if runs == 0 else self.random.uniform(size=first.size)
            self.run_cost, evaluations = np.inf, self.evaluations
            grows = effort[True] <= effort[False] or runs == 0
            converged = self._one_run(origin, 2**larger if grows else 1)
            effort[grows] += self.evaluations - evaluations
            larger += grows
            # the run by itself has found the lowest cost of those before it again
            same = np.isfinite(before) and abs(self.run_cost - before) <= MIN_GAIN * before
            agreeing = agreeing + 1 if converged and same and not self._is_flat else 0
            runs += converged
        return self._judged(runs, agreeing >= PATIENCE)

    @property
    def _is_flat(self) -> bool:
        """True if all costs so far are equal but for rounding; one of 0 cannot be lower anywhere."""
        return np.isfinite(self.cost) and 0 < self.cost >= (1 - ROUNDING) * self.highest

    def _judged(self, runs: int, agreed: bool) -> SolverResult:
        """Return the end of so many converged runs; `agreed` if the last ones ended at the lowest cost."""
        if not np.isfinite(self.cost):
            return self._end("failed", f"The cost is not a finite number at any of {self.evaluations} points.")
        more = "Increase max_evaluations, or narrow the bounds."
        if runs == 0:
            effort = count_noun(self.evaluations, "evaluation")
            return self._end("max_iterations", f"The search had not converged after {effort}. {more}")
        if self._is_flat:
            message = (
                f"The cost is the same at all of {self.evaluations} points: no value has an effect within its bounds."
            )
            return self._end("failed", message)
        # a cost with steps may satisfy the tolerances of a run beside a lower value
        if not self._descend_to_neighbours():
            message = f"After {self.evaluations} evaluations, values beside the best ones still lower the cost. {more}"
            return self._end("max_iterations", message)
        message = f"The global search ended after {count_noun(runs, 'converged run')}."
        if not agreed:
            message += " They ended at different costs: more evaluations or narrower bounds may lead to a lower one."
        return self._end("converged", message)

    def _descend_to_neighbours(self) -> bool:
        """Move to neighbours that lower the cost while evaluations are left; return True if none lowers it."""
        while self._lower_neighbour():
            if self.evaluations >= self.budget:
                return False
        return True

    def _lower_neighbour(self) -> bool:
        """Evaluate the neighbours of the best values along each value until one has a lower cost."""
        before, here = self.cost, self.best
        for share, number, sign in product(NEIGHBOURS, range(self.movable.size), (1.0, -1.0)):
            values = here.copy()
            values[self.movable[number]] += sign * share * self.span[number]
            if self._try(self.limits.clip(values)) < (1 - MIN_GAIN) * before:
                return True
        return False

    def _one_run(self, origin: Float, population_factor: int) -> bool:
        """Run the strategy once; return True if it converged within the evaluations."""
        strategy = _strategy(origin, population_factor, self.random)
        while self.evaluations < RUNS_SHARE * self.budget:
            if strategy.stop():
                return True
            points = strategy.ask()
            strategy.tell(points, self._ranks(points, strategy.sigma))
            self.generations += 1
            self._report_best(strategy.sigma)
        return bool(strategy.stop())

    def _ranks(self, points: Sequence[Float], spread: float) -> list[float]:
        """Return the logarithms of the costs, which make the tolerances of the strategy relative."""
        ranks = []
        for point in points:
            values = self.start.copy()
            # the companion of a single value is left out
            values[self.movable] = self.lower + np.clip(point[: self.movable.size], 0.0, 1.0) * self.span
            cost = self._try(values)
            ranks.append(float(np.log(max(cost, SMALLEST))) if np.isfinite(cost) else REJECTED)
            if time.monotonic() - self.reported > PAUSE:
                self._report_best(spread)
        return ranks

    def _try(self, values: Float) -> float:
        """Evaluate the nearest values that keep the limits, and store them if they are the best."""
        kept, _ = project(values, self.limits)
        if kept is None:
            return np.inf
        cost = self.objective.cost(kept)
        self.evaluations += 1
        if np.isfinite(cost):
            self.highest, self.run_cost = max(cost, self.highest), min(cost, self.run_cost)
            if cost < self.cost:
                self.cost, self.best = cost, kept
        return cost

    def _report_best(self, spread: float) -> None:
        self.reported = time.monotonic()
        if np.isfinite(self.cost):
            self.report(Iteration(self.generations, self.cost, spread, 0.0, 0), self.best)

    def _end(self, status: Status, message: str) -> SolverResult:
        return SolverResult(self.best, self.cost, status, message, self.generations, self.evaluations)


def _strategy(origin: Float, population_factor: int, random: "np.random.Generator") -> Any:
    """Return a run of CMA-ES within [0, 1] that is silent, writes no files, and draws from `random` only."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses a plotting library
        from cma import CMAEvolutionStrategy

    # a single value gets a dummy companion: there is no covariance to adapt in one dimension
    point = np.append(origin, 0.5) if origin.size == 1 else origin
    options = {
        "bounds": [0.0, 1.0],
        "popsize": population_factor * (4 + int(3 * np.log(point.size))),
        "tolfun": CONVERGED,
        "tolfunhist": CONVERGED / 10,
        "tolx": 1e-9,
        "randn": lambda *shape: random.standard_normal(shape),
        "seed": np.nan,
        "signals_filename": "",
        "verb_log": 0,
        "verb_disp": 0,
        "verbose": -9,
    }
    return CMAEvolutionStrategy(point, SPREAD, options)


class FeasibilityFirstCost:
    """The cost of a problem with limits of outputs, for a search that compares costs."""

    def __init__(self, objective: LeastSquaresObjective, outputs: OutputLimits) -> None:
        self._objective, self._outputs = objective, outputs

    def cost(self, values: Float) -> float:
        """Return the cost if the limits are satisfied, else a number above any cost that grows with the violation."""
        cost = self._objective.cost(values)
        if not np.isfinite(cost):
            return cost
        violation = self._outputs.measure(values)
        # the violation alone ranks points outside: the cost there does not matter
        return cost if violation.largest <= FEASIBLE else ABOVE * violation.squares

    def search(self, start: Float, limits: LinearLimits, settings: GlobalSettings, report: Report) -> SolverResult:
        """Search for the lowest feasible cost, or else for the smallest violation."""

        def report_cost(line: Iteration, values: Float) -> None:
            report(replace(line, cost=self._objective.cost(values)), values)

        end = global_search(self, start, limits, settings, report_cost)
        if not np.isfinite(end.cost) or self._outputs.is_satisfied(end.values):
            return end
        status: Status = end.status if end.status == "stopped" else "infeasible"
        return replace(end, cost=self._objective.cost(end.values), status=status)

    def polish(
        self, searched: SolverResult, limits: LinearLimits, settings: SolverSettings, report: StageReport
    ) -> SolverResult:
        """Descend from the end of a search; return the better of both ends, within the output limits."""
        if searched.cut_short or not self._outputs.is_satisfied(searched.values):
            return searched
        descent = AugmentedLagrangian(self._outputs, self._objective, limits, settings, report)
        end = descent.descend(searched.values)
        lower = end.cost < searched.cost and self._outputs.is_satisfied(end.values)
        best = searched.moved(end.values, end.cost) if lower else searched
        if end.status == "stopped":
            best = replace(best, status=end.status, message=end.message)
        return best.with_effort_of([searched, end])
