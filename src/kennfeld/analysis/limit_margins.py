"""Active limits at given values, and the range of limited outputs."""

from dataclasses import dataclass, replace

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.constraints import Equality, Limit, Shape
from kennfeld.errors import Location
from kennfeld.free_axes import free_axes, with_fixed_axes
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.models.formula import extend
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.parameter_set import ParameterSet

ACTIVE = 1e-7  # of the terms of a row: closer than this is at the limit


@dataclass(frozen=True)
class ActiveConstraint:
    """A linear limit at given values: the number of its `rows`, and the labels of the active ones."""

    constraint: Shape | Equality
    rows: int
    active: tuple[str, ...]


def active_constraints(problem: Problem, parameters: ParameterSet) -> tuple[ActiveConstraint, ...]:
    """Return for each shape and equality of a problem its active rows.

    Args:
        problem: with the constraints.
        parameters: the values.
    """
    offsets = np.cumsum([0, *(problem.parameters[name].size for name in problem.free_names)]).tolist()
    values = ValueLayout(dict(zip(problem.free_names, offsets, strict=False)), offsets[-1], 0, offsets[-1])
    flat = np.concatenate([np.zeros(0), *(parameters[name].values.ravel() for name in problem.free_names)])
    fixed = with_fixed_axes(parameters, free_axes(parameters))  # at the current breakpoints
    constraints = []
    for constraint in problem.constraints:
        alone = replace(problem, parameters=fixed, pins=(), constraints=(constraint,), limits=())
        rows = linear_limits(alone, values).rows
        product, size = rows.times(flat), rows.size(flat)
        active = np.flatnonzero(_near(product, rows.lower, size) | _near(product, rows.upper, size))
        constraints.append(ActiveConstraint(constraint, rows.count, tuple(rows.names[i] for i in active)))
    return tuple(constraints)


def _near(product: Float, side: Float, size: Float) -> Bool:
    with np.errstate(invalid="ignore"):
        return np.isfinite(side) & (np.abs(product - side) <= ACTIVE * (size + np.abs(side)))


@dataclass(frozen=True)
class OutputRange:
    """Range of a limited output over the training samples at which the limit applies; `beyond` of them exceed it."""

    limit: Limit
    samples: int
    beyond: int
    least: float
    greatest: float


def output_ranges(problem: Problem, parameters: ParameterSet) -> tuple[OutputRange, ...]:
    """Return the range of each limited output at given values."""
    if not problem.limits:
        return ()
    texts = {f"\0output {i}": limit.node for i, limit in enumerate(problem.limits)}
    wheres = {f"\0where {i}": limit.where for i, limit in enumerate(problem.limits) if limit.where}
    grown = replace(
        problem, model=extend(problem.model, texts | wheres, Location("limit")), limits=(), parameters=parameters
    )
    nodes = NodeSimulator(grown.model.graph, parameters, [*texts, *wheres])
    parts = [[np.zeros(0)] for _ in problem.limits]
    for bound in grown.training:
        values = dict(zip([*texts, *wheres], nodes.values(bound, parameters), strict=True))
        for i, part in enumerate(parts):
            applies = bound.scored & (values.get(f"\0where {i}", np.ones(bound.count)) != 0)
            part.append(values[f"\0output {i}"][applies])
    return tuple(map(_output_range, problem.limits, map(np.concatenate, parts)))


def _output_range(limit: Limit, values: Float) -> OutputRange:
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if known.size else (np.nan, np.nan)
    scale = 1e-6 * np.array([abs(limit.lower), abs(limit.upper)])
    slack = np.where(np.isfinite(scale) & (scale > 0), scale, 1e-6 * max(abs(low), abs(high)) if known.size else 0)
    within = (values >= limit.lower - slack[0]) & (values <= limit.upper + slack[1])
    return OutputRange(limit, values.size, int(np.count_nonzero(~within)), float(low), float(high))
