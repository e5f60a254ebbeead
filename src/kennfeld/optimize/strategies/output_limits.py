"""Output limits at every sample of the training data, as additional criteria of an augmented Lagrangian.

Each side of a limit is a criterion whose loss is the squared excess. Its target is lowered, sample by sample, by the
multiplier over twice the penalty. No rows are stored, so a limit costs as much as a criterion, over any number of
samples and with states. The multipliers are updated by `augmented_lagrangian`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.criteria import Criterion
from kennfeld.errors import InputError
from kennfeld.models import Model
from kennfeld.native.column_table import Order
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.limit_nodes import LimitSide, add_limit_nodes, limit_sides
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.optimize.validation import check_limits
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset

FEASIBLE = 1e-6  # of a limit's scale: a violation below it counts as satisfied
NEAR_ACTIVE = 1e-4  # of a limit's scale: distance at which a limit counts as active
MAX_SAMPLES = 400  # at which limits are linearised


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
    """The output limits of a problem: their violation, and the penalised cost for a descent."""

    def __init__(self, problem: Problem) -> None:
        findings = check_limits(problem)
        if findings:
            raise InputError(findings)
        self._sides = limit_sides(problem.limits)
        model = add_limit_nodes(problem.model, problem.limits)
        self._problem = replace(problem, model=model, limits=())
        self._bounds = self._problem.gathered
        names = [side.node for side in self._sides]
        self._nodes = NodeSimulator(model.graph, problem.parameters, names)
        self._masks = self._conditions(model)
        self._scaled_multipliers = [np.zeros(mask.shape) for mask in self._masks]
        self._scales = self._sizes()
        self._penalised = self._compiled()

    def _conditions(self, model: Model) -> list[Float]:
        """Return for each dataset Float[sides, samples], 1 if a side applies, else NaN."""
        wheres = list(dict.fromkeys(side.where for side in self._sides if side.limit.where))
        nodes = NodeSimulator(model.graph, self._problem.parameters, wheres)
        masks = []
        for bound in self._bounds:
            values = dict(zip(wheres, nodes.values(bound, self._problem.parameters), strict=True)) if wheres else {}
            rows = [bound.scored & (values.get(side.where, np.ones(bound.count)) != 0) for side in self._sides]
            masks.append(np.where(rows, 1.0, np.nan))
        return masks

    def _sizes(self) -> Float:
        """Return the scale of each side: the size of its bound, or that of the node if the bound is 0."""
        values = [np.abs(self._nodes.values(bound, self._problem.parameters)) for bound in self._bounds]
        with np.errstate(all="ignore"):
            typical = [
                np.nanmax([np.nan_to_num(v[i], nan=0.0, posinf=0.0).max(initial=0.0) for v in values])
                for i in range(len(self._sides))
            ]
        bounds = np.abs([side.bound for side in self._sides])
        scales: Float = np.where(bounds > 0, bounds, np.where(np.array(typical) > 0, typical, 1.0))
        return scales

    def excess(self, parameters: ParameterSet) -> list[Float]:
        """Return node minus bound of each side, Float[sides, samples] per dataset.

        It is < 0 if the limit is satisfied, NaN if its condition is not met, infinite if the node is not finite.
        """
        edges = np.array([side.bound for side in self._sides])[:, None]
        excess = []
        for bound, mask in zip(self._bounds, self._masks, strict=True):
            values = self._nodes.values(bound, parameters) - edges
            excess.append(np.where(np.isnan(mask), np.nan, np.where(np.isfinite(values), values, np.inf)))
        return excess

    def worst(self, parameters: ParameterSet) -> float:
        """Return the largest excess relative to the scale of its side."""
        return self.largest(self.excess(parameters))

    def largest(self, excess: Sequence[Float]) -> float:
        """Return the largest of an excess relative to the scale of its side."""
        relative = [np.nan_to_num(e / self._scales[:, None], nan=-np.inf, posinf=np.inf) for e in excess]
        return max((float(r.max(initial=-np.inf)) for r in relative), default=-np.inf)

    def squares(self, excess: Sequence[Float]) -> list[float]:
        """Return the sum of squares of the violations for each dataset, relative to their scales."""
        relative = [np.clip(e / self._scales[:, None], 0.0, 1e6) for e in excess]
        return [float(np.nansum(np.square(r))) for r in relative]

    def is_satisfied(self, parameters: ParameterSet) -> bool:
        """Return True if all limits are satisfied."""
        return self.worst(parameters) <= FEASIBLE

    def describe_violations(self, parameters: ParameterSet) -> str:
        """Return a clause for each limit that is exceeded, with the number of samples and the worst one."""
        parts = []
        for i, side in enumerate(self._sides):
            excess = [np.nan_to_num(e[i], nan=-np.inf, posinf=np.inf) for e in self.excess(parameters)]
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

    @property
    def sides(self) -> tuple[LimitSide, ...]:
        """The sides of the limits with a finite bound."""
        return self._sides

    def touched(self, values: Float, parameters: ParameterSet) -> NearActiveSamples | None:
        """Return the samples at which limits are active, at most the nearest `MAX_SAMPLES`; None if there are none.

        Args:
            values: free values, Float[values].
            parameters: the parameter set with these values.
        """
        relative = [excess / self._scales[:, None] for excess in self.excess(parameters)]
        nearest = np.concatenate([r[(r >= -NEAR_ACTIVE) & np.isfinite(r)] for r in relative])
        if not nearest.size:
            return None
        least = np.sort(nearest)[-MAX_SAMPLES:][0]
        found = [np.nonzero((r >= least) & np.isfinite(r)) for r in relative]
        side, sample = (np.concatenate([pair[i] for pair in found]) for i in range(2))
        data = np.repeat(np.arange(len(found)), [pair[0].size for pair in found])
        excess = np.concatenate([r[pair] for r, pair in zip(relative, found, strict=True)])
        rows = self._slopes(values, side, data, sample)
        kept = [bound.kept for bound in self._bounds]
        numbers = np.array([kept[d][s] for d, s in zip(data, sample, strict=True)])
        return NearActiveSamples(side, data, numbers, excess, rows)

    def _slopes(self, values: Float, side: Int, data: Int, sample: Int) -> Float:
        """Return the derivatives of limited nodes at some samples, relative to the scales; Float[samples, values]."""
        known = len(self._problem.criteria)
        for target in self._targets.values():
            target[:] = np.nan
        for i, d, s in zip(side, data, sample, strict=True):  # a scale above the target, the loss is the square
            self._targets[self._sides[i].node, id(self._bounds[d].dataset)][s] = self._sides[i].bound - self._scales[i]
        self._penalised.reread_targets()
        alone = self._penalised.reweighted(np.repeat([0.0, 1.0], [known, len(self._sides)]))
        full = self._penalised.start.copy()
        full[: values.size] = values
        first = np.cumsum([0, *(bound.count for bound in self._bounds)])
        visits = _visits(alone.samples.order, first[data] + sample)
        ordered = np.unique(visits)
        rows = alone.accumulator.rows_at(full, ordered)[np.searchsorted(ordered, visits), known + side]
        self._write_targets()
        self._penalised.reread_targets()
        return rows

    def reset(self) -> None:
        """Set all multipliers to 0."""
        self._scaled_multipliers = [np.zeros(mask.shape) for mask in self._masks]
        self._write_targets()
        self._penalised.reread_targets()

    def _compiled(self) -> CompiledProblem:
        """Compile the problem with a criterion for each side, whose weight is 1 / scale^2."""
        problem = self._problem
        targets = {
            (side.node, id(bound.dataset)): np.empty(bound.count) for bound in self._bounds for side in self._sides
        }
        criteria = [
            Criterion(side.node, 0.0, 1 / scale**2, "excess")
            for side, scale in zip(self._sides, self._scales, strict=True)
        ]
        attributes = {f.name: getattr(problem, f.name) for f in fields(Problem)}
        penalised = _Penalised(**attributes | {"criteria": (*problem.criteria, *criteria)}, targets=targets)
        self._targets = targets
        self._write_targets()
        return CompiledProblem(penalised)

    def penalised(self, weight: float) -> LeastSquaresObjective:
        """Return the cost plus `weight` times the squared violations relative to their scales."""
        known = len(self._problem.criteria)
        return LeastSquaresObjective(self._penalised.reweighted(np.repeat([1.0, weight], [known, len(self._sides)])))

    def _write_targets(self) -> None:
        """Write the targets: the bounds, lowered by the scaled multipliers."""
        for bound, mask, shift in zip(self._bounds, self._masks, self._scaled_multipliers, strict=True):
            for i, side in enumerate(self._sides):
                self._targets[side.node, id(bound.dataset)][:] = (side.bound - shift[i]) * mask[i]

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
        self._penalised.reread_targets()
        return gap


def _visits(order: Order | None, samples: Int) -> Int:
    """Return the positions of samples in the order of visits."""
    if order is None:
        return samples
    sorter = np.argsort(order)
    return np.asarray(sorter[np.searchsorted(order, samples, sorter=sorter)])
