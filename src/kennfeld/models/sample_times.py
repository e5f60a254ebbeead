"""Sample times: periods with offsets, the step that hits all of them, and the condition that a step is one of them."""

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Final, NamedTuple

from kennfeld.graph import Graph
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import STEP, TIME

_TIME_TOLERANCE: Final = 1e-6  # relative to the period, for rounded times


class SampleTime(NamedTuple):
    """Sample time in s: the first hit at `offset`, then one every `period`."""

    period: float
    offset: float = 0.0


def common_step(periods: Iterable[float]) -> float | None:
    """Compute the longest step that hits all sample times, in s; None if there are none.

    >>> common_step([0.02, 0.005, 0.01])
    0.005
    """
    # decimal periods are not exact in binary: 0.1 is meant, not the fraction that it is stored as
    parts = [Fraction(period).limit_denominator(10**9) for period in periods if 0 < period < math.inf]
    parts = [part for part in parts if part > 0]
    if not parts:
        return None
    # gcd of fractions: that of the numerators over a common denominator
    bottom = math.lcm(*(part.denominator for part in parts))
    return float(Fraction(math.gcd(*(int(part * bottom) for part in parts)), bottom))


def sample_hit(builder: GraphBuilder, rate: SampleTime, step: float | None) -> int | None:
    """Write the node that is 1 at a sample hit; None if every step is one. `step` is in s, None if it is not fixed."""
    if step is not None and rate.offset == 0 and rate.period <= step * (1 + _TIME_TOLERANCE):
        return None
    # hits up to a time: n(t) = floor((t - offset)/period + tolerance); a step is a hit if n has grown since the step
    # before
    near = builder.const(_TIME_TOLERANCE - rate.offset / rate.period)
    now, before = builder.time(), builder.call("sub", builder.time(), builder.step())
    period = builder.const(rate.period)
    count = [
        builder.call("floor", builder.call("add", builder.call("div", time, period), near)) for time in (now, before)
    ]
    hit = builder.call("gt", *count)
    if rate.offset == 0:
        return hit
    # before the offset, n is negative and grows as well
    return builder.call("and", builder.call("ge", count[0], builder.const(0.0)), hit)


def find_sample_hits(graph: Graph) -> dict[int, float]:
    """Return the nodes that are 1 at the hits of a sample time without offset, with their periods in s.

    Of a node and a mark that keeps it constant within a step, the mark is returned.
    """
    hits = {at: period for at in range(len(graph.nodes)) if (period := _hit_period(graph, at)) is not None}
    held = {at: node.args[0] for at, node in enumerate(graph.nodes) if node.op == "hold" and node.args[0] in hits}
    plain = {at: period for at, period in hits.items() if at not in held.values()}
    return {**plain, **{at: hits[inner] for at, inner in held.items()}}


def _hit_period(graph: Graph, at: int) -> float | None:
    """Return the period of a node that `sample_hit` wrote, None of others."""
    nodes = graph.nodes
    if nodes[at].op != "gt":
        return None
    counted = [_counted_time(graph, count) for count in nodes[at].args]
    if counted[0] is None or counted[1] is None or counted[0][1] != counted[1][1]:
        return None
    (now, period), (before, _) = counted[0], counted[1]
    is_step = nodes[now] == ("input", (), TIME) and nodes[before].op == "sub" and nodes[before].args[0] == now
    return period if is_step and nodes[nodes[before].args[1]] == ("input", (), STEP) else None


def _counted_time(graph: Graph, at: int) -> tuple[int, float] | None:
    """Return time and period of the number of hits `floor(time / period + tolerance)`."""
    nodes = graph.nodes
    if nodes[at].op != "floor" or nodes[sum_ := nodes[at].args[0]].op != "add":
        return None
    quotient, near = nodes[sum_].args
    if nodes[near] != ("const", (), _TIME_TOLERANCE) or nodes[quotient].op != "div":
        return None
    time, period = nodes[quotient].args
    return (time, float(nodes[period].payload)) if nodes[period].op == "const" else None
