"""Which samples count as training samples of a value.

The end of a fit, from which its trust is computed when somebody asks for it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Bool, Float, Int, silent
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

__all__ = ["TrustAssessment"]

MOST = 12  # directions that are named
SETTLED = 0.05  # standard deviations that a value may still be from its best and count as there


def touching_samples(compiled: CompiledProblem, full: Float) -> Int:
    """For each free value, the scored samples that touch it; `full` are the free and the fixed values.

    A sample that is only simulated, because of `where`, the warmup or a missing target, does not count. A steady-state
    point that is held until the model has settled counts once, for all samples over which it is averaged.
    """
    bounds = compiled.problem.gathered
    averaged = any(bound.hold is not None and bound.hold.window > 1 for bound in bounds)
    parts = averaged and compiled.accumulator.stateful
    return compiled.accumulator.touched(full, _owners(compiled, bounds) if parts else None)


def _owners(compiled: CompiledProblem, bounds: tuple[BoundDataset, ...]) -> Int:
    """For each sample the scored one of which it is a part, -1 where there is none."""
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


class TrustAssessment:
    """What is needed to tell the trust in the values of a fit.

    `values` are the free ones at the end, `informed` marks those that data or smoothness inform. What was compiled, and
    the data with it, is kept until the trust is asked for; what is sent to another process is the trust alone.
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
        """The trust."""
        with blas_threads(self.values.size), silent():
            try:
                found = self._trust()
            except (np.linalg.LinAlgError, ArithmeticError):  # a result is never lost over what is said about it
                found = Trust(informed=self.informed)
        del self.compiled, self.scorer, self.outputs
        return found

    def _trust(self) -> Trust:
        problem, compiled, scorer = self.problem, self.compiled, self.scorer
        full = compiled.start.copy()
        full[: self.values.size] = self.values
        parameters = compiled.values.unpack(full, problem.parameters)

        def judged(values: Float) -> list[Group]:
            there = full.copy()
            there[: values.size] = values
            moved = compiled.values.unpack(there, problem.parameters)
            errors = [scorer.errors(bound, moved) for bound in problem.training]
            return groups(problem.criteria, problem.training, errors, compiled.weighting)

        outputs = self.outputs()
        touched = None if outputs is None else outputs.touched(self.values, parameters)
        found = estimate(compiled, linear_limits(problem, compiled.values), self.values, judged, touched)
        if found is None:
            return Trust(informed=self.informed)
        training, samples = found.groups, touching_samples(compiled, full)
        deviation = found.deviation(error=True)
        split = _Split(problem, compiled)
        moved = self.values != compiled.start[: self.values.size]
        seen = found.informed | moved
        informed = {name: self.informed.get(name, also) for name, also in split(seen).items()}
        known = np.zeros(self.values.size, dtype=bool)
        for name, columns in split.columns.items():
            known[columns] = informed[name].ravel()
        axes = {name: axis.places[0] for name, axis in split.axes.items()}
        words = Describer(problem.model.graph, parameters, problem.parameters, split(samples), axes)
        moving = {table for axis in split.axes.values() for table, _ in axis.places}
        return Trust(
            noise=_by_criterion(problem.criteria, _noises(problem.criteria, training, found.variances)),
            persistence=_by_criterion(problem.criteria, _persistences(problem.criteria, training)),
            freedom=found.freedom,
            informed=informed,
            samples=split(samples),
            deviation=split(deviation),
            scatter=split(found.deviation(error=False)),
            by_smoothness=split(~found.met & known & np.isfinite(deviation) & (deviation > 0)),
            directions=self._directions(found, split, informed, moved & ~found.informed, parameters, words),
            null_space=null_space(found, split.columns, parameters, moving, words),
            holdings=(*self._outputs_held(found, outputs, split), *self._distances(split, full)),
            remark=self._remark(found),
            estimate=found,
            columns={name: int(columns[0]) for name, columns in split.columns.items()},
        )

    def _directions(
        self,
        found: Estimate,
        split: "_Split",
        informed: Mapping[str, Bool],
        searched: Bool,
        parameters: ParameterSet,
        words: Describer,
    ) -> tuple[Direction, ...]:
        """Values that nothing informs, and those only `searched`, table by table; then the weak directions."""
        held = split(found.reduction.held)
        open_values = {name: ~seen & ~held[name] for name, seen in informed.items()}
        idle = [words.uninformed(name, where) for name, where in open_values.items() if where.any()]
        blind = {name: where & ~held[name] for name, where in split(searched).items() if name not in split.axes}
        idle += [words.searched(name, where) for name, where in blind.items() if where.any()]
        tables = {name: where for name, where in held.items() if name not in split.axes}
        candidates = table_changes(self.problem.model.graph, parameters, tables)
        changes = np.zeros((len(candidates), self.values.size))
        for row, shape in zip(changes, candidates, strict=True):
            row[split.columns[shape.table]] = shape.change.ravel()
        weak = weak_directions(found, candidates, changes, MOST) if found.seen.any() else []
        told = [
            words.named(w, split(w.change)) if w.amounts else words.nameless(w, split(w.change), split(w.weight))
            for w in weak
        ]
        return (*idle, *told)

    def _outputs_held(self, found: Estimate, outputs: OutputLimits | None, split: "_Split") -> Iterator[ActiveLimit]:
        if outputs is not None and found.pressed is not None:
            bounds = self.problem.training
            yield from outputs_held(found.pressed, outputs.sides, bounds, split.columns, np.sqrt(found.own))

    def _distances(self, split: "_Split", full: Float) -> Iterator[ActiveLimit]:
        names = {axis.key: name for name, axis in split.axes.items()}
        return distances(self.problem.free_axes, self.compiled.values, full, names)

    def _remark(self, found: Estimate) -> str:
        """A sentence on a search that did not come to its end."""
        if self.status == "converged":
            return ""
        far = found.distance
        message = f"by {far:.2g} standard deviations" if far >= SETTLED else "by next to nothing"
        return (
            f"The search ended as {self.status}. By the slopes at its end a value would still move {message}; "
            "what is said of the values holds around that end."
        )


