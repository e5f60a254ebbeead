"""A search without gradients within limits of outputs: what keeps them comes first, whatever it costs.

Of two points that keep the limits the cheaper is better, of two that do not the one that exceeds them less, and what
keeps them is better than what does not (K. Deb, An efficient constraint handling method for genetic algorithms, 2000).

Search without gradients, for costs that jump: CMA-ES within bounds, started anew while that helps.

A model whose events happen earlier or later with its values (a governor triggered by the crank, a relay, quantised
code) has a cost of steps: its derivatives are exact and say nothing of them. The covariance matrix adaptation
evolution strategy (N. Hansen, A. Ostermeier, Completely Derandomized Self-Adaptation in Evolution Strategies, 2001)
compares costs and asks for nothing else. The first run begins at the start, the next ones anywhere within the bounds
with twice the population of the one before (A. Auger, N. Hansen, A Restart CMA Evolution Strategy With Increasing
Population Size, 2005). A descent from the best values ends the search.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.projection import project
from kennfeld.optimize.solver.gauss_newton_model import Objective
from kennfeld.optimize.solver.levenberg_marquardt import (
    Iteration,
    SolverResult,
    SolverSettings,
    Status,
    Stop,
    levenberg_marquardt,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.augmented_lagrangian import descend_within
from kennfeld.optimize.strategies.output_limits import FEASIBLE, OutputLimits
from kennfeld.parameter_set import ParameterSet

__all__ = ["FEW", "FeasibilityFirstCost", "GlobalSettings", "global_search", "polish"]

FEW = 30  # values up to which a search without gradients is a good idea
SPREAD = 0.3  # first standard deviation of a run, as a share of the bounds' distance
SETTLED = 1e-6  # relative differences of the cost at which a run ends
BETTER = 1e-4  # relative decrease of the cost by which a run has to beat those before it
PATIENCE = 2  # runs in a row that did not, and end the search
PAUSE = 1.0  # s after which the best so far is reported within a generation
SMALLEST = 1e-300  # of a cost, so that it has a logarithm
REJECTED = 1e30  # in place of a cost that is not finite

Report = Callable[[Iteration, Float], None]

ABOVE = 1e200  # any cost


class CostFunction(Protocol):
    """What is searched: a function of the values that may jump."""

    def cost(self, values: Float) -> float:
        """The cost; not finite where the model fails."""


@dataclass(frozen=True)
class GlobalSettings:
    """How long to search, and from which random numbers; 0 evaluations stand for 500 (values + 4).

    The generation in which the evaluations run out is completed.
    """

    max_evaluations: int = 0
    seed: int = 0

    def budget(self, values: int) -> int:
        """Evaluations of the cost for so many values."""
        return self.max_evaluations or 500 * (values + 4)


def global_search(
    objective: CostFunction,
    start: Float,
    limits: LinearLimits,
    search: GlobalSettings,
    report: Report = lambda line, values: None,
) -> SolverResult:
    """The lowest cost within finite bounds; never above that of `start`, which keeps the limits.

    `report` hears of the best values after each generation; it may raise `Stop`. The same seed gives the same search.
    """
    return _Searching(objective, start, limits, search, report).run()


def polish(
    objective: Objective,
    found: SolverResult,
    limits: LinearLimits,
    settings: SolverSettings,
    report: Report = lambda line, values: None,
) -> SolverResult:
    """The better of the end of a search and the end of a descent from there, with the effort of both."""
    if found.status in ("stopped", "failed"):
        return found
    end = levenberg_marquardt(objective, found.values, limits, settings, report)
    effort = {name: getattr(found, name) + getattr(end, name) for name in ("iterations", "evaluations")}
    if end.status == "stopped":
        return replace(end, **effort)
    if not end.cost < found.cost:
        return replace(found, message=f"{found.message} Derivatives lead no lower.", **effort)
    lower = f"A descent from there lowered the cost by {1 - end.cost / found.cost:.2g} of it."
    return replace(found, values=end.values, cost=end.cost, message=f"{found.message} {lower}", **effort)


class _Searching:
    """The running state of a search, in values scaled to [0, 1] between their bounds."""

    def __init__(
        self, objective: CostFunction, start: Float, limits: LinearLimits, search: GlobalSettings, report: Report
    ) -> None:
        self.objective, self.limits, self.report = objective, limits, report
        self.start = self.best = start
        self.movable = np.flatnonzero(limits.movable)
        self.low = limits.lower[self.movable]
        self.range = limits.upper[self.movable] - self.low
        self.random = np.random.default_rng(search.seed)
        self.budget = search.budget(self.movable.size)
        self.cost = np.inf
        self.evaluations = self.generations = 0
        self.reported = time.monotonic()

    def run(self) -> SolverResult:
        try:
            self._try(self.start)
            if not self.movable.size:
                return self._end("converged", "No value is free to move.")
            return self._restarted()
        except (Stop, KeyboardInterrupt):
            return self._end("stopped", "Stopped on request; these are the best values so far.")

    def _restarted(self) -> SolverResult:
        first = (self.start[self.movable] - self.low) / self.range
        idle = runs = 0
        while idle < PATIENCE and self.evaluations < self.budget:
            before = self.cost
            origin = first if runs == 0 else self.random.uniform(size=first.size)
            settled = self._one_run(origin, 2**runs)
            idle = 0 if self.cost < (1 - BETTER) * before else idle + 1
            runs += settled
        if not np.isfinite(self.cost):
            return self._end("failed", f"The cost is not a finite number at any of {self.evaluations} points.")
        if runs == 0:
            what = f"The search had not settled after {self.evaluations} evaluations; raise max_evaluations."
            return self._end("max_iterations", what)
        words = "one run, which settled" if runs == 1 else f"{runs} runs, which settled"
        return self._end("converged", f"The search without gradients ended after {words}.")

    def _one_run(self, origin: Float, larger: int) -> bool:
        """One run of the strategy; whether it settled before the evaluations ran out."""
        strategy = _strategy(origin, larger, self.random)
        while self.evaluations < self.budget:
            if strategy.stop():
                return True
            points = strategy.ask()
            strategy.tell(points, self._ranks(points, strategy.sigma))
            self.generations += 1
            self._tell(strategy.sigma)
        return bool(strategy.stop())

    def _ranks(self, points: Sequence[Float], spread: float) -> list[float]:
        """Logarithms of the costs: the strategy compares only, and its tolerances become relative ones."""
        ranks = []
        for point in points:
            cost = self._try(self._values(point))
            ranks.append(float(np.log(max(cost, SMALLEST))) if np.isfinite(cost) else REJECTED)
            if time.monotonic() - self.reported > PAUSE:
                self._tell(spread)
        return ranks

    def _values(self, point: Float) -> Float:
        values = self.start.copy()
        values[self.movable] = self.low + np.clip(point[: self.movable.size], 0.0, 1.0) * self.range
        return values

    def _try(self, values: Float) -> float:
        """The cost of the nearest values that keep the limits, remembered where it is the lowest."""
        kept, _ = project(values, self.limits)
        if kept is None:
            return np.inf
        cost = self.objective.cost(kept)
        self.evaluations += 1
        if np.isfinite(cost) and cost < self.cost:
            self.cost, self.best = cost, kept
        return cost

    def _tell(self, spread: float) -> None:
        self.reported = time.monotonic()
        if np.isfinite(self.cost):
            self.report(Iteration(self.generations, self.cost, spread, 0.0, 0), self.best)

    def _end(self, status: Status, message: str) -> SolverResult:
        return SolverResult(self.best, self.cost, status, message, self.generations, self.evaluations)


def _strategy(origin: Float, larger: int, random: "np.random.Generator") -> Any:
    """A run of CMA-ES within [0, 1], silent and without files, drawing from `random` alone."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses a plotting library
        from cma import CMAEvolutionStrategy

    # a single value gets an idle companion: there is no covariance to adapt in one dimension
    point = np.append(origin, 0.5) if origin.size == 1 else origin
    options = {
        "bounds": [0.0, 1.0],
        "popsize": larger * (4 + int(3 * np.log(point.size))),
        "tolfun": SETTLED,
        "tolfunhist": SETTLED / 10,
        "tolx": 1e-9,
        "randn": partial(_normals, random),
        "seed": np.nan,
        "signals_filename": "",
        "verb_log": 0,
        "verb_disp": 0,
        "verbose": -9,
    }
    return CMAEvolutionStrategy(point, SPREAD, options)


