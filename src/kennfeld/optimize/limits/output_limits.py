"""Limits of outputs, kept at every sample of the training data, by an augmented Lagrangian.

Each side of a limit is one more criterion with a loss of what exceeds it, squared. Its target is lowered, sample by
sample, by the multiplier over twice the weight: where a limit presses, the fit is pushed back until it holds. No rows
are stored, so a limit costs what a criterion costs, over any number of samples and with states.
M. Hestenes, Multiplier and gradient methods, 1969; J. Nocedal and S. Wright, Numerical Optimization, chapter 17.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError, nearest
from kennfeld.graph.lowering import dependent
from kennfeld.models import Model
from kennfeld.models.formula import extend
from kennfeld.native.rows import Order
from kennfeld.optimize.criterion import Criterion
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.limits.constraints import Limit
from kennfeld.optimize.limits.limits import Limits
from kennfeld.optimize.objective import SumOfSquares
from kennfeld.optimize.problem import Compiled, Problem
from kennfeld.optimize.scoring import Nodes
from kennfeld.optimize.solver.gauss_newton import Descent, Iteration, Settings, gauss_newton
from kennfeld.parameters import ParameterSet

__all__ = ["OutputLimits", "Side", "Touched", "channels_of", "check_limits"]

FEASIBLE = 1e-6  # of a limit's scale: what counts as kept
TIGHT = 1e-6  # share of the cost that a better choice of multipliers might still save
ROUNDS = 40  # updates of the multipliers
STUBBORN = 0.25  # share of the excess that may be left after a round before the weight grows
HEAVIER = 10.0
NEAR = 1e-4  # of a limit's scale: what counts as met, as the multipliers leave little more
MOST = 400  # samples at which limits are linearised
HEAVIEST = 1e12  # times the first weight: beyond, the limits cannot be met

Report = Callable[[str, Iteration, Float], None]


@dataclass(frozen=True)
class Side:
    """One side of a limit: `node`, made to be kept at or below `bound`."""

    limit: Limit
    number: int
    sign: int

    @property
    def node(self) -> str:
        """A node that no formula text can name."""
        return f"\0limit {self.number} {'above' if self.sign > 0 else 'below'}"

    @property
    def where(self) -> str:
        """The node of the condition."""
        return f"\0limit {self.number} where"

    @property
    def bound(self) -> float:
        """What the node shall not exceed."""
        return self.limit.upper if self.sign > 0 else -self.limit.lower

    def __str__(self) -> str:
        sign, bound = ("<=", self.limit.upper) if self.sign > 0 else (">=", self.limit.lower)
        return f"{self.limit.node} {sign} {bound:g}"


def _sides(limits: Sequence[Limit]) -> tuple[Side, ...]:
    """The sides that bound something."""
    sides = [Side(limit, number, sign) for number, limit in enumerate(limits, 1) for sign in (1, -1)]
    return tuple(side for side in sides if np.isfinite(side.bound))


def _extended(model: Model, limits: Sequence[Limit]) -> Model:
    """The model with a node for each side and each condition; raises `InputError` with all that is wrong."""
    texts: dict[str, str] = {}
    for side in _sides(limits):
        texts[side.node] = side.limit.node if side.sign > 0 else f"-({side.limit.node})"
        if side.limit.where:
            texts[side.where] = side.limit.where
    return extend(model, texts, "limit")


def channels_of(model: Model, limits: Sequence[Limit]) -> list[str]:
    """The names in limits that are no names of the model: inputs that only the limits read."""
    try:
        inputs = _extended(model, limits).graph.inputs
    except InputError:
        return []
    return [name for name in inputs if name not in model.graph.inputs]


def check_limits(problem: Problem) -> list[Finding]:
    """What is wrong with the limits of a problem."""
    try:
        model = _extended(problem.model, problem.limits)
    except InputError as error:
        return list(error.findings)
    graph = model.graph
    live = dependent(graph, lambda node: node.op == "lookup" and node.payload in problem.free_names)
    unknown = channels_of(problem.model, problem.limits)

    def mend(name: str, data: Dataset) -> str:
        return nearest(name, [*problem.model.graph.names, *problem.parameters, *data])

    findings = [
        Finding("limit", f"{name} is no node of the function and no channel of dataset {data.name}", mend(name, data))
        for name in unknown
        for data in problem.datasets
        if data.use == "training" and problem.channels.get(name, name) not in data
    ]
    findings += [
        Finding(f"limit {side}", f"its condition {side.limit.where} depends on a free parameter", "Use channels alone.")
        for side in _sides(problem.limits)
        if side.limit.where and graph.names[side.where] in live
    ]
    return findings


@dataclass(frozen=True)
class Touched:
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

    def target(self, criterion: Criterion, bound: Bound) -> Float:
        """That of the problem, or of a side: read where it lies."""
        known = self.targets.get((criterion.node, id(bound.dataset)))
        return super().target(criterion, bound) if known is None else known


class OutputLimits:
    """The limits of a problem: how far they are exceeded, and a descent that ends where they hold."""

    def __init__(self, problem: Problem) -> None:
        findings = check_limits(problem)
        if findings:
            raise InputError(findings)
        self._sides = _sides(problem.limits)
        model = _extended(problem.model, problem.limits)
        self._problem = replace(problem, model=model, limits=())
        self._bounds = self._problem.gathered
        names = [side.node for side in self._sides]
        self._nodes = Nodes(model.graph, problem.parameters, names)
        self._masks = self._conditions(model)
        self._shifts = [np.zeros(mask.shape) for mask in self._masks]
        self._scales = self._sizes()
        self._penalised = self._compiled()

    def _conditions(self, model: Model) -> list[Float]:
        """For each dataset, 1 where a side counts and NaN elsewhere; shape (sides, samples)."""
        wheres = list(dict.fromkeys(side.where for side in self._sides if side.limit.where))
        nodes = Nodes(model.graph, self._problem.parameters, wheres)
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
    def sides(self) -> tuple[Side, ...]:
        """The sides of the limits that bound something."""
        return self._sides

    def touched(self, values: Float, parameters: ParameterSet) -> Touched | None:
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
        return Touched(side, data, numbers, excess, rows)

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

    def descend(
        self,
        objective: SumOfSquares,
        start: Float,
        limits: Limits,
        settings: Settings,
        parameters_of: Callable[[Float], ParameterSet],
        report: Report,
    ) -> Descent:
        """The best values that keep the limits, from `start`; `objective` is the cost without limits.

        Status `infeasible` where no values were found that keep them.
        """
        self._shifts = [np.zeros(mask.shape) for mask in self._masks]
        self._aim()
        self._penalised.reread_targets()
        return _Rounds(self, objective, limits, settings, parameters_of, report).run(start)

    def _compiled(self) -> Compiled:
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
        return Compiled(made)

    def penalised(self, weight: float) -> SumOfSquares:
        """The cost and `weight` times what exceeds the limits, relative to their scales, squared."""
        known = len(self._problem.criteria)
        return SumOfSquares(self._penalised.reweighted(np.repeat([1.0, weight], [known, len(self._sides)])))

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


class _Rounds:
    """The outer iteration: descend, look how far the limits are exceeded, press harder there."""

    def __init__(
        self,
        limits: OutputLimits,
        objective: SumOfSquares,
        linear: Limits,
        settings: Settings,
        parameters_of: Callable[[Float], ParameterSet],
        report: Report,
    ) -> None:
        self.limits, self.objective, self.linear, self.settings = limits, objective, linear, settings
        self.parameters_of, self.report = parameters_of, report
        self.iterations = self.evaluations = 0

    def run(self, start: Float) -> Descent:
        at = start
        excess = self.limits.excess(self.parameters_of(at))
        weight = first = self._weight(at, excess)
        penalised = self.limits.penalised(weight)
        before = self.limits.largest(excess)
        for number in range(1, ROUNDS + 1):
            found = gauss_newton(penalised, at, self.linear, self.settings, self._told(number))
            self.iterations += found.iterations
            self.evaluations += found.evaluations
            at = found.values
            excess = self.limits.excess(self.parameters_of(at))
            worst = self.limits.largest(excess)
            if found.status in ("stopped", "failed"):
                return self._end(found, at)
            slow = worst > FEASIBLE and worst > STUBBORN * max(before, 0.0)
            heavier = HEAVIER if slow else 1.0
            gap = weight * self.limits.press(excess, heavier)
            if worst <= FEASIBLE and gap <= TIGHT * self.objective.cost(at):
                return self._end(found, at)
            if slow:
                weight *= HEAVIER
                if weight > HEAVIEST * first:
                    break
                penalised = self.limits.penalised(weight)
            before = worst
        return self._infeasible(at, found)

    def _weight(self, at: Float, excess: Sequence[Float]) -> float:
        """A first weight at which the cost and the excess pull alike."""
        total = sum(self.limits.squares(excess))
        cost = self.objective.cost(at)
        return max(cost, 1e-300) / total if total > 0 and np.isfinite(cost) else max(cost, 1.0)

    def _told(self, number: int) -> Callable[[Iteration, Float], None]:
        def tell(line: Iteration, values: Float) -> None:
            self.report(f"limits {number}", replace(line, cost=self.objective.cost(values)), values)

        return tell

    def _end(self, found: Descent, at: Float) -> Descent:
        cost = self.objective.cost(at)
        return replace(found, values=at, cost=cost, iterations=self.iterations, evaluations=self.evaluations)

    def _infeasible(self, at: Float, found: Descent) -> Descent:
        if self.limits.kept(self.parameters_of(at)):
            return self._end(found, at)
        message = f"The limits of outputs cannot all be kept: {self.limits.told(self.parameters_of(at))}."
        return replace(self._end(found, at), status="infeasible", message=message)
