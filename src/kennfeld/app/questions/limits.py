"""The limits of the project with two sets of values: which hold, and how far the worst value is beyond one."""

from collections.abc import Iterator, Sequence

import numpy as np

from kennfeld.analysis.limit_margins import active_constraints, output_ranges
from kennfeld.app.answer import finite
from kennfeld.app.questions.comparison import ComparedValues
from kennfeld.app.questions.parameters import describe_axes
from kennfeld.app.session.session import Session
from kennfeld.app.session.taking import values_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.constraints import Equality, Shape
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.traversal import coordinates_of
from kennfeld.optimize.problem.problem import Problem

PIN_DIGITS = 1e-9  # of its value, by which a pin may be missed


@dataclass(frozen=True)
class LimitState:
    """A limit with one set of values.

    Attributes:
        excess: how far the worst value is beyond it; 0 if it holds, null if that is not known.
        active: number of values at the limit.
        worst: where the worst value is, in words.
    """

    excess: float | None
    active: int
    worst: str


@dataclass(frozen=True)
class LimitRow:
    """A limit: what it is about, its range in words, and its unit."""

    name: str
    text: str
    unit: str
    first: LimitState
    second: LimitState


@dataclass(frozen=True)
class LimitRows:
    """The limits of the project with two sets of values."""

    rows: Sequence[LimitRow]


_Limit = tuple[tuple[str, str, str], LimitState]  # name, text and unit


def limits(session: Session, asked: ComparedValues) -> LimitRows:
    """Return bounds, pins, limits of slope and curvature, equalities and output limits with two sets of values."""
    problem = session.require_view().model.problem
    first, second = (list(_limits(problem, values_of(session, each))) for each in (asked.first, asked.second))
    return LimitRows([LimitRow(*head, one, other) for (head, one), (_, other) in zip(first, second, strict=True)])


def _limits(problem: Problem, values: ParameterSet) -> Iterator[_Limit]:
    yield from _bounds(problem, values)
    yield from _pins(problem, values)
    for each in active_constraints(problem, values):
        constraint = each.constraint
        head = _shape_text(problem, constraint) if isinstance(constraint, Shape) else _equality_text(constraint)
        yield head, LimitState(finite(each.excess), len(each.active), each.worst)
    for output in output_ranges(problem, values):
        limit, unit = output.limit, problem.model.graph.units.get(output.limit.node, "")
        excess = max(limit.lower - output.least, output.greatest - limit.upper, 0.0) if output.beyond else 0.0
        worst = f"{output.beyond} of {output.samples} samples" if output.beyond else ""
        yield (limit.node, _range(limit.lower, limit.upper), unit), LimitState(finite(excess), 0, worst)


def _bounds(problem: Problem, values: ParameterSet) -> Iterator[_Limit]:
    for name in problem.free_names:
        table, own = values[name], problem.parameters[name]
        if not own.limited or own.lower.shape != table.values.shape:
            continue
        beyond = np.maximum(own.lower - table.values, table.values - own.upper)
        at = np.unravel_index(int(beyond.argmax()), beyond.shape) if beyond.shape else ()
        excess = max(float(beyond[at]), 0.0)
        place = ", ".join(f"{axis.breakpoints[k]:g}" for axis, k in zip(table.index_axes, at, strict=True))
        even = (own.lower == own.lower.flat[0]).all() and (own.upper == own.upper.flat[0]).all()
        text = _range(float(own.lower.flat[0]), float(own.upper.flat[0])) if even else "bounds by grid point"
        count = int(np.count_nonzero((table.values == own.lower) | (table.values == own.upper)))
        yield (name, text, table.unit), LimitState(excess, count, f"at {place}" if excess > 0 and place else "")


def _pins(problem: Problem, values: ParameterSet) -> Iterator[_Limit]:
    for pin in problem.pins:
        table = values[pin.parameter]
        value = float(table(*pin.at)) if pin.at else table.value
        missed = abs(value - pin.value)
        missed = 0.0 if missed <= PIN_DIGITS * max(abs(pin.value), 1.0) else missed
        at = ", ".join(f"{place:g}" for place in pin.at)
        text = f"{f'at {at} ' if at else ''}pinned to {pin.value:g}"
        yield (pin.parameter, text, table.unit), LimitState(finite(missed), 0, "")


def _shape_text(problem: Problem, shape: Shape) -> tuple[str, str, str]:
    table = problem.parameters[shape.parameter]
    axes = describe_axes(table, coordinates_of(problem.graph, shape.parameter))
    axis = axes[shape.axis].input or AXIS_LETTERS[shape.axis]
    return shape.parameter, f"{shape.kind} along {axis} {_range(shape.lower, shape.upper)}", ""


def _equality_text(equality: Equality) -> tuple[str, str, str]:
    return "equality", str(equality), ""


def _range(lower: float, upper: float) -> str:
    """Write a range.

    >>> _range(0.0, np.inf), _range(-np.inf, 2.5), _range(0.0, 1.0)
    ('≥ 0', '≤ 2.5', '0 … 1')
    """
    if np.isinf(lower):
        return "" if np.isinf(upper) else f"≤ {upper:g}"
    return f"≥ {lower:g}" if np.isinf(upper) else f"{lower:g} … {upper:g}"