class _Split:
    """Cuts arrays over all free values into those of the parameters, and of the axes whose breakpoints are free.

    An axis is called as elsewhere, `AxisSpeed` or `MapTorque.x`; where a parameter has that name, `axis AxisSpeed`.
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

    def __call__(self, whole: NDArray[Any]) -> dict[str, NDArray[Any]]:
        return {name: whole[at].reshape(self._shapes[name]) for name, at in self.columns.items()}


def _noises(criteria: Sequence[Criterion], training: Sequence[Group], variances: Sequence[float]) -> list[float]:
    """The noise of each criterion in its target's unit, over all its groups."""
    found = []
    for i, criterion in enumerate(criteria):
        own = [(g, v / g.slope**2 / g.typical) for g, v in zip(training, variances, strict=True) if g.criterion == i]
        total = sum(group.count for group, _ in own)
        mean = sum(group.count * variance for group, variance in own) / total if total else float("nan")
        found.append(criterion.scale * float(np.sqrt(mean)))
    return found


def _persistences(criteria: Sequence[Criterion], training: Sequence[Group]) -> list[float]:
    found = []
    for i in range(len(criteria)):
        own = [group for group in training if group.criterion == i]
        total = sum(group.count for group in own)
        found.append(sum(group.count * group.persistence for group in own) / total if total else 1.0)
    return found


def _by_criterion(criteria: Sequence[Criterion], numbers: Sequence[float]) -> dict[str, float]:
    """By the criterion's node; with its target where two have the same node."""
    nodes = [criterion.node for criterion in criteria]
    names = [c.node if nodes.count(c.node) == 1 else f"{c.node} against {c.target}" for c in criteria]
    return dict(zip(names, numbers, strict=True))
