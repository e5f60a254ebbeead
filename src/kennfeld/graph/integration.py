"""Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

In a graph before the solver is applied, the next value of a continuous state is a node `advance`: its value at the
start of the step, its derivative and its limits. Each stage of the solver evaluates the derivatives again at
intermediate states and times. Inputs, other states and what a node `hold` marks are constant within the step.

Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math. Lett. 2 (1989) 321; the classic fourth-order method;
Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its fifth-order solution without error control; Prince and
Dormand, J. Comput. Appl. Math. 7 (1981) 67, the eighth-order solution of RK8(7)13M.
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


_DORMAND_PRINCE_8: Final = ButcherTableau(
    (0.0, 1 / 18, 1 / 12, 1 / 8, 5 / 16, 3 / 8, 59 / 400, 93 / 200, 5490023248 / 9719169821, 13 / 20,
     1201146811 / 1299019798, 1.0, 1.0),
    (
        (),
        (1 / 18,),
        (1 / 48, 1 / 16),
        (1 / 32, 0.0, 3 / 32),
        (5 / 16, 0.0, -75 / 64, 75 / 64),
        (3 / 80, 0.0, 0.0, 3 / 16, 3 / 20),
        (29443841 / 614563906, 0.0, 0.0, 77736538 / 692538347, -28693883 / 1125000000, 23124283 / 1800000000),
        (16016141 / 946692911, 0.0, 0.0, 61564180 / 158732637, 22789713 / 633445777, 545815736 / 2771057229,
         -180193667 / 1043307555),
        (39632708 / 573591083, 0.0, 0.0, -433636366 / 683701615, -421739975 / 2616292301, 100302831 / 723423059,
         790204164 / 839813087, 800635310 / 3783071287),
        (246121993 / 1340847787, 0.0, 0.0, -37695042795 / 15268766246, -309121744 / 1061227803, -12992083 / 490766935,
         6005943493 / 2108947869, 393006217 / 1396673457, 123872331 / 1001029789),
        (-1028468189 / 846180014, 0.0, 0.0, 8478235783 / 508512852, 1311729495 / 1432422823,
         -10304129995 / 1701304382, -48777925059 / 3047939560, 15336726248 / 1032824649, -45442868181 / 3398467696,
         3065993473 / 597172653),
        (185892177 / 718116043, 0.0, 0.0, -3185094517 / 667107341, -477755414 / 1098053517, -703635378 / 230739211,
         5731566787 / 1027545527, 5232866602 / 850066563, -4093664535 / 808688257, 3962137247 / 1805957418,
         65686358 / 487910083),
        (403863854 / 491063109, 0.0, 0.0, -5068492393 / 434740067, -411421997 / 543043805, 652783627 / 914296604,
         11173962825 / 925320556, -13158990841 / 6184727034, 3936647629 / 1978049680, -160528059 / 685178525,
         248638103 / 1413531060, 0.0),
    ),
    (14005451 / 335480064, 0.0, 0.0, 0.0, 0.0, -59238493 / 1068277825, 181606767 / 758867731, 561292985 / 797845732,
     -1041891430 / 1371343529, 760417239 / 1151165299, 118820643 / 751138087, -528747749 / 2220607170, 1 / 4),
)  # fmt: skip

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
    "ode8": _DORMAND_PRINCE_8,
}


DEFAULT_SOLVER: Final = "ode4"  # of functions with continuous states that name none


class Advance(NamedTuple):
    """The arguments of a node `advance`: start of the step, derivative, lower and upper limit, all nodes."""

    start: int
    slope: int
    lower: int
    upper: int


def is_continuous(graph: Graph) -> bool:
    """Return True if a graph has continuous states, to which a solver must be applied."""
    return any(graph.nodes[state.next].op == "advance" for state in graph.states)


def has_marks(graph: Graph) -> bool:
    """Return True if a graph has nodes that only `apply_solver` resolves."""
    return any(node.op in ("advance", "hold") for node in graph.nodes)


def has_holds(graph: Graph) -> bool:
    """Return True if a graph has marks `hold`."""
    return any(node.op == "hold" for node in graph.nodes)


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
    if not has_marks(graph):
        return graph
    builder = make.of(graph)
    _close_states(builder, SOLVERS[solver])
    return _without(builder, graph, lambda at: True, make())


def without_idle_holds(graph: Graph) -> Graph:
    """Return a graph before the solver without marks `hold` of values that do not change within a step."""
    if not has_holds(graph):
        return graph
    effective = _effective_holds(graph)
    return _without(GraphBuilder.of(graph), graph, lambda at: at not in effective, GraphBuilder())


def _close_states(builder: GraphBuilder, tableau: ButcherTableau) -> None:
    """Close continuous states with their values at the next sample."""
    states = {
        which: Advance(*builder.nodes[state.next].args)
        for which, state in enumerate(builder.states)
        if builder.nodes[state.next].op == "advance"
    }
    if not states:
        return
    parts, dt = list(states.values()), builder.next_step()
    stages: list[list[int]] = []
    # stage i: k_i = f(t + c_i dt, x + dt sum over j < i of a_ij k_j), for all continuous states together
    for node, row in zip(tableau.nodes, tableau.rows, strict=True):
        starts = [part.start for part in parts]
        slopes = [part.slope for part in parts]
        if row:
            begun = zip(parts, *stages, strict=True)
            # no stage sees a state beyond its limits
            starts = [
                builder.within(_advanced(builder, part.start, row, before, dt), part.lower, part.upper)
                for part, *before in begun
            ]
            replaced = {part.start: x for part, x in zip(parts, starts, strict=True)}
            t = builder.time()
            replaced[t] = builder.call("add", t, builder.call("mul", builder.const(node), dt))
            slopes = _replace_nodes(builder, slopes, replaced)
        stages.append([_limited_slope(builder, *each) for each in zip(parts, slopes, starts, strict=True)])
    for which, part, *slopes in zip(states, parts, *stages, strict=True):
        # limited once more, as a step may pass a limit that no stage has met
        new = _advanced(builder, part.start, tableau.weights, slopes, dt)
        builder.states[which] = builder.states[which]._replace(next=builder.within(new, part.lower, part.upper))


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


def _replace_nodes(builder: GraphBuilder, roots: Sequence[int], place: Mapping[int, int]) -> list[int]:
    """Return the nodes of roots with some nodes replaced."""
    replaced = dict(place)
    # numbers of nodes rise from arguments to results
    for at in sorted(_reached(builder.nodes, roots, replaced)):
        node = builder.nodes[at]
        # a mark keeps the value of the start of the step, whatever its argument becomes in a stage
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
        # within a step, continuous states and the time move, and what depends on them up to the next mark
        if at in starts or node == ("input", (), "t"):
            moving.add(at)
        elif not moving.isdisjoint(node.args):
            (effective if node.op == "hold" and at in reached else moving).add(at)
    return effective


def _without(source: GraphBuilder, graph: Graph, redundant: Callable[[int], bool], target: GraphBuilder) -> Graph:
    """Return the graph in a builder, with the names of another one, without redundant marks `hold`."""
    number: list[int] = []
    for at, node in enumerate(source.nodes):
        args = tuple(number[a] for a in node.args)
        number.append(args[0] if node.op == "hold" and redundant(at) else target.rebuild(node, args))
    target.states = [state._replace(init=number[state.init], next=number[state.next]) for state in source.states]
    return target.finish({name: number[at] for name, at in graph.names.items()}, graph.units, graph.outputs)