def _normals(random: "np.random.Generator", *shape: int) -> Float:
    return random.standard_normal(shape)


class FeasibilityFirstCost:
    """The cost of a problem with limits of outputs, for a search that compares costs."""

    def __init__(
        self, objective: LeastSquaresObjective, outputs: OutputLimits, parameters_of: Callable[[Float], ParameterSet]
    ) -> None:
        self._objective, self._outputs, self._parameters_of = objective, outputs, parameters_of

    def cost(self, values: Float) -> float:
        """The cost where the limits hold, else a number above any cost that grows with what exceeds them."""
        cost = self._objective.cost(values)
        if not np.isfinite(cost):
            return cost
        excess = self._outputs.excess(self._parameters_of(values))
        return cost if self._outputs.largest(excess) <= FEASIBLE else ABOVE * sum(self._outputs.squares(excess))

    def search(self, start: Float, limits: LinearLimits, settings: GlobalSettings, report: Report) -> SolverResult:
        """The lowest cost that keeps the limits; where nothing does, what exceeds them least."""

        def told(line: Iteration, values: Float) -> None:
            report(replace(line, cost=self._objective.cost(values)), values)

        found = global_search(self, start, limits, settings, told)
        return replace(found, cost=self._objective.cost(found.values)) if found.cost >= ABOVE else found

    def polished(
        self,
        found: SolverResult,
        limits: LinearLimits,
        settings: SolverSettings,
        report: Callable[[str, Iteration, Float], None],
    ) -> SolverResult:
        """The better of the end of a search and a descent from there, both within the limits of outputs."""
        if found.status in ("stopped", "failed") or not self._outputs.kept(self._parameters_of(found.values)):
            return found
        end = descend_within(
            self._outputs, self._objective, found.values, limits, settings, self._parameters_of, report
        )
        effort = {name: getattr(found, name) + getattr(end, name) for name in ("iterations", "evaluations")}
        lower = end.cost < found.cost and self._outputs.kept(self._parameters_of(end.values))
        best = replace(found, values=end.values, cost=end.cost) if lower else found
        if end.status == "stopped":
            best = replace(best, status=end.status, message=end.message)
        return replace(best, **effort)
