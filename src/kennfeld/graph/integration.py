"""Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

In a graph before the solver is applied, the next value of a continuous state is a node `advance`: its value at the
start of the step, its derivative and its limits. Each stage of the solver evaluates the derivatives again at
intermediate states and times. Inputs, other states and what a node `hold` marks are constant within the step.

Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math. Lett. 2 (1989) 321; the classic fourth-order method;
Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its fifth-order solution without error control.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Graph, Node


class ButcherTableau(NamedTuple):
    """Explicit Runge-Kutta method: nodes, rows of the matrix below the diagonal, and weights."""

    nodes: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]


SOLVERS: Final = {
    "ode1": ButcherTableau((0.0,), ((),), (1.0,)),
    "ode2": ButcherTableau((0.0, 1.0), ((), (1.0,)), (0.5, 0.5)),
    "ode3": ButcherTableau((0.0, 1 / 2, 3 / 4), ((), (1 / 2,), (0.0, 3 / 4)), (2 / 9, 1 / 3, 4 / 9)),
    "ode4": ButcherTableau(
        (0.0, 0.5, 0.5, 1.0), ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    ),
    "ode5": ButcherTableau(
        (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
        (
            (),
            (1 / 5,),
            (3 / 40, 9 / 40),
            (44 / 45, -56 / 15, 32 / 9),
            (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
            (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        ),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    ),
}


class Advance(NamedTuple):
    """The arguments of a node `advance`: start of the step, derivative, lower and upper limit, all nodes."""

    start: int
    slope: int
    lower: int
    upper: int


def is_continuous(graph: Graph) -> bool:
    """Return True if a graph has continuous states, to which a solver must be applied."""
    return any(graph.nodes[state.next].op == "advance" for state in graph.states)


def apply_solver(graph: Graph, solver: str, make: type[GraphBuilder] = GraphBuilder) -> Graph:
    """Return the graph whose continuous states are advanced by a solver.

    Args:
        graph: graph with nodes `advance` and `hold`.
        solver: name in `SOLVERS`.
        make: builder to use, such as one with a limit on operations.

    >>> b = GraphBuilder()
    >>> x = b.state()
    >>> b.close(x, b.const(1.0), b.node("advance", (x, b.call("neg", x), b.const(-math.inf), b.const(math.inf))))
    >>> heun = apply_solver(b.finish({"x": x}), "ode2")
    >>> sorted({node.op for node in heun.nodes})
    ['add', 'const', 'input', 'mul', 'neg', 'state']
    """
    builder = make.of(graph)
    _close_states(builder, SOLVERS[solver])
    return _without(builder, graph, lambda at: True, make())


def without_idle_holds(graph: Graph) -> Graph:
    """Return a graph before the solver without marks `hold` of values that do not change within a step."""
    effective = _effective_holds(graph)
    return _without(GraphBuilder.of(graph), graph, lambda at: at not in effective, GraphBuilder())


def _close_states(builder: GraphBuilder, tableau: ButcherTableau) -> None:
    """Close continuous states with their values after one step of length dt."""
    states = {
        which: Advance(*builder.nodes[state.next].args)
        for which, state in enumerate(builder.states)
        if builder.nodes[state.next].op == "advance"
    }
    if not states:
        return
    parts, dt = list(states.values()), builder.input("dt")
    stages: list[list[int]] = []
    for node, row in zip(tableau.nodes, tableau.rows, strict=True):
        starts = [part.start for part in parts]
        slopes = [part.slope for part in parts]
        if row:
            begun = zip(parts, *stages, strict=True)
            starts = [_advanced(builder, part.start, row, before, dt) for part, *before in begun]
            replaced = {part.start: x for part, x in zip(parts, starts, strict=True)}
            t = builder.input("t")
            replaced[t] = builder.call("add", t, builder.call("mul", builder.const(node), dt))
            slopes = _replace_nodes(builder, slopes, replaced)
        stages.append([_limited_slope(builder, *each) for each in zip(parts, slopes, starts, strict=True)])
    for which, part, *slopes in zip(states, parts, *stages, strict=True):
        new = _advanced(builder, part.start, tableau.weights, slopes, dt)
        builder.states[which] = builder.states[which]._replace(next=_within(builder, part, new))


def _advanced(builder: GraphBuilder, x: int, row: Sequence[float], slopes: Sequence[int], dt: int) -> int:
    """Return x + dt (a1 k1 + a2 k2 + ...)."""
    total = builder.const(0.0)
    for share, slope in zip(row, slopes, strict=True):
        if share:
            total = builder.call("add", total, builder.call("mul", builder.const(share), slope))
    return builder.call("add", x, builder.call("mul", dt, total))


def _limited_slope(builder: GraphBuilder, part: Advance, slope: int, x: int) -> int:
    """Return the derivative of a state, 0 at a limit while it points outwards."""
    zero = builder.const(0.0)
    for limit, none, beyond, outwards in (
        (part.lower, -math.inf, "le", "lt"),
        (part.upper, math.inf, "ge", "gt"),
    ):
        if builder.value(limit) != none:
            rests = builder.call("and", builder.call(beyond, x, limit), builder.call(outwards, slope, zero))
            slope = builder.call("select", rests, zero, slope)
    return slope


def _within(builder: GraphBuilder, part: Advance, new: int) -> int:
    if builder.value(part.lower) != -math.inf:
        new = builder.call("max", new, part.lower)
    return new if builder.value(part.upper) == math.inf else builder.call("min", new, part.upper)


def _replace_nodes(builder: GraphBuilder, roots: Sequence[int], place: Mapping[int, int]) -> list[int]:
    """Return the nodes of roots with some nodes replaced."""
    replaced = dict(place)
    for at in sorted(_reached(builder.nodes, roots, replaced)):
        node = builder.nodes[at]
        if node.op == "hold" or all(replaced.get(a, a) == a for a in node.args):
            replaced[at] = at
        else:
            replaced[at] = builder.rebuild(node, tuple(replaced.get(a, a) for a in node.args))
    return [replaced.get(root, root) for root in roots]


def _reached(nodes: Sequence[Node], roots: Iterable[int], stop: Collection[int]) -> set[int]:
    """Return the nodes that roots depend on within a stage, down to those of `stop` and those that are held."""
    seen: set[int] = set()
    stack = [root for root in roots if root not in stop]
    while stack:
        at = stack.pop()
        if at in seen:
            continue
        seen.add(at)
        if nodes[at].op != "hold":
            stack += [a for a in nodes[at].args if a not in stop and a not in seen]
    return seen


def _effective_holds(graph: Graph) -> set[int]:
    """Return the marks `hold` that a derivative depends on and whose values would change within a step."""
    parts = [Advance(*node.args) for node in graph.nodes if node.op == "advance"]
    starts = {part.start for part in parts}
    reached = _reached(graph.nodes, (part.slope for part in parts), starts)
    moving: set[int] = set()
    effective: set[int] = set()
    for at, node in enumerate(graph.nodes):
        if at in starts or node == ("input", (), "t"):
            moving.add(at)
        elif not moving.isdisjoint(node.args):
            (effective if node.op == "hold" and at in reached else moving).add(at)
    return effective


def _without(source: GraphBuilder, graph: Graph, idle: Callable[[int], bool], target: GraphBuilder) -> Graph:
    """Return the graph in a builder, with the names of another one, without those marks `hold` that are idle."""
    number: list[int] = []
    for at, node in enumerate(source.nodes):
        args = tuple(number[a] for a in node.args)
        number.append(args[0] if node.op == "hold" and idle(at) else target.rebuild(node, args))
    target.states = [state._replace(init=number[state.init], next=number[state.next]) for state in source.states]
    return target.finish({name: number[at] for name, at in graph.names.items()}, graph.units, graph.outputs)
