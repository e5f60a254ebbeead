"""Assessment of the uncertainty at the end of a fit, computed when it is first used."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Bool, Float, Int, ignore_floating_errors
from kennfeld.criteria import Criterion
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import Scorer
from kennfeld.optimize.solver.levenberg_marquardt import Status
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.trust.active_limits import ActiveLimit, distances, outputs_held
from kennfeld.optimize.trust.covariance import Estimate, estimate
from kennfeld.optimize.trust.direction_text import Describer, Direction
from kennfeld.optimize.trust.noise import Group, groups
from kennfeld.optimize.trust.null_space import null_space
from kennfeld.optimize.trust.trust import Trust
from kennfeld.optimize.trust.weak_directions import table_changes, weak_directions
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.threads import blas_threads

MAX_DIRECTIONS = 12
NEGLIGIBLE_STEP = 0.05  # standard deviations


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
            except (np.linalg.LinAlgError, ArithmeticError):  # never lose a result over its uncertainty
                trust = Trust(informed=self.informed)
        del self.compiled, self.scorer, self.outputs
        return trust

    def _trust(self) -> Trust:
        problem, compiled = self.problem, self.compiled
        full = compiled.start.copy()
        full[: self.values.size] = self.values
        parameters = compiled.values.unpack(full, problem.parameters)
        outputs = self.outputs()
        touched = None if outputs is None else outputs.touched(self.values, parameters)
        limits = linear_limits(problem, compiled.values)
        local = estimate(compiled, limits, self.values, self._residual_groups, touched)
        if local is None:
            return Trust(informed=self.informed)
        training, samples = local.groups, count_touching_samples(compiled, full)
        deviation = local.deviation(error=True)
        split = _Split(problem, compiled)
        moved = self.values != compiled.start[: self.values.size]
        informed = {name: self.informed.get(name, also) for name, also in split(local.informed | moved).items()}
        known = np.zeros(self.values.size, dtype=bool)
        for name, columns in split.columns.items():
            known[columns] = informed[name].ravel()
        axes = {name: axis.places[0] for name, axis in split.axes.items()}
        words = Describer(problem.model.graph, parameters, problem.parameters, split(samples), axes)
        moving = {table for axis in split.axes.values() for table, _ in axis.places}
        return Trust(
            noise=_by_criterion(problem.criteria, _noises(problem.criteria, training, local.variances)),
            persistence=_by_criterion(problem.criteria, _persistences(problem.criteria, training)),
            freedom=local.freedom,
            informed=informed,
            samples=split(samples),
            deviation=split(deviation),
            scatter=split(local.deviation(error=False)),
            by_smoothness=split(~local.met & known & np.isfinite(deviation) & (deviation > 0)),
            directions=self._directions(local, split, informed, moved & ~local.informed, parameters, words),
            null_space=null_space(local, split.columns, parameters, moving, words),
            holdings=(*self._active_output_limits(local, outputs, split), *self._distances(split, full)),
            remark=self._remark(local),
            estimate=local,
            columns={name: int(columns[0]) for name, columns in split.columns.items()},
        )

    def _residual_groups(self, values: Float) -> list[Group]:
        problem, compiled = self.problem, self.compiled
        full = compiled.start.copy()
        full[: values.size] = values
        parameters = compiled.values.unpack(full, problem.parameters)
        errors = [self.scorer.errors(bound, parameters) for bound in problem.training]
        return groups(problem.criteria, problem.training, errors, compiled.weighting)

    def _directions(
        self,
        local: Estimate,
        split: "_Split",
        informed: Mapping[str, Bool],
        searched: Bool,
        parameters: ParameterSet,
        words: Describer,
    ) -> tuple[Direction, ...]:
        """Describe undetermined values and those only `searched`, table by table; then the weak directions."""
        held = split(local.reduction.held)
        undetermined = {name: ~seen & ~held[name] for name, seen in informed.items()}
        idle = [words.uninformed(name, where) for name, where in undetermined.items() if where.any()]
        flat = {name: where & ~held[name] for name, where in split(searched).items() if name not in split.axes}
        idle += [words.searched(name, where) for name, where in flat.items() if where.any()]
        tables = {name: where for name, where in held.items() if name not in split.axes}
        candidates = table_changes(self.problem.model.graph, parameters, tables)
        changes = np.zeros((len(candidates), self.values.size))
        for row, shape in zip(changes, candidates, strict=True):
            row[split.columns[shape.table]] = shape.change.ravel()
        weak = weak_directions(local, candidates, changes, MAX_DIRECTIONS) if local.seen.any() else []
        described = [
            words.named(w, split(w.change)) if w.amounts else words.by_points(w, split(w.change), split(w.weight))
            for w in weak
        ]
        return (*idle, *described)

    def _active_output_limits(
        self, local: Estimate, outputs: OutputLimits | None, split: "_Split"
    ) -> Iterator[ActiveLimit]:
        if outputs is not None and local.pressed is not None:
            bounds = self.problem.training
            yield from outputs_held(local.pressed, outputs.sides, bounds, split.columns, np.sqrt(local.own))

    def _distances(self, split: "_Split", full: Float) -> Iterator[ActiveLimit]:
        names = {axis.key: name for name, axis in split.axes.items()}
        return distances(self.problem.free_axes, self.compiled.values, full, names)

    def _remark(self, local: Estimate) -> str:
        if self.status == "converged":
            return ""
        step = local.distance
        size = f"by up to {step:.2g} standard deviations" if step >= NEGLIGIBLE_STEP else "by a negligible amount"
        return (
            f"The search ended with status {self.status}. The gradient suggests that values would still move {size}; "
            "uncertainties refer to the last iterate."
        )


def count_touching_samples(compiled: CompiledProblem, full: Float) -> Int:
    """Count the scored samples that influence each free value; `full` are the free and the fixed values.

    Samples that are only simulated, because of `where`, the warmup or a missing target, do not count. A steady-state
    point that is held until the model has settled counts once for all samples over which it is averaged.
    """
    bounds = compiled.problem.gathered
    averaged = any(bound.hold is not None and bound.hold.window > 1 for bound in bounds)
    parts = averaged and compiled.accumulator.stateful
    return compiled.accumulator.touched(full, _owners(compiled, bounds) if parts else None)


def _owners(compiled: CompiledProblem, bounds: tuple[BoundDataset, ...]) -> Int:
    """Return for each sample the scored sample in whose average it takes part, -1 if there is none."""
    samples = compiled.samples
    owners = np.full(samples.count, -1, dtype=np.int64)
    for piece in samples.pieces:
        visits = np.arange(piece.first, piece.last)
        scored = np.isfinite(samples.targets_of(visits)[piece.scores > 0]).any(axis=0)
        owners[visits[scored]] = visits[scored]
    end = 0
    for bound in bounds:
        first, end = end, end + bound.count
        if bound.hold is not None:
            points = owners[first:end].reshape(-1, bound.hold.samples)
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


def _noises(criteria: Sequence[Criterion], training: Sequence[Group], variances: Sequence[float]) -> list[float]:
    """Return the standard deviation of the noise of each criterion in the unit of its target, over all its groups."""
    noises = []
    for i, criterion in enumerate(criteria):
        own = [(g, v / g.slope**2 / g.typical) for g, v in zip(training, variances, strict=True) if g.criterion == i]
        total = sum(group.count for group, _ in own)
        mean = sum(group.count * variance for group, variance in own) / total if total else float("nan")
        noises.append(criterion.scale * float(np.sqrt(mean)))
    return noises


def _persistences(criteria: Sequence[Criterion], training: Sequence[Group]) -> list[float]:
    persistences = []
    for i in range(len(criteria)):
        own = [group for group in training if group.criterion == i]
        total = sum(group.count for group in own)
        persistences.append(sum(group.count * group.persistence for group in own) / total if total else 1.0)
    return persistences


def _by_criterion(criteria: Sequence[Criterion], numbers: Sequence[float]) -> dict[str, float]:
    """Key numbers by the node of the criterion, with its target if several criteria have the same node."""
    nodes = [criterion.node for criterion in criteria]
    names = [c.node if nodes.count(c.node) == 1 else f"{c.node} against {c.target}" for c in criteria]
    return dict(zip(names, numbers, strict=True))
