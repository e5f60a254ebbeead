"""Assessment of the uncertainty at the end of a fit, computed when it is first used."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, Int, ignore_floating_errors
from kennfeld.base.task_runner import RunnerLostError
from kennfeld.base.threads import blas_threads
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import FEASIBLE
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.solver.levenberg_marquardt import Status
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.jumps import jumps_of
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.active_limits import describe_distances, describe_output_limits
from kennfeld.optimize.trust.covariance import Estimate, estimate
from kennfeld.optimize.trust.direction_text import Describer, Direction
from kennfeld.optimize.trust.flat_intervals import flat_intervals
from kennfeld.optimize.trust.matrices import coupling
from kennfeld.optimize.trust.noise import (
    Classes,
    Group,
    GroupSums,
    groups,
    noise_of_criteria,
    persistence_of_criteria,
    sum_groups,
)
from kennfeld.optimize.trust.null_space import null_space
from kennfeld.optimize.trust.second_minimum import SecondMinimum, second_minima
from kennfeld.optimize.trust.table_changes import WeakDirection, table_changes
from kennfeld.optimize.trust.trust import Trust
from kennfeld.optimize.trust.weak_directions import weak_directions
from kennfeld.optimize.trust.weight_text import describe_weights
from kennfeld.preprocessing.binding import BoundDataset

MAX_DIRECTIONS = 12
MAX_EQUAL_WEIGHT = 0.99  # of a second minimum, beyond which its cost is lower by more than noise
SCALED = 0.1  # change of values by which factors are distinguished from differences
UNCHANGED = 1e-9  # difference of two costs, relative to them, that is rounding
NEGLIGIBLE_STEP = 0.05  # standard deviations
EXACTLY_KNOWN = 1e-9  # standard deviation along a direction, relative to each value, that needs no words


class TrustAssessment:
    """Computes the `Trust` of a fit on first use.

    The compiled problem and its data are kept until then. Pickling computes the trust and keeps nothing else.

    Args:
        problem: the problem that was fitted.
        values: the free values at the end of the fit; shape (values,).
        informed: values that data or smoothness determine, by parameter.
        compiled: the compiled problem.
        scorer: evaluates the model on datasets.
        outputs: returns the output limits of the fit, if it has any.
        status: status of the search.
    """

    def __init__(
        self,
        problem: Problem,
        values: Float,
        informed: Mapping[str, Bool],
        compiled: CompiledProblem,
        scorer: Scorer,
        outputs: Callable[[], OutputLimits | None] = lambda: None,
        status: Status = "converged",
    ) -> None:
        self.problem, self.values, self.informed = problem, values, informed
        self.compiled, self.scorer, self.outputs, self.status = compiled, scorer, outputs, status

    def __getstate__(self) -> dict[str, Any]:
        return {"trust": self.trust}

    @cached_property
    def trust(self) -> Trust:
        """The trust; without uncertainties if they cannot be computed."""
        with blas_threads(self.values.size), ignore_floating_errors():
            try:
                trust = self._trust()
            except (np.linalg.LinAlgError, ArithmeticError, RunnerLostError):  # never lose a result over this
                trust = Trust(informed=self.informed)
        # a result would keep its data alive with them
        del self.compiled, self.scorer, self.outputs
        self.__dict__.pop("_objective", None)
        return trust

    @cached_property
    def _objective(self) -> LeastSquaresObjective:
        return LeastSquaresObjective(self.compiled)

    def _trust(self) -> Trust:
        problem, compiled = self.problem, self.compiled
        full, parameters = compiled.full(self.values), compiled.parameters(self.values)
        outputs = self.outputs()
        touched = None if outputs is None else outputs.near_active(self.values)
        limits = linear_limits(problem, compiled.values)
        local = estimate(compiled, limits, self.values, self._residual_groups, touched)
        if local is None:
            return Trust(informed=self.informed)
        samples = count_touching_samples(compiled, full)
        split = _Split(problem, compiled)
        moved = self.values != compiled.start[: self.values.size]
        informed = {name: self.informed.get(name, also) for name, also in split(local.informed | moved).items()}
        # `informed` as the fit reports it, over all free values
        known = np.zeros(self.values.size, dtype=bool)
        for name, columns in split.columns.items():
            known[columns] = informed[name].ravel()
        axes = {name: axis.places[0] for name, axis in split.axes.items()}
        admits = partial(_keeps_limits, limits, self.values)
        words = Describer(problem.model.graph, parameters, problem.parameters, split(samples), axes, admits)
        moving = {table for axis in split.axes.values() for table, _ in axis.places}
        weak = self._weak_directions(local, split, parameters)
        minima = self._second_minima(limits, local, weak, outputs, split)
        # mean square distance to the other minimum, by its probability; of several, the largest
        apart = np.max([minimum.weight * minimum.change**2 for minimum in minima], axis=0, initial=0.0)
        deviation = np.sqrt(local.deviation(error=True) ** 2 + apart)
        holdings = [
            *describe_distances(problem.free_axes, compiled.values, full, {a.key: n for n, a in split.axes.items()})
        ]
        if outputs is not None and local.pressed is not None:
            sizes = np.sqrt(local.own)
            holdings[:0] = describe_output_limits(local.pressed, outputs.sides, problem.training, split.columns, sizes)
        return Trust(
            noise=noise_of_criteria(problem.criteria, local.groups, local.variances),
            persistence=persistence_of_criteria(problem.criteria, local.groups),
            freedom=local.freedom,
            informed=informed,
            samples=split(samples),
            deviation=split(deviation),
            scatter=split(local.deviation(error=False)),
            by_smoothness=split(~(local.own > 0) & known & np.isfinite(deviation) & (deviation > 0)),
            directions=self._directions(
                local, split, informed, moved & ~local.informed, parameters, words, weak, minima
            ),
            null_space=null_space(local, split.columns, parameters, moving, words),
            holdings=tuple(holdings),
            remark=self._remark(local),
            estimate=local,
            columns={name: int(columns[0]) for name, columns in split.columns.items()},
        )

    def _residual_groups(self, values: Float) -> list[Group]:
        errors = partial(self.scorer.errors, parameters=self.compiled.parameters(values))
        weighting, partial_sums = self.compiled.weighting, None
        if self.problem.partitions is not None:
            partial_sums = partial(self.compiled.each, _sum_residuals, values)
        return groups(self.problem, errors, weighting, partial_sums)

    def _weak_directions(self, local: Estimate, split: "_Split", parameters: ParameterSet) -> list[WeakDirection]:
        """Return the poorly determined directions, worst first."""
        if not local.seen.any():
            return []
        fixed = split(local.reduction.fixed)
        tables = {name: where for name, where in fixed.items() if name not in split.axes}
        coupled = _coupled_tables(local, split.columns, list(tables))
        candidates = table_changes(self.problem.model.graph, parameters, tables, coupled)
        # each table change as a row over all values, 0 outside of its table
        changes = np.zeros((len(candidates), self.values.size))
        for row, shape in zip(changes, candidates, strict=True):
            row[split.columns[shape.table]] = shape.change.ravel()
        return weak_directions(local, candidates, changes, MAX_DIRECTIONS)

    def _second_minima(
        self,
        limits: LinearLimits,
        local: Estimate,
        weak: Sequence[WeakDirection],
        outputs: OutputLimits | None,
        split: "_Split",
    ) -> list[SecondMinimum]:
        if self.status != "converged":
            return []

        def surroundings(values: Float) -> tuple[Estimate, list[WeakDirection]] | None:
            touched = None if outputs is None else outputs.near_active(values)
            there = estimate(self.compiled, limits, values, self._residual_groups, touched)
            if there is None:
                return None
            return there, _named(self._weak_directions(there, split, self.compiled.parameters(values)))

        allowed = (lambda values: True) if outputs is None else outputs.is_satisfied
        return [*second_minima(self._objective, limits, self.values, local, _named(weak), surroundings, allowed)]

    def _directions(
        self,
        local: Estimate,
        split: "_Split",
        informed: Mapping[str, Bool],
        searched: Bool,
        parameters: ParameterSet,
        words: Describer,
        weak: Sequence[WeakDirection],
        minima: Sequence[SecondMinimum],
    ) -> tuple[Direction, ...]:
        """Describe undetermined values and those only `searched`, table by table; then the weak directions.

        A direction in which another minimum is known is described by that alone, and what determines the values of its
        tables around this one is left out.
        """
        fixed = split(local.reduction.fixed)
        tables = {name: where for name, where in fixed.items() if name not in split.axes}
        uninformed = {name: ~known & ~fixed[name] for name, known in informed.items()}
        flat = {name: split(searched)[name] & ~where for name, where in tables.items()}
        jumping = self._jumping() if any(where.any() for where in uninformed.values()) else frozenset()
        directions = [
            words.jumping(name, where) if name in jumping else words.uninformed(name, where)
            for name, where in uninformed.items()
            if where.any()
        ]
        intervals = split.last(self._flat_intervals(searched & ~local.reduction.fixed))
        # weights are summarised below
        directions += [
            words.searched(name, where, intervals[name])
            for name, where in flat.items()
            if where.any() and name not in words.layers
        ]
        beyond = [self._describe_minimum(minimum, split, words) for minimum in minima]
        directions += beyond
        towards = [id(minimum.direction) for minimum in minima]
        of_layers: list[tuple[WeakDirection, bool]] = []
        for direction in (each for each in weak if id(each) not in towards and not self._is_exactly_known(each)):
            parts, weights = split(direction.change), split(direction.weight)
            names = [] if direction.amounts else words.strongest(weights)
            if direction.amounts:
                directions.append(words.named(direction, parts, scaled=self._is_scaled(direction)))
            elif not words.layers.issuperset(names):
                directions.append(words.by_points(direction, parts, weights))
            if words.layers.intersection(names):
                of_layers.append((direction, words.layers.issuperset(names)))
        if of_layers:
            # one that changes weights only, if there is any; of equals, max takes the first, which is the worst
            worst, alone = max(of_layers, key=lambda pair: pair[1])
            parts = {name: part for name, part in split(worst.change).items() if name in words.layers}
            directions += describe_weights(worst, parts, split(local.deviation(error=True)), parameters, alone=alone)
        ambiguous = {name for direction in beyond for name in direction.parts}
        directions = [each for each in directions if not (each.determined and ambiguous.intersection(each.parts))]
        return tuple(sorted(directions, key=lambda direction: direction.determined))

    def _jumping(self) -> frozenset[str]:
        """Return the parameters that decide when the function jumps."""
        return frozenset(name for event in jumps_of(self.problem) for name in event.parameters)

    def _flat_intervals(self, which: Bool) -> Float:
        if not which.any():
            return np.full((2, self.values.size), np.nan)
        limits = linear_limits(self.problem, self.compiled.values)
        return flat_intervals(
            self._objective.cost, self.values, np.flatnonzero(which), np.array([limits.lower, limits.upper])
        )

    def _describe_minimum(self, minimum: SecondMinimum, split: "_Split", words: Describer) -> Direction:
        weak, costs = minimum.direction, (self._objective.cost(self.values), minimum.cost)
        equal = minimum.weight < MAX_EQUAL_WEIGHT
        return words.second_minimum(weak, split(weak.change), split(minimum.change), costs, equal=equal)

    def _is_exactly_known(self, direction: WeakDirection) -> bool:
        """Return True if data without noise determine a direction to nearly all digits."""
        sizes = np.abs(self.values)
        least = np.min(sizes[sizes > 0], initial=1.0)
        steps = direction.deviation * np.abs(direction.change)
        return not direction.exact and bool(np.all(steps <= EXACTLY_KNOWN * np.maximum(sizes, least)))

    def _is_scaled(self, direction: WeakDirection) -> bool:
        """Return True if factors of the values change the cost of the data less than differences do.

        Both are the same to first order: the data determine the product of two values or their sum. Neither changes a
        quotient.
        """
        if sum(shape.kind == "scale" for shape, _ in direction.amounts) < 2:
            return True
        change = direction.change * SCALED / max(abs(amount) for _, amount in direction.amounts)
        # factors exp(c / p) and differences c have the same first derivative; the second one tells them apart
        relative = np.divide(change, self.values, out=np.zeros_like(change), where=self.values != 0)
        factors, differences = (
            self._objective.data_cost(values) for values in (self.values * np.exp(relative), self.values + change)
        )
        return bool(factors <= (1 + UNCHANGED) * differences) or not np.isfinite(differences)

    def _remark(self, local: Estimate) -> str:
        if self.status == "converged":
            return ""
        step = local.distance
        size = f"by up to {step:.2g} standard deviations" if step >= NEGLIGIBLE_STEP else "by a negligible amount"
        return (
            f"The search ended with status {self.status}. The gradient suggests that values would still move {size}; "
            "uncertainties refer to the last iterate."
        )


def _keeps_limits(limits: LinearLimits, values: Float, change: Float) -> bool:
    """Return True if values keep bounds and rows with a change, Float[values]."""
    changed = values + change
    within = (limits.lower <= changed) & (changed <= limits.upper)
    # values that stay may be beyond a bound by rounding
    return bool(np.all(within | (change == 0))) and limits.violation(changed) <= FEASIBLE


def _named(directions: Sequence[WeakDirection]) -> list[WeakDirection]:
    """Return the directions that are combinations of table changes."""
    return [direction for direction in directions if direction.amounts]


def _coupled_tables(local: Estimate, columns: Mapping[str, Int], tables: Sequence[str]) -> dict[str, list[str]]:
    """Return for each table the others that act on the same data, those that do so most first."""
    groups = np.full(local.reduction.size, -1.0)
    for number, name in enumerate(tables):
        groups[columns[name]] = number
    strengths = coupling(local.data, local.narrow(groups).astype(np.int64), len(tables))
    np.fill_diagonal(strengths, 0.0)
    order = np.argsort(-strengths, axis=1, kind="stable")
    return {
        name: [tables[other] for other in row if strengths[number, other] > 0]
        for number, (name, row) in enumerate(zip(tables, order, strict=True))
    }


def count_touching_samples(compiled: CompiledProblem, full: Float) -> Int:
    """Count the scored samples that influence each free value, Int[free]; `full` are all values, Float[values].

    Samples that are only simulated, because of `where`, the warmup or a missing target, do not count. A steady-state
    point that is held until the model has settled counts once for all samples over which it is averaged.
    """
    return np.asarray(sum(compiled.each(_count_touching, full)))


def _count_touching(compiled: CompiledProblem, full: Float) -> Int:
    bounds = compiled.problem.gathered if compiled.sums.stateful else ()
    averaged = any(bound.hold is not None and bound.hold.window > 1 for bound in bounds)
    return compiled.sums.touched(full, _owners(compiled, bounds) if averaged else None)


def _sum_residuals(compiled: CompiledProblem, values: Float, classes: Classes) -> GroupSums:
    """Return the sums over the residuals of one partition."""
    errors = partial(Scorer(compiled.problem).errors, parameters=compiled.parameters(values))
    return sum_groups(compiled.problem, errors, compiled.weighting, classes)


def _owners(compiled: CompiledProblem, bounds: tuple[BoundDataset, ...]) -> Int:
    """Return for each sample the scored sample in whose average it takes part, -1 if there is none."""
    samples = compiled.samples
    owners = np.full(samples.count, -1, dtype=np.int64)
    for piece in samples.pieces:
        visits = np.arange(piece.first, piece.last)
        scored = np.isfinite(samples.targets_of(visits)[piece.scores > 0]).any(axis=0)
        # a scored sample owns itself; below, the samples of a settled point over which it is averaged
        owners[visits[scored]] = visits[scored]
    end = 0
    for bound in bounds:
        first, end = end, end + bound.count
        if bound.hold is not None:
            points = owners[first:end].reshape(-1, bound.hold.samples)
            # the last sample of a point is the scored one
            points[:, -bound.hold.window :] = points[:, -1:]
    return owners


class _Split:
    """Splits arrays over all free values into one for each parameter and each axis with free breakpoints.

    Axes are named `AxisSpeed` or `MapTorque.x`; `axis AxisSpeed` if a parameter has that name.
    """

    def __init__(self, problem: Problem, compiled: CompiledProblem) -> None:
        values, tables = compiled.values, {name: problem.parameters[name] for name in problem.free_names}
        self.axes = {
            f"axis {key}" if str(key) in problem.parameters else str(key): axis
            for key, axis in problem.free_axes.items()
            if values.moving.get(key, values.free) < values.free
        }
        self._shapes = {name: table.values.shape for name, table in tables.items()}
        self._shapes |= {name: (len(axis.axis),) for name, axis in self.axes.items()}
        first = {name: values.offsets[name] for name in tables}
        first |= {name: values.moving[axis.key] for name, axis in self.axes.items()}
        self.columns = {name: at + np.arange(int(np.prod(self._shapes[name]))) for name, at in first.items()}

    def __call__(self, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
        return {name: array[at].reshape(self._shapes[name]) for name, at in self.columns.items()}

    def last(self, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Split an array over all free values in its last dimension."""
        return {name: array[..., at].reshape(-1, *self._shapes[name]) for name, at in self.columns.items()}
