"""Active limits at given values, and the range of limited outputs."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.task_runner import RunnerLostError
from kennfeld.domain.constraints import Equality, Limit, Shape
from kennfeld.domain.free_axes import free_axes, with_fixed_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.models.formula import extend
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator

ACTIVE = 1e-7  # of the terms of a row: closer than this is at the limit


@dataclass(frozen=True)
class ActiveConstraint:
    """A linear limit at given values.

    Attributes:
        rows: their number.
        active: labels of the rows at a side.
        excess: how far the worst row is beyond a side, in the unit of the row; 0 if none is.
        worst: label of that row, empty if none is.
    """

    constraint: Shape | Equality
    rows: int
    active: tuple[str, ...]
    excess: float = 0.0
    worst: str = ""


def active_constraints(problem: Problem, parameters: ParameterSet) -> tuple[ActiveConstraint, ...]:
    """Find the active rows of each shape and equality of a problem.

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
        # one at a time, so that its rows are known as its own
        alone = replace(problem, parameters=fixed, pins=(), constraints=(constraint,), limits=())
        rows = linear_limits(alone, values).rows
        product, size = rows.times(flat), rows.size(flat)
        at_side = _near(product, rows.lower, size) | _near(product, rows.upper, size)
        active = tuple(rows.names[i] for i in np.flatnonzero(at_side))
        # what is at a side is beyond it by rounding only
        beyond = np.where(at_side, 0.0, np.maximum(rows.lower - product, product - rows.upper))
        excess = float(beyond.max(initial=0.0))
        worst = rows.names[int(beyond.argmax())] if excess > 0 else ""
        constraints.append(ActiveConstraint(constraint, rows.count, active, excess, worst))
    return tuple(constraints)


def _near(product: Float, side: Float, size: Float) -> Bool:
    with np.errstate(invalid="ignore"):
        # relative to the terms of the sum, whose rounding the product has; of infinite sides inf - inf is NaN
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
    """Compute the range of each limited output at given values, in its unit.

    Empty without limits, or if the data are on a cluster that is gone.
    """
    if not problem.limits:
        return ()
    try:
        # two passes: what counts as beyond a limit of 0 depends on the range of the output
        spans = _merged(problem.each(_spans, parameters))
        slack = [_slack(limit, span) for limit, span in zip(problem.limits, spans, strict=True)]
        counts = np.sum([*problem.each(_count_beyond, parameters, slack)], axis=0).tolist()
    except RunnerLostError:
        return ()
    return tuple(
        OutputRange(limit, span.samples, beyond, *(span.least, span.greatest) if span.known else (np.nan, np.nan))
        for limit, span, beyond in zip(problem.limits, spans, counts, strict=True)
    )


class _Span(NamedTuple):
    """Number of samples, True if one is finite, and the range of those."""

    samples: int = 0
    known: bool = False
    least: float = np.inf
    greatest: float = -np.inf


def _limited_outputs(problem: Problem, parameters: ParameterSet) -> Iterator[tuple[int, Float]]:
    """Yield the number of a limit and the values of its output where it applies, dataset by dataset."""
    texts = {f"\0output {i}": limit.node for i, limit in enumerate(problem.limits)}
    wheres = {f"\0where {i}": limit.where for i, limit in enumerate(problem.limits) if limit.where}
    model = extend(problem.model, texts | wheres, Location("limit"))
    # the training data are bound again with the inputs that only the limits read
    grown = replace(problem, model=model, limits=(), parameters=parameters, partitions=None)
    nodes = problem.once("limited outputs", lambda _: NodeSimulator(model.graph, parameters, [*texts, *wheres]))
    for bound in grown.training:
        values = dict(zip([*texts, *wheres], nodes.values(bound, parameters), strict=True))
        for i in range(len(problem.limits)):
            applies = bound.scored & (values.get(f"\0where {i}", np.ones(bound.count)) != 0)
            yield i, values[f"\0output {i}"][applies]


def _spans(problem: Problem, parameters: ParameterSet) -> list[_Span]:
    spans = [_Span() for _ in problem.limits]
    for i, values in _limited_outputs(problem, parameters):
        known = values[np.isfinite(values)]
        ends = (known.min(), known.max()) if known.size else (np.inf, -np.inf)
        spans[i] = _joined(spans[i], _Span(values.size, bool(known.size), *map(float, ends)))
    return spans


def _joined(one: _Span, other: _Span) -> _Span:
    least, greatest = min(one.least, other.least), max(one.greatest, other.greatest)
    return _Span(one.samples + other.samples, one.known or other.known, least, greatest)


def _merged(parts: Iterator[list[_Span]]) -> list[_Span]:
    return [reduce(_joined, spans) for spans in zip(*parts, strict=True)]


def _slack(limit: Limit, span: _Span) -> Float:
    """Return by how much each side may be exceeded without counting, by rounding and the tolerance of a fit."""
    scale = 1e-6 * np.array([abs(limit.lower), abs(limit.upper)])
    # a limit of 0 has no size of its own: that of the output counts
    typical = 1e-6 * max(abs(span.least), abs(span.greatest)) if span.known else 0.0
    return np.where(np.isfinite(scale) & (scale > 0), scale, typical)


def _count_beyond(problem: Problem, parameters: ParameterSet, slack: list[Float]) -> list[int]:
    """Count for each limit the values that exceed it, including those that are not finite."""
    counts = [0] * len(problem.limits)
    for i, values in _limited_outputs(problem, parameters):
        limit = problem.limits[i]
        # so that NaN is not within
        within = (values >= limit.lower - slack[i][0]) & (values <= limit.upper + slack[i][1])
        counts[i] += int(np.count_nonzero(~within))
    return counts
