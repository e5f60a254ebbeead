"""Exact derivatives of one time step, as further nodes of the same graph.

The calibratable values enter through atoms, the `interpolate` nodes of free parameters and the `position` nodes of
free axes. A position p is where the breakpoints, as a curve B over 0, 1, ..., take the value x: B(p) = x. So its slope
with respect to a breakpoint is minus the breakpoint's weight in B(p), times the slope of p with respect to x. One
reverse sweep a row (output or next state) gives its slopes with respect to every atom and every state that carries a
parameter's influence. Conditions switch adjoints instead of multiplying them, so a value that is not finite in a
branch not taken never reaches the result; where such an adjoint meets a slope, `guard` keeps 0 times infinity at 0.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from kennfeld.errors import ArgumentError
from kennfeld.graph.lowering import Free, dependent, enters
from kennfeld.graph.node import Builder, Graph, Node, State
from kennfeld.graph.operations import OPERATIONS

__all__ = ["Linearization", "differentiate"]


@dataclass(frozen=True)
class Linearization:
    """A step and its derivatives.

    `nodes` extend those of the graph. Rows are the `outputs`, then the next values of the `carried` states, which are
    the states that depend on a free value. `slopes[row]` maps an atom or a state node to the node of the derivative,
    for a position that with respect to B(p). `starts[state]` is the node of a state's first value, free of states;
    `start_slopes` are the derivatives of the carried ones with respect to atoms.
    """

    nodes: tuple[Node, ...]
    states: tuple[State, ...]
    outputs: tuple[int, ...]
    carried: tuple[int, ...]
    seeds: tuple[int, ...]  # the node that reads each carried state
    slopes: tuple[Mapping[int, int], ...]
    starts: tuple[int, ...]
    start_slopes: tuple[Mapping[int, int], ...]

    @property
    def atoms(self) -> tuple[int, ...]:
        """The lookups through which free values enter a step, in the order of their numbers."""
        found = {seed for row in self.slopes for seed in row} - set(self.seeds)
        return tuple(sorted(found))

    @property
    def start_atoms(self) -> tuple[int, ...]:
        """The lookups through which free values enter the first values of states."""
        return tuple(sorted({seed for row in self.start_slopes for seed in row}))


def differentiate(graph: Graph, outputs: Sequence[int], free: Free) -> Linearization:
    """The derivatives of `outputs` (nodes of a lowered graph) and of the states with respect to what is `free`.

    Raises `ArgumentError` where the first value of a state depends on itself.
    """

    def is_atom(node: Node) -> bool:
        return enters(node, free)

    live = dependent(graph, is_atom)
    b = Builder.of(graph)
    carried = tuple(i for i, s in enumerate(graph.states) if s.init in live or s.next in live)
    seeds = tuple(b.node("state", (), i) for i in carried)
    rows = (*outputs, *(graph.states[i].next for i in carried))
    active = live | set(seeds)
    slopes = tuple(_reverse(b, row, active, is_atom) for row in rows)
    starts = _starts(b, graph.states)
    moving = {at for at, node in enumerate(b.nodes) if is_atom(node)}
    for at, node in enumerate(b.nodes):
        if not moving.isdisjoint(node.args):
            moving.add(at)
    start_slopes = tuple(_reverse(b, starts[i], moving, is_atom) for i in carried)
    return Linearization(
        tuple(b.nodes), graph.states, tuple(outputs), carried, seeds, slopes, tuple(starts), start_slopes
    )


class _Adjoints:
    """Sums of adjoints by node, remembering which of them a condition may switch off."""

    def __init__(self, b: Builder) -> None:
        self.b = b
        self.total: dict[int, int] = {}
        self.switched: set[int] = set()

    def add(self, to: int, adjoint: int, switched: bool) -> None:
        before = self.total.get(to)
        self.total[to] = adjoint if before is None else self.b.call("add", before, adjoint)
        if switched:
            self.switched.add(to)


def _reverse(b: Builder, root: int, active: Collection[int], is_atom: Callable[[Node], bool]) -> dict[int, int]:
    """Derivatives of `root` with respect to the atoms and states it reaches within one step."""
    if root not in active:
        return {}
    order = _reachable(b, root, active)
    sums = _Adjoints(b)
    sums.add(root, b.const(1.0), switched=False)
    found: dict[int, int] = {}
    for at in order:
        if at not in sums.total:  # reached through steps alone, as a comparison
            continue
        adjoint, switched = sums.total[at], at in sums.switched
        node = b.nodes[at]
        if node.op == "state" or is_atom(node):
            found[at] = _of_breakpoints(b, at, adjoint, switched) if node.op == "position" else adjoint
        _push(b, sums, at, adjoint, switched, active)
    return found


def _of_breakpoints(b: Builder, at: int, adjoint: int, switched: bool) -> int:
    """The derivative with respect to B(p), from that with respect to the position p."""
    return b.call("neg", b.call("guard" if switched else "mul", adjoint, _lookup_slope(b, at, 0)))


def _reachable(b: Builder, root: int, active: Collection[int]) -> list[int]:
    seen = {root}
    stack = [root]
    while stack:
        for a in b.nodes[stack.pop()].args:
            if a in active and a not in seen:
                seen.add(a)
                stack.append(a)
    return sorted(seen, reverse=True)


def _push(b: Builder, sums: _Adjoints, at: int, adjoint: int, switched: bool, active: Collection[int]) -> None:
    """Hand the adjoint of a node on to its arguments."""
    op, args, _ = b.nodes[at]
    if op in ("interpolate", "position"):
        for i, a in enumerate(args):
            if a in active:
                sums.add(a, b.call("guard" if switched else "mul", adjoint, _lookup_slope(b, at, i)), switched)
        return
    if not args:
        return
    rule = OPERATIONS[op]
    conditions = rule.branches(b, args) if rule.branches else (None,) * len(args)
    for a, partial, condition in zip(args, rule.partials, conditions, strict=True):
        if a not in active or partial is None:
            continue
        if condition is not None:
            sums.add(a, b.call("select", condition, adjoint, b.const(0.0)), switched=True)
        else:
            sums.add(a, b.call("guard" if switched else "mul", adjoint, partial(b, args, at)), switched)


def _lookup_slope(b: Builder, at: int, axis: int) -> int:
    op, args, payload = b.nodes[at]
    return b.node("density", args, payload) if op == "position" else b.node("slope", args, (payload, axis))


def _starts(b: Builder, states: Sequence[State]) -> list[int]:
    """For each state the node of its first value, other states' first values put in the place of their reads."""
    done: dict[int, int] = {}
    open_states: set[int] = set()

    def first(which: int) -> int:
        if which not in done:
            if which in open_states:
                raise ArgumentError("the first value of a state depends on itself")
            open_states.add(which)
            done[which] = at_start(states[which].init)
        return done[which]

    def at_start(root: int) -> int:
        number: dict[int, int] = {}
        for at in sorted(_cone(b, root)):
            op, args, payload = b.nodes[at]
            if op == "state":
                number[at] = first(payload)
            elif op in OPERATIONS:
                number[at] = b.call(op, *(number[a] for a in args))
            else:
                number[at] = b.node(op, tuple(number[a] for a in args), payload)
        return number[root]

    return [first(which) for which in range(len(states))]


def _cone(b: Builder, root: int) -> set[int]:
    seen = {root}
    stack = [root]
    while stack:
        for a in b.nodes[stack.pop()].args:
            if a not in seen:
                seen.add(a)
                stack.append(a)
    return seen
