"""Output limits at every sample of the training data, by the method of multipliers.

Minimise f(p) + w sum (c(p) + m)+^2 over the excess c of each limit, scaled; then update m = (c + m)+, and increase the
weight w if the excess falls too slowly. M. Hestenes: Multiplier and gradient methods, 1969; J. Nocedal, S. Wright:
Numerical Optimization, chapter 17.

Each side of a limit is a criterion whose loss is the squared excess. Its target is lowered, sample by sample, by the
multiplier over twice the penalty. No rows are stored, so a limit costs as much as a criterion, over any number of
samples and with states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.criteria import Criterion
from kennfeld.errors import Findings
from kennfeld.models import Model
from kennfeld.native.column_table import Order
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.limit_nodes import add_limit_nodes, limit_sides
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.optimize.solver.levenberg_marquardt import (
    Iteration,
    SolverResult,
    SolverSettings,
    StageReport,
    levenberg_marquardt,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.validation import check_limits
from kennfeld.preprocessing.binding import BoundDataset

FEASIBLE = 1e-6  # of a limit's scale: a violation below it counts as satisfied
NEAR_ACTIVE = 1e-4  # of a limit's scale: distance at which a limit counts as active
MAX_SAMPLES = 400  # at which limits are linearised

GAP_TOLERANCE = 1e-6  # share of the cost that a better choice of multipliers might still save
MAX_ROUNDS = 40  # updates of the multipliers
SLOW_RATIO = 0.25  # of the excess before a round: what is left above it makes the penalty grow
PENALTY_GROWTH = 10.0
MAX_PENALTY = 1e12  # times the first penalty: beyond, the limits cannot be satisfied


@dataclass
class AugmentedLagrangian:
    """The outer iteration over multipliers and penalty.

    Args:
        outputs: the limits of outputs.
        objective: the cost without them.
        limits: bounds and linear rows.
        settings: of each descent.
        report: called with the stage after each accepted step.
    """

    outputs: "OutputLimits"
    objective: LeastSquaresObjective
    limits: LinearLimits
    settings: SolverSettings
    report: StageReport
    results: list[SolverResult] = field(default_factory=list, init=False)

    def descend(self, start: Float) -> SolverResult:
        """Return the best values; status `infeasible` if none were found that keep the output limits."""
        self.outputs.reset()
        excess = self.outputs.excess(start)
        penalty = first_penalty = self._first_penalty(start, excess)
        penalised = self.outputs.penalise(penalty)
        values, previous_violation = start, self.outputs.largest(excess)
        for number in range(1, MAX_ROUNDS + 1):
            report = partial(self._report, f"limits {number}")
            result = levenberg_marquardt(penalised, values, self.limits, self.settings, report)
            self.results.append(result)
            values, excess = result.values, self.outputs.excess(result.values)
            violation = self.outputs.largest(excess)
            if result.cut_short:
                return self._end(result)
            slow = violation > FEASIBLE and violation > SLOW_RATIO * max(previous_violation, 0.0)
            complementarity_gap = penalty * self.outputs.update_multipliers(excess, PENALTY_GROWTH if slow else 1.0)
            if violation <= FEASIBLE and complementarity_gap <= GAP_TOLERANCE * self.objective.cost(values):
                return self._end(result)
            if slow:
                penalty *= PENALTY_GROWTH
                if penalty > MAX_PENALTY * first_penalty:
                    break
                penalised = self.outputs.penalise(penalty)
            previous_violation = violation
        if self.outputs.is_satisfied(values):
            return self._end(result)
        message = f"The output limits cannot all be satisfied: {self.outputs.describe_violations(values)}."
        return replace(self._end(result), status="infeasible", message=message)

    def _first_penalty(self, values: Float, excess: Sequence[Float]) -> float:
        """Return the weight at which cost and excess are equal."""
        total, cost = sum(self.outputs.squares(excess)), self.objective.cost(values)
        return max(cost, 1e-300) / total if total > 0 and np.isfinite(cost) else max(cost, 1.0)

    def _report(self, stage: str, line: Iteration, values: Float) -> None:
        self.report(stage, replace(line, cost=self.objective.cost(values)), values)

    def _end(self, result: SolverResult) -> SolverResult:
        return replace(result, cost=self.objective.cost(result.values)).with_effort_of(self.results)


@dataclass(frozen=True)
class NearActiveSamples:
    """Samples at which a side of a limit is active or nearly so, with the derivatives of the limited node there.

    `side`, `data` and `sample` are indices of the side, the training dataset and its sample. `excess` and `rows` are
    relative to the scale of the side.
    """

    side: Int  # Int[samples]
    data: Int  # Int[samples]
    sample: Int  # Int[samples]
    excess: Float  # Float[samples]
    rows: Float  # Float[samples, values]


@dataclass(frozen=True)
class _Penalised(Problem):
    """A problem with a criterion for each side of its limits, whose targets are arrays changed in place."""

    targets: Mapping[tuple[str, int], Float] = field(default_factory=dict)  # by node and identity of the dataset

    def target(self, criterion: Criterion, bound: BoundDataset) -> Float:
        known = self.targets.get((criterion.node, id(bound.dataset)))
        return super().target(criterion, bound) if known is None else known


class OutputLimits:
    """The output limits of a problem: their violation, and the penalised cost for a descent.

    `sides` are those with a finite bound. Methods take the free values, Float[values].
    """

    def __init__(self, problem: Problem) -> None:
        Findings(check_limits(problem)).finish()
        self.sides = limit_sides(problem.limits)
        model = add_limit_nodes(problem.model, problem.limits)
        self._problem = replace(problem, model=model, limits=())
        self._bounds = self._problem.gathered
        self._nodes = NodeSimulator(model.graph, problem.parameters, [side.node for side in self.sides])
        self._masks = self._conditions(model)
        self._scaled_multipliers = [np.zeros(mask.shape) for mask in self._masks]
        self._scales = self._sizes()
        self._penalised = CompiledProblem(self._with_criteria())

    def _conditions(self, model: Model) -> list[Float]:
        """Return for each dataset Float[sides, samples], 1 if a side applies, else NaN."""
        wheres = list(dict.fromkeys(side.where for side in self.sides if side.limit.where))
        nodes = NodeSimulator(model.graph, self._problem.parameters, wheres) if wheres else None
        masks = []
        for bound in self._bounds:
            conditions = () if nodes is None else nodes.values(bound, self._problem.parameters)
            values = dict(zip(wheres, conditions, strict=True))
            rows = [bound.scored & (values.get(side.where, np.ones(bound.count)) != 0) for side in self.sides]
            masks.append(np.where(rows, 1.0, np.nan))
        return masks

    def _sizes(self) -> Float:
        """Return the scale of each side: the size of its bound, or that of the node if the bound is 0."""
        values = [np.abs(self._nodes.values(bound, self._problem.parameters)) for bound in self._bounds]
        largest = [np.nan_to_num(v, nan=0.0, posinf=0.0).max(axis=1, initial=0.0) for v in values]
        typical = np.max(largest, axis=0)
        bounds = np.abs([side.bound for side in self.sides])
        return np.where(bounds > 0, bounds, np.where(typical > 0, typical, 1.0))

    def excess(self, values: Float) -> list[Float]:
        """Return node minus bound of each side, Float[sides, samples] per dataset.

        It is < 0 if the limit is satisfied, NaN if its condition is not met, infinite if the node is not finite.
        """
        edges = np.array([side.bound for side in self.sides])[:, None]
        parameters, excess = self._penalised.parameters(values), []
        for bound, mask in zip(self._bounds, self._masks, strict=True):
            distance = self._nodes.values(bound, parameters) - edges
            excess.append(np.where(np.isnan(mask), np.nan, np.where(np.isfinite(distance), distance, np.inf)))
        return excess

    def largest(self, excess: Sequence[Float]) -> float:
        """Return the largest of an excess relative to the scale of its side."""
        relative = [np.nan_to_num(e / self._scales[:, None], nan=-np.inf, posinf=np.inf) for e in excess]
        return max((float(r.max(initial=-np.inf)) for r in relative), default=-np.inf)

    def squares(self, excess: Sequence[Float]) -> list[float]:
        """Return the sum of squares of the violations for each dataset, relative to their scales."""
        relative = [np.clip(e / self._scales[:, None], 0.0, 1e6) for e in excess]
        return [float(np.nansum(np.square(r))) for r in relative]

    def is_satisfied(self, values: Float) -> bool:
        return self.largest(self.excess(values)) <= FEASIBLE

    def describe_violations(self, values: Float) -> str:
        """Return a clause for each limit that is exceeded, with the number of samples and the worst one."""
        parts, all_excess = [], self.excess(values)
        for i, side in enumerate(self.sides):
            excess = [np.nan_to_num(e[i], nan=-np.inf, posinf=np.inf) for e in all_excess]
            most = [float(e.max(initial=-np.inf)) for e in excess]
            data = int(np.argmax(most))
            if most[data] > FEASIBLE * self._scales[i]:
                count = sum(int(np.count_nonzero(e > FEASIBLE * self._scales[i])) for e in excess)
                bound = self._bounds[data]
                sample = int(bound.kept[int(np.argmax(excess[data]))])
                parts.append(
                    f"{side} is exceeded at {count} samples, most by {most[data]:.4g} "
                    f"at sample {sample} of {bound.dataset.name}"
                )
        return "; ".join(parts)

    def near_active(self, values: Float) -> NearActiveSamples | None:
        """Return the samples at which limits are active, at most the nearest `MAX_SAMPLES`; None if there are none."""
        relative = [excess / self._scales[:, None] for excess in self.excess(values)]
        nearest = np.concatenate([r[(r >= -NEAR_ACTIVE) & np.isfinite(r)] for r in relative])
        if not nearest.size:
            return None
        least = np.sort(nearest)[-MAX_SAMPLES:][0]
        pairs = [np.nonzero((r >= least) & np.isfinite(r)) for r in relative]
        side, sample = np.concatenate(pairs, axis=1)
        data = np.repeat(np.arange(len(pairs)), [pair[0].size for pair in pairs])
        excess = np.concatenate([r[pair] for r, pair in zip(relative, pairs, strict=True)])
        rows = self._slopes(values, side, data, sample)
        numbers = np.array([self._bounds[d].kept[s] for d, s in zip(data, sample, strict=True)])
        return NearActiveSamples(side, data, numbers, excess, rows)

    def _slopes(self, values: Float, side: Int, data: Int, sample: Int) -> Float:
        """Return the derivatives of limited nodes at some samples, relative to the scales; Float[samples, values]."""
        known = len(self._problem.criteria)
        for target in self._targets.values():
            target[:] = np.nan
        for i, d, s in zip(side, data, sample, strict=True):  # a scale above the target, the loss is the square
            self._targets[self.sides[i].node, id(self._bounds[d].dataset)][s] = self.sides[i].bound - self._scales[i]
        self._penalised.reread_targets()
        alone = self._penalised.reweight(np.repeat([0.0, 1.0], [known, len(self.sides)]))
        first = np.cumsum([0, *(bound.count for bound in self._bounds)])
        visits = _visits(alone.samples.order, first[data] + sample)
        ordered = np.unique(visits)
        rows = alone.sums.rows_at(alone.full(values), ordered)[np.searchsorted(ordered, visits), known + side]
        self._write_targets()
        return rows

    def reset(self) -> None:
        """Set all multipliers to 0."""
        self._scaled_multipliers = [np.zeros(mask.shape) for mask in self._masks]
        self._write_targets()

    def _with_criteria(self) -> Problem:
        """Return the problem with a criterion for each side, whose weight is 1 / scale^2."""
        problem = self._problem
        self._targets = {
            (side.node, id(bound.dataset)): side.bound * mask[i]
            for bound, mask in zip(self._bounds, self._masks, strict=True)
            for i, side in enumerate(self.sides)
        }
        criteria = [
            Criterion(side.node, 0.0, 1 / scale**2, "excess")
            for side, scale in zip(self.sides, self._scales, strict=True)
        ]
        attributes = {f.name: getattr(problem, f.name) for f in fields(Problem)}
        return _Penalised(**attributes | {"criteria": (*problem.criteria, *criteria)}, targets=self._targets)

    def penalise(self, weight: float) -> LeastSquaresObjective:
        """Return the cost plus `weight` times the squared violations relative to their scales."""
        known = len(self._problem.criteria)
        return LeastSquaresObjective(self._penalised.reweight(np.repeat([1.0, weight], [known, len(self.sides)])))

    def _write_targets(self) -> None:
        """Write the targets: the bounds, lowered by the scaled multipliers."""
        for bound, mask, shift in zip(self._bounds, self._masks, self._scaled_multipliers, strict=True):
            for i, side in enumerate(self.sides):
                self._targets[side.node, id(bound.dataset)][:] = (side.bound - shift[i]) * mask[i]
        self._penalised.reread_targets()

    def update_multipliers(self, excess: Sequence[Float], heavier: float = 1.0) -> float:
        """Update the scaled multipliers m = (excess + m)+; divide them by `heavier` if the penalty grows by it.

        Returns:
            The complementarity gap for a penalty of 1: the sum of multiplier times distance from the side. It bounds
            the possible decrease of the cost, and is 0 if only active limits have multipliers.
        """
        gap = 0.0
        for i, far in enumerate(excess):
            known = np.where(np.isnan(far), 0.0, far)
            new = np.where(np.isnan(far), 0.0, np.maximum(known + self._scaled_multipliers[i], 0.0))
            gap += float(np.sum(2 * new * np.abs(known) / self._scales[:, None] ** 2))
            self._scaled_multipliers[i] = new / heavier
        self._write_targets()
        return gap


def _visits(order: Order | None, samples: Int) -> Int:
    """Return the positions of samples in the order of visits."""
    if order is None:
        return samples
    sorter = np.argsort(order)
    return np.asarray(sorter[np.searchsorted(order, samples, sorter=sorter)])
