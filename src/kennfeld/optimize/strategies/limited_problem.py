"""A problem whose limits of outputs are criteria, so that they are evaluated like any other, over any samples."""

from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.criteria import Criterion
from kennfeld.optimize.problem.limit_nodes import LimitSide, add_limit_nodes, limit_sides
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.preprocessing.binding import BoundDataset


@dataclass(frozen=True)
class LimitedProblem(Problem):
    """A problem with a further criterion for each side of its limits, after its own ones.

    Its loss is the squared excess over the bound of the side, its weight 1 / scale^2, its target the bound wherever the
    limit applies.

    Attributes:
        sides: the sides with a finite bound.
        scales: of each, the size of its bound; if that is 0, that of the node.
    """

    sides: tuple[LimitSide, ...] = ()
    scales: tuple[float, ...] = ()

    @classmethod
    def of(cls, problem: Problem) -> "LimitedProblem":
        """Return the limits of a problem as criteria."""
        sides = limit_sides(problem.limits)
        extended = replace(problem, model=add_limit_nodes(problem.model, problem.limits), limits=())
        scales = _scales(extended, sides)
        criteria = [
            Criterion(side.node, 0.0, 1 / scale**2, "excess") for side, scale in zip(sides, scales, strict=True)
        ]
        attributes = {f.name: getattr(extended, f.name) for f in fields(Problem)}
        attributes |= {"criteria": (*problem.criteria, *criteria), "sides": sides, "scales": scales}
        return cls(**attributes)

    @property
    def first_side(self) -> int:
        """Number of the criterion of the first side."""
        return len(self.criteria) - len(self.sides)

    @cached_property
    def _sides_by_node(self) -> dict[str, LimitSide]:
        return {side.node: side for side in self.sides}

    def target(self, criterion: Criterion, bound: BoundDataset) -> Float:
        """Return the target of a criterion, that of a side NaN where its limit does not apply."""
        side = self._sides_by_node.get(criterion.node)
        if side is None:
            return super().target(criterion, bound)
        applies = bound.scored
        if side.limit.where:
            nodes = self.once(side.where, lambda p: NodeSimulator(p.model.graph, p.parameters, [side.where]))
            applies = applies & (nodes.values(bound, self.parameters)[0] != 0)
        return np.where(applies, side.bound, np.nan)

    @property
    def target_sources(self) -> tuple[Any, ...]:
        """The conditions of the limits, with all that they may depend on."""
        if not any(side.limit.where for side in self.sides):
            return ()
        graph = self.model.graph
        fixed = {name: self.parameters[name] for name in graph.parameters if name not in self.free_names}
        return graph, fixed, tuple(side.where for side in self.sides if side.limit.where)


def _scales(problem: Problem, sides: tuple[LimitSide, ...]) -> tuple[float, ...]:
    """Return the scale of each side; `problem` has the nodes of the limits."""
    scales = np.abs([side.bound for side in sides])
    zero = np.flatnonzero(scales == 0)
    if zero.size:
        names = [sides[i].node for i in zero]
        typical = np.max(list(problem.each(_largest_values, names)), axis=0)
        # a bound of 0 says nothing about the size of the node
        scales[zero] = np.where(typical > 0, typical, 1.0)
    return tuple(scales.tolist())


def _largest_values(problem: Problem, names: list[str]) -> Float:
    """Return the largest size of each node over the training data, Float[names]."""
    nodes = problem.once("limited", lambda p: NodeSimulator(p.model.graph, p.parameters, names))
    largest = np.zeros(len(names))
    for bound in problem.gathered:
        values = np.nan_to_num(np.abs(nodes.values(bound, problem.parameters)), nan=0.0, posinf=0.0)
        largest = np.maximum(largest, values.max(axis=1, initial=0.0))
    return largest
