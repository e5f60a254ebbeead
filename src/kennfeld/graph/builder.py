"""Construction of the graph of one time step: hash-consed nodes, constant folding, and states for feedback."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Self

from kennfeld.graph.dense_layer import DenseLayer, DenseOutput
from kennfeld.graph.external_function import ExternalFunction, ExternalOutput
from kennfeld.graph.node import NEXT_STEP, STEP, TIME, Graph, Node, State, extract
from kennfeld.graph.operations import OPERATIONS

# operation -> (constant on the right that leaves the left operand, constant on the left that leaves the right one)
_NEUTRAL: dict[str, tuple[float | None, float | None]] = {
    "add": (0.0, 0.0),
    "sub": (0.0, None),
    "mul": (1.0, 1.0),
    "guard": (1.0, 1.0),
    "div": (1.0, None),
    "pow": (1.0, None),
}

# comparisons with 0 that leave a condition as it is, and the operations that give conditions
_TRUTHS = ("ne", "gt")
_NEUTRAL_TRUTH = {"and": 1.0, "or": 0.0}
CONDITIONS = frozenset({"eq", "ne", "lt", "le", "gt", "ge", "and", "or", "not"})  # operations that give 1 or 0


_MAX_NODES = 500_000  # different operations in a step of a bounded graph
_MAX_REQUESTS = 5_000_000  # requested operations, including duplicates and constants


class GraphBuilder:
    """Builder of the graph of one time step. Equal nodes become one; constants are folded.

    >>> b = GraphBuilder()
    >>> x = b.input("x")
    >>> b.call("mul", x, b.const(2.0)) == b.call("mul", x, b.const(2.0))
    True
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.states: list[State] = []
        self._index: dict[tuple[Any, ...], int] = {}
        self._open: list[tuple[int, Callable[[int], tuple[int, int]]]] = []
        self._limited: list[tuple[int, Callable[[], tuple[int, int]]]] = []

    @classmethod
    def of(cls, graph: Graph) -> Self:
        """Return a builder that continues a graph; its nodes keep their numbers."""
        result = cls()
        for op, args, payload in graph.nodes:
            result.node(op, args, payload)
        result.states.extend(graph.states)
        return result

    def node(self, op: str, args: tuple[int, ...] = (), payload: Any = None) -> int:
        """Return the number of this node; add the node if it does not exist yet."""
        # by their bits: 0.0 and -0.0 are equal, but different constants
        key = (op, args, payload.hex() if isinstance(payload, float) else payload)
        number = self._index.get(key)
        if number is None:
            number = self._index[key] = len(self.nodes)
            self.nodes.append(Node(op, args, payload))
        return number

    def rebuild(self, node: Node, args: tuple[int, ...]) -> int:
        """Return a node like another one, but with these arguments; operations are simplified as by `call`."""
        return self.call(node.op, *args) if node.op in OPERATIONS else self.node(node.op, args, node.payload)

    def const(self, value: float) -> int:
        """Return the node of a constant."""
        return self.node("const", (), math.nan if math.isnan(value) else float(value))  # one NaN, so that == holds

    def input(self, name: str) -> int:
        """Return the node of an input channel."""
        return self.node("input", (), name)

    def step(self) -> int:
        """Return the node of the step in s that ends at the sample, for values computed from those before it."""
        return self.input(STEP)

    def next_step(self) -> int:
        """Return the node of the step in s that begins at the sample, for values of the next one."""
        return self.input(NEXT_STEP)

    def time(self) -> int:
        """Return the node of the time in s since the piece began."""
        return self.input(TIME)

    def lookup(self, parameter: str, *coordinates: int) -> int:
        """Return the node of a scalar parameter, or of a table lookup at these coordinates."""
        return self.node("lookup", coordinates, parameter)

    def external(self, function: ExternalFunction, *args: int) -> tuple[int, ...]:
        """Return the nodes of the outputs of an external function."""
        return tuple(self.node("external", args, ExternalOutput(function, i)) for i in range(function.outputs))

    def dense(self, layer: DenseLayer, *args: int) -> tuple[int, ...]:
        """Return the nodes of the outputs of a dense layer."""
        return tuple(self.node("dense", args, DenseOutput(layer, i)) for i in range(layer.outputs))

    def call(self, op: str, *args: int) -> int:
        """Return the node of an elementwise operation; constants are folded, neutral elements dropped."""
        if op == "select" and self.nodes[args[0]].op == "const":
            return args[1] if self.nodes[args[0]].payload else args[2]
        if all(self.nodes[a].op == "const" for a in args):
            return self.const(OPERATIONS[op].evaluate(*(self.nodes[a].payload for a in args)))
        if (left := self._plain_condition(op, args)) is not None:
            return left
        return self._neutral(op, args) if op in _NEUTRAL else self.node(op, args)

    @property
    def resolution(self) -> float:
        """Distance from 1 to the next number of the precision to which `call` rounds."""
        return math.ulp(1.0)

    def rounded(self, node: int) -> int:
        """Return a node in the precision to which `call` rounds."""
        return node

    def in_double(self) -> AbstractContextManager[None]:
        """Return a context in which `call` rounds to double precision only."""
        return nullcontext()

    def _plain_condition(self, op: str, args: tuple[int, ...]) -> int | None:
        """Return the condition that a comparison with 0, or a constant in `and` or `or`, leaves as it is; or None."""
        if op in _TRUTHS:
            return args[0] if self._is(args[1], 0.0) and self.is_truth(args[0]) else None
        if op in _NEUTRAL_TRUTH:
            for constant, other in (args, args[::-1]):
                if self._is(constant, _NEUTRAL_TRUTH[op]) and self.is_truth(other):
                    return other
        return None

    def is_truth(self, node: int) -> bool:
        """Return True if a node can only be 0 or 1."""
        op, args, _ = self.nodes[node]
        return op in CONDITIONS or (op == "hold" and self.is_truth(args[0]))

    def _neutral(self, op: str, args: tuple[int, ...]) -> int:
        left, right, left_stays, right_stays = args[0], args[-1], *_NEUTRAL[op]
        if self._is(right, left_stays):
            return left
        if self._is(left, right_stays):
            return right
        return self.node(op, args)

    def _is(self, node: int, value: float | None) -> bool:
        return value is not None and self.nodes[node].op == "const" and bool(self.nodes[node].payload == value)

    def within(self, x: int, lower: int, upper: int) -> int:
        """Return x within limits; a limit that is infinite, or by which x is limited already, is not written again."""
        inner = x
        missing: list[tuple[str, int]] = []
        # written as min(max(x, lower), upper), so that the upper limit wins where both contradict each other
        for op, limit, none in (("min", upper, math.inf), ("max", lower, -math.inf)):
            if self._is(limit, none):
                continue
            node = self.nodes[inner]
            if not missing and node.op == op and node.args[1] == limit:
                inner = node.args[0]
            else:
                missing.append((op, limit))
        for op, limit in reversed(missing):
            x = self.call(op, x, limit)
        return x

    def state(self, latency: int = 1) -> int:
        """Return the node that reads a new state; `close` must then define its contents."""
        self.states.append(State(-1, -1, latency))
        return self.node("state", (), len(self.states) - 1)

    def close(self, state: int, init: int, next: int) -> None:  # noqa: A002
        """Set the first value and the next value of the state that node `state` reads."""
        which = self.nodes[state].payload
        self.states[which] = State(init, next, self.states[which].latency)

    def prev(self, x: int, init: int, latency: int = 1) -> int:
        """Return the value of `x` `latency` steps ago; until then, the value of `init` at the first sample."""
        key = ("prev", x, init, latency)
        if key not in self._index:
            result = self.state(latency)
            self.close(result, init, x)
            self._index[key] = result
        return self._index[key]

    def finish(
        self,
        names: Mapping[str, int],
        units: Mapping[str, str] | None = None,
        outputs: Sequence[str] = (),
    ) -> Graph:
        """Return the graph of the named nodes and their ancestors, with canonical node numbers."""
        return extract(self.nodes, self.states, names, units or {}, outputs)

    def remember(self, init: int, then: Callable[[int], int], latency: int = 1) -> int:
        """Return the node that reads a new state; `settle` calls `then` with it to get the node of the next value."""
        return self._open_state(lambda read: (init, then(read)), latency)

    def remember_within(self, init: int, then: Callable[[int], int], limits: Callable[[], tuple[int, int]]) -> int:
        """Return the same as `remember` with an initial value within limits, unless these depend on the state then."""
        read = self.remember(init, then)
        self._limited.append((read, limits))
        return read

    def remember_input(self, x: Callable[[], int], otherwise: float, latency: int) -> int:
        """Return a state holding x; it starts with the first x, or with `otherwise` if the first x depends on
        the state.
        """

        def contents(read: int) -> tuple[int, int]:
            node = x()
            return (self.const(otherwise) if self._needs(node, read) else node), node

        return self._open_state(contents, latency)

    def _open_state(self, contents: Callable[[int], tuple[int, int]], latency: int) -> int:
        read = self.state(latency)
        # asked for in `settle` only, as the contents may read this state
        self._open.append((read, contents))
        return read

    def _needs(self, node: int, other: int) -> bool:
        """Return True if the first value of `node` depends on that of `other`, through other states as well."""
        seen, stack = {node}, [node]
        while stack:
            op, args, payload = self.nodes[stack.pop()]
            # a state that is not closed yet has no first value to follow
            if op == "state" and self.states[payload].init >= 0:
                args = (self.states[payload].init,)
            further = [a for a in args if a not in seen]
            seen.update(further)
            stack += further
        return other in seen

    def settle(self) -> None:
        """Close all open states; closing one may open others. Then limit initial values."""
        while self._open:
            read, contents = self._open.pop()
            self.close(read, *contents(read))
        while self._limited:
            read, limits = self._limited.pop(0)
            which = self.nodes[read].payload
            init = self.within(self.states[which].init, *limits())
            # limits that depend on the state at its start would make its first value depend on itself
            if not self._needs(init, read):
                self.states[which] = self.states[which]._replace(init=init)

    def value(self, node: int) -> float | None:
        """Return the value of a constant node, or None."""
        return float(self.nodes[node].payload) if self.nodes[node].op == "const" else None


class GraphTooLargeError(Exception):
    """The import requires more operations than allowed; `place` is the block that exceeded the limit."""

    def __init__(self, place: str, message: str) -> None:
        super().__init__(message)
        self.place, self.message = place, message
        self.remedy = "Import a subsystem, or make the arrays in it smaller."


class BoundedGraphBuilder(GraphBuilder):
    """Graph builder that accepts at most `most` requests for nodes; `place` names the block under construction.

    Raises:
        GraphTooLargeError: the limit is exceeded.
    """

    def __init__(self) -> None:
        super().__init__()
        self.asked = 0
        self.most = _MAX_REQUESTS
        self.place = ""

    def node(self, op: str, args: tuple[int, ...] = (), payload: Any = None) -> int:
        self.asked += 1
        if self.asked > self.most or len(self.nodes) > _MAX_NODES:
            message = f"the blocks up to here require more than {_MAX_NODES} operations per step"
            raise GraphTooLargeError(self.place, message)
        return super().node(op, args, payload)
