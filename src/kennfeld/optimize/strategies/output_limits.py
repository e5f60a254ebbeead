"""Limits of outputs, kept at every sample of the training data, by an augmented Lagrangian.

Each side of a limit is one more criterion with a loss of what exceeds it, squared. Its target is lowered, sample by
sample, by the multiplier over twice the weight: where a limit presses, the fit is pushed back until it holds. No rows
are stored, so a limit costs what a criterion costs, over any number of samples and with states. How the multipliers are
found is in `multipliers.py`.
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

__all__ = ["FEASIBLE", "NearActiveSamples", "OutputLimits"]

FEASIBLE = 1e-6  # of a limit's scale: what counts as kept
NEAR = 1e-4  # of a limit's scale: what counts as met, as the multipliers leave little more
MOST = 400  # samples at which limits are linearised


@dataclass(frozen=True)
class NearActiveSamples:
    """Samples at which a side of a limit is met, or nearly, and how the limited node moves with the values there.

    `side`, `data` and `sample` are numbers: of the side, of the training dataset, and of its sample. `excess` and
    `rows` are relative to the scale of the side.
    """

    side: Int  # Int[samples]
    data: Int  # Int[samples]
    sample: Int  # Int[samples]
    excess: Float  # Float[samples]
    rows: Float  # Float[samples, values]


@dataclass(frozen=True)
class _Penalised(Problem):
    """A problem with a criterion for each side of its limits, whose targets are arrays that others may change."""

    targets: Mapping[tuple[str, int], Float] = field(default_factory=dict)  # by node and identity of the dataset

    def target(self, criterion: Criterion, bound: BoundDataset) -> Float:
        """That of the problem, or of a side: read where it lies."""
        known = self.targets.get((criterion.node, id(bound.dataset)))
        return super().target(criterion, bound) if known is None else known


class OutputLimits:
    """The limits of a problem: how far they are exceeded, and a descent that ends where they hold."""

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
        self._shifts = [np.zeros(mask.shape) for mask in self._masks]
        self._scales = self._sizes()
        self._penalised = self._compiled()

    def _conditions(self, model: Model) -> list[Float]:
        """For each dataset, 1 where a side counts and NaN elsewhere; shape (sides, samples)."""
        wheres = list(dict.fromkeys(side.where for side in self._sides if side.limit.where))
        nodes = NodeSimulator(model.graph, self._problem.parameters, wheres)
        masks = []
        for bound in self._bounds:
            found = dict(zip(wheres, nodes.values(bound, self._problem.parameters), strict=True)) if wheres else {}
            rows = [bound.scored & (found.get(side.where, np.ones(bound.count)) != 0) for side in self._sides]
            masks.append(np.where(rows, 1.0, np.nan))
        return masks

    def _sizes(self) -> Float:
        """The scale of each side: its bound's size, or that of the node where the bound is 0."""
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
        """How far each side is exceeded, shape (sides, samples) a dataset; below 0 where it is kept, NaN where not met.

        What is not a finite number counts as infinitely far.
        """
        edges = np.array([side.bound for side in self._sides])[:, None]
        found = []
        for bound, mask in zip(self._bounds, self._masks, strict=True):
            values = self._nodes.values(bound, parameters) - edges
            found.append(np.where(np.isnan(mask), np.nan, np.where(np.isfinite(values), values, np.inf)))
        return found

    def worst(self, parameters: ParameterSet) -> float:
        """The largest excess, relative to the side's scale."""
        return self.largest(self.excess(parameters))

    def largest(self, excess: Sequence[Float]) -> float:
        """The largest of an excess, relative to the sides' scales."""
        relative = [np.nan_to_num(e / self._scales[:, None], nan=-np.inf, posinf=np.inf) for e in excess]
        return max((float(r.max(initial=-np.inf)) for r in relative), default=-np.inf)

    def squares(self, excess: Sequence[Float]) -> list[float]:
        """The sum of squares of what exceeds the limits, relative to their scales, for each dataset."""
        relative = [np.clip(e / self._scales[:, None], 0.0, 1e6) for e in excess]
        return [float(np.nansum(np.square(r))) for r in relative]

    def kept(self, parameters: ParameterSet) -> bool:
        """Whether all limits hold."""
        return self.worst(parameters) <= FEASIBLE

    def told(self, parameters: ParameterSet) -> str:
        """A sentence on the limits that are exceeded, and by how much."""
        parts = []
        for i, side in enumerate(self._sides):
            far = [np.nan_to_num(e[i], nan=-np.inf, posinf=np.inf) for e in self.excess(parameters)]
            most = [float(f.max(initial=-np.inf)) for f in far]
            data = int(np.argmax(most))
            if most[data] > FEASIBLE * self._scales[i]:
                count = sum(int(np.count_nonzero(f > FEASIBLE * self._scales[i])) for f in far)
                bound = self._bounds[data]
                sample = int(bound.kept[int(np.argmax(far[data]))])
                parts.append(
                    f"{side} is exceeded at {count} samples, most by {most[data]:.4g} "
                    f"at sample {sample} of {bound.dataset.name}"
                )
        return "; ".join(parts)

    @property
    def sides(self) -> tuple[LimitSide, ...]:
        """The sides of the limits that bound something."""
        return self._sides

    def touched(self, values: Float, parameters: ParameterSet) -> NearActiveSamples | None:
        """Where the limits are met at these values, those of `parameters`; None where they are nowhere.

        Of very many samples the nearest `MOST`.
        """
        relative = [excess / self._scales[:, None] for excess in self.excess(parameters)]
        nearest = np.concatenate([r[(r >= -NEAR) & np.isfinite(r)] for r in relative])
        if not nearest.size:
            return None
        least = np.sort(nearest)[-MOST:][0]
        found = [np.nonzero((r >= least) & np.isfinite(r)) for r in relative]
        side, sample = (np.concatenate([pair[i] for pair in found]) for i in range(2))
        data = np.repeat(np.arange(len(found)), [pair[0].size for pair in found])
        excess = np.concatenate([r[pair] for r, pair in zip(relative, found, strict=True)])
        rows = self._slopes(values, side, data, sample)
        kept = [bound.kept for bound in self._bounds]
        numbers = np.array([kept[d][s] for d, s in zip(data, sample, strict=True)])
        return NearActiveSamples(side, data, numbers, excess, rows)

    def _slopes(self, values: Float, side: Int, data: Int, sample: Int) -> Float:
        """The slopes of limited nodes at some samples, relative to the scales; shape (samples, values)."""
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
        self._aim()
        self._penalised.reread_targets()
        return rows

    def reset(self) -> None:
        """Forget all multipliers."""
        self._shifts = [np.zeros(mask.shape) for mask in self._masks]
        self._aim()
        self._penalised.reread_targets()

    def _compiled(self) -> CompiledProblem:
        """The problem with a criterion for each side, whose weight is one over the square of the side's scale."""
        problem = self._problem
        targets = {
            (side.node, id(bound.dataset)): np.empty(bound.count) for bound in self._bounds for side in self._sides
        }
        criteria = [
            Criterion(side.node, 0.0, 1 / scale**2, "excess")
            for side, scale in zip(self._sides, self._scales, strict=True)
        ]
        given = {f.name: getattr(problem, f.name) for f in fields(Problem)}
        made = _Penalised(**given | {"criteria": (*problem.criteria, *criteria)}, targets=targets)
        self._targets = targets
        self._aim()
        return CompiledProblem(made)

    def penalised(self, weight: float) -> LeastSquaresObjective:
        """The cost and `weight` times what exceeds the limits, relative to their scales, squared."""
        known = len(self._problem.criteria)
        return LeastSquaresObjective(self._penalised.reweighted(np.repeat([1.0, weight], [known, len(self._sides)])))

    def _aim(self) -> None:
        """Write the targets: the bounds, lowered by the shifts."""
        for bound, mask, shift in zip(self._bounds, self._masks, self._shifts, strict=True):
            for i, side in enumerate(self._sides):
                self._targets[side.node, id(bound.dataset)][:] = (side.bound - shift[i]) * mask[i]

    def press(self, excess: Sequence[Float], heavier: float = 1.0) -> float:
        """Move the multipliers to what the excess tells; returns the sum of multiplier times distance from the side.

        That sum, for a weight of 1, bounds what the cost can still fall: it is 0 where each multiplier that is not 0
        belongs to a limit that is just met.
        """
        gap = 0.0
        for i, far in enumerate(excess):
            known = np.where(np.isnan(far), 0.0, far)
            new = np.where(np.isnan(far), 0.0, np.maximum(known + self._shifts[i], 0.0))
            gap += float(np.sum(2 * new * np.abs(known) / self._scales[:, None] ** 2))
            self._shifts[i] = new / heavier
        self._aim()
        self._penalised.reread_targets()
        return gap


def _visits(order: Order | None, samples: Int) -> Int:
    """When samples are visited."""
    if order is None:
        return samples
    sorter = np.argsort(order)
    return np.asarray(sorter[np.searchsorted(order, samples, sorter=sorter)])
