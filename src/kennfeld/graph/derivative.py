"""Exact derivatives of one time step, as additional nodes of the same graph.

Free values enter through atoms: the `interpolate` nodes of free parameters and the `position` nodes of free axes. With
the breakpoints as a curve B over 0, 1, ..., the position p of a coordinate x satisfies B(p) = x. Differentiating gives
dp/db_i = -w_i(p) dp/dx, where w_i(p) is the weight of breakpoint b_i in B(p).

One reverse sweep per row (an output or a next state) gives its derivatives with respect to all atoms and all states
that carry the influence of a free value. If few rows share a node, each sweep is written out as nodes: conditions
switch adjoints instead of multiplying them, so a non-finite value in a branch not taken never reaches the result, and
`guard` keeps 0 times infinity at 0, as for `1/(1 + exp(z))` at a large z. If many rows share a node, they share one
adjoint program (`adjoints.py`).
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from math import isfinite
from typing import TypeAlias

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.adjoints import AdjointProgram, breakpoint_slope, layer_partials, partials, pull_back
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.lookup_lowering import Free, is_atom
from kennfeld.graph.node import Graph, Node, State
from kennfeld.graph.traversal import ancestors, dependents

MAX_VISITS = 5000  # of nodes by rows, up to which each row is written out
UNBOUNDED = ("exp", "log", "log10", "tan", "sinh", "cosh")  # operations with infinite results of finite arguments
# infinity as well
PASSING = ("add", "sub", "mul", "guard", "min", "max", "select", "neg", "abs", "sqrt", "mod", "single")
SHARED = 1.4  # rows that see a node, on the average, from which they share one pull-back


@dataclass(frozen=True)
class Written:
    """Derivatives written out as nodes: `rows[row]` maps an atom or a state node to the node of the derivative."""

    rows: tuple[Mapping[int, int], ...]

    @property
    def reach(self) -> tuple[Collection[int], ...]:
        """The atoms and states on which each row depends."""
        return self.rows

    def only(self, rows: Sequence[int]) -> "Written":
        """Return the derivatives of some rows."""
        return Written(tuple(self.rows[row] for row in rows))


Slopes: TypeAlias = Written | AdjointProgram


@dataclass(frozen=True)
class Linearization:
    """A time step and its derivatives.

    `nodes` extend those of the graph. Rows are the `outputs`, then the next values of the `carried` states, i.e. of the
    states that depend on a free value. `slopes` are the derivatives of the rows with respect to atoms and carried
    states; for a position p, with respect to B(p). `starts[state]` is the node of a state's first value, free of
    states; `start_slopes` are the derivatives of the carried first values with respect to atoms.
    """

    nodes: tuple[Node, ...]
    states: tuple[State, ...]
    outputs: tuple[int, ...]
    carried: tuple[int, ...]
    seeds: tuple[int, ...]  # the node that reads each carried state
    slopes: Slopes
    starts: tuple[int, ...]
    start_slopes: Slopes

    @property
    def atoms(self) -> tuple[int, ...]:
        """The lookups through which free values enter a step, in the order of their numbers."""
        return tuple(sorted({leaf for row in self.slopes.reach for leaf in row} - set(self.seeds)))

    @property
    def start_atoms(self) -> tuple[int, ...]:
        """The lookups through which free values enter the first values of states, in the order of their numbers."""
        return tuple(sorted({leaf for row in self.start_slopes.reach for leaf in row}))


def differentiate(graph: Graph, outputs: Sequence[int], free: Free) -> Linearization:
    """Differentiate a step with respect to the free values and the carried states.

    Args:
        graph: graph with lowered lookups.
        outputs: nodes of the graph.
        free: free parameters and axes.

    Raises:
        ArgumentError: the first value of a state depends on itself.
    """
    atom = partial(is_atom, free=free)
    live = dependents(graph, atom)
    b = GraphBuilder.of(graph)
    # other states follow from the data alone and have no sensitivities
    carried = tuple(i for i, s in enumerate(graph.states) if s.init in live or s.next in live)
    seeds = tuple(b.node("state", (), i) for i in carried)
    rows = (*outputs, *(graph.states[i].next for i in carried))
    slopes = _slopes(b, rows, live | set(seeds), atom)
    starts = _starts(b, graph.states)
    # in the extended graph, and without states, which first values do not read
    moving = {at for at, node in enumerate(b.nodes) if atom(node)}
    for at, node in enumerate(b.nodes):
        if not moving.isdisjoint(node.args):
            moving.add(at)
    start_slopes = _slopes(b, [starts[i] for i in carried], moving, atom)
    nodes = tuple(b.nodes)
    return Linearization(nodes, graph.states, tuple(outputs), carried, seeds, slopes, tuple(starts), start_slopes)


def _slopes(b: GraphBuilder, rows: Sequence[int], active: Collection[int], is_atom: Callable[[Node], bool]) -> Slopes:
    nodes, visits = _extent(b, [row for row in rows if row in active], active)
    # written out, code grows with rows times nodes; a shared pull-back pays only if the rows see the same nodes
    if visits > MAX_VISITS and visits > SHARED * nodes:
        return pull_back(b, rows, active, is_atom)
    overflow = _Overflow(b)
    return Written(tuple(_reverse(b, row, active, is_atom, overflow) for row in rows))


def _extent(b: GraphBuilder, rows: Sequence[int], active: Collection[int]) -> tuple[int, int]:
    """Return the number of nodes that all rows reach together, and the sum over the rows."""
    seen: dict[int, int] = defaultdict(int)  # the rows that see a node, a bit each
    for number, row in enumerate(rows):
        seen[row] |= 1 << number
    for at in reversed(ancestors(b.nodes, rows, active)):
        for a in b.nodes[at].args:
            if a in active:
                seen[a] |= seen[at]
    return len(seen), sum(rows.bit_count() for rows in seen.values())


class _Overflow:
    """Finds the nodes of a graph in progress that may be infinite although inputs, values and states are finite."""

    def __init__(self, b: GraphBuilder) -> None:
        self._nodes = b.nodes
        self._infinite: list[bool] = []  # of the nodes so far

    def __call__(self, at: int) -> bool:
        for node in self._nodes[len(self._infinite) : at + 1]:
            self._infinite.append(self._may_be_infinite(node))
        return self._infinite[at]

    def _may_be_infinite(self, node: Node) -> bool:
        op, args, payload = node
        if op == "const":
            return not isfinite(payload)
        if op in UNBOUNDED or op in ("div", "pow"):
            constant = self._nodes[args[-1]].payload if self._nodes[args[-1]].op == "const" else None
            # a divisor that is a constant, or a constant exponent > 0, is finite for finite arguments
            tame = (op == "div" and constant not in (None, 0.0)) or (op == "pow" and (constant or -1.0) > 0)
            return self._infinite[args[0]] if tame else True
        return op in PASSING and any(self._infinite[a] for a in args)


def _product(b: GraphBuilder, adjoint: int, factor: int, switched: bool, overflow: _Overflow) -> int:
    """Return the product of two slopes, 0 if one of them is 0 and the other may be infinite."""
    # a constant is finite and not 0, so that nothing needs a guard
    if any(b.nodes[at].op == "const" and b.nodes[at].payload != 0 for at in (adjoint, factor)):
        return b.call("mul", adjoint, factor)
    # the one that may be 0 beside an infinite other one decides, see `guard`
    by_adjoint, by_factor = switched or overflow(factor), overflow(adjoint)
    # 0 if either is 0: the selection looks at the factor, the guard at the adjoint
    if by_adjoint and by_factor:
        return b.call("select", factor, b.call("guard", adjoint, factor), b.const(0.0))
    if by_factor:
        return b.call("guard", factor, adjoint)
    return b.call("guard" if by_adjoint else "mul", adjoint, factor)


def _reverse(
    b: GraphBuilder,
    root: int,
    active: Collection[int],
    is_atom: Callable[[Node], bool],
    overflow: _Overflow,
) -> dict[int, int]:
    """Differentiate `root` with respect to the atoms and states it reaches within one step."""
    if root not in active:
        return {}
    totals = {root: b.const(1.0)}  # sums of adjoints by node
    switched: set[int] = set()  # nodes whose adjoint a condition may switch off
    result: dict[int, int] = {}
    order = ancestors(b.nodes, [root], active)
    layers = _layers(b.nodes, order)
    for at in reversed(order):
        # the outputs of a layer are passed on together, at the first of them; the others are skipped below
        pulled = [output for output in layers.get(at, ()) if output in totals]
        if pulled:
            for argument, part in layer_partials(b, {output: totals[output] for output in pulled}, active):
                totals[argument] = b.call("add", totals[argument], part) if argument in totals else part
                if not switched.isdisjoint(pulled):
                    switched.add(argument)
        if at not in totals:  # reached through steps alone, as a comparison
            continue
        node, adjoint = b.nodes[at], totals[at]
        times = partial(_product, b, adjoint, switched=at in switched, overflow=overflow)
        if node.op == "state" or is_atom(node):  # of a position, the derivative with respect to B(p)
            free_axis = node.op == "position"
            result[at] = times(breakpoint_slope(b, at)) if free_axis else adjoint
        if node.op == "dense":
            continue
        for argument, factor, switches in partials(b, at, active):
            # a selection, not a product: an adjoint that is not finite must not leave the branch that is not taken
            part = b.call("select", factor, adjoint, b.const(0.0)) if switches else times(factor)
            totals[argument] = b.call("add", totals[argument], part) if argument in totals else part
            # what a condition has switched off may be 0 all the way down
            if switches or at in switched:
                switched.add(argument)
    return result


def _layers(nodes: Sequence[Node], order: Sequence[int]) -> Mapping[int, Sequence[int]]:
    """Return the outputs of each dense layer by the first of them.

    A reverse sweep that comes to the first output knows the adjoints of all: no argument of one depends on another.
    """
    outputs: dict[tuple[object, ...], list[int]] = {}
    for at in order:
        if nodes[at].op == "dense":
            outputs.setdefault((nodes[at].payload.layer, nodes[at].args), []).append(at)
    return {group[0]: group for group in outputs.values()}


def _starts(b: GraphBuilder, states: Sequence[State]) -> list[int]:
    """Return for each state the node of its first value, with reads of other states replaced by their first values."""
    number: dict[int, int] = {}  # of each node what it is in the first sample
    open_states: set[int] = set()

    def at_start(root: int) -> int:
        for at in ancestors(b.nodes, [root], without=number):
            if at not in number:
                number[at] = first_value(at)
        return number[root]

    def first_value(at: int) -> int:
        node = b.nodes[at]
        if node.op == "state":
            if node.payload in open_states:
                raise ArgumentError("the first value of a state depends on itself")
            # a state that is read while its own first value is computed is a loop
            open_states.add(node.payload)
            return at_start(states[node.payload].init)
        return b.rebuild(node, tuple(number[a] for a in node.args))

    return [at_start(b.node("state", (), which)) for which in range(len(states))]
