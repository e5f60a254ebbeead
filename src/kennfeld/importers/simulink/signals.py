"""Signals during lowering: arrays of graph nodes, or buses of named signals."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any, TypeAlias

import numpy as np

from kennfeld.base.formatting import count_noun, join_names, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import CONDITIONS, GraphBuilder
from kennfeld.importers.simulink.float_types import FloatType
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, elementwise

CONSTANT = math.inf
CONTINUOUS = 0.0
_MAX_NAMED = 3  # inputs named in a sentence


def _operator(op: str) -> "Callable[[Signal, Signal | float], Signal]":
    return lambda signal, other: apply(op, signal, other)


def _reflected_operator(op: str) -> "Callable[[Signal, float], Signal]":
    return lambda signal, other: apply(op, other, signal)


@dataclass(frozen=True)
class InputWidth:
    """Origin of the width of a signal from outside of the model.

    `why` says which object specifies it, or why it is unknown; `key` then identifies it for blocks that require a
    width, and `required_by` is the path of a block that did.
    """

    name: str
    size: int
    why: str
    key: Any = None
    required_by: str = ""

    @property
    def note(self) -> str:
        """The origin as a clause of a message."""
        return width_note([self.name], self) if self.key else f"{self.name} has {self._elements} by {self.why}"

    @property
    def _elements(self) -> str:
        return count_noun(self.size, "element")


def width_note(names: Sequence[str], width: InputWidth) -> str:
    """Return a clause on inputs of unknown width, assumed to be that of one of them."""
    required = f", as {width.required_by} requires" if width.required_by else ""
    return f"the width of {join_names(names, _MAX_NAMED)} is unknown, assumed {width.size}{required}: {width.why}"


def width_notes(*signals: "Signal") -> str:
    """Return what is known of the widths of signals, to append to a message on sizes that do not match."""
    notes = dict.fromkeys(signal.width.note for signal in signals if signal.width is not None)
    return "".join(f"; {note}" for note in notes)


@dataclass(frozen=True, eq=False)
class Signal:
    """Graph nodes in the shape of the signal: (n,) for a vector, (rows, columns) for a matrix, (1,) for a scalar.

    `period` is the sample time in s: 0 if it may change at any time, infinite if it is constant. `sound` is False for
    placeholders of unsupported signals. `width` is the origin of its width, if it is that of an input. `type` is None
    for what has no type of its own, such as parameters of blocks. Operators act element by element, with numbers as
    constants, and add nodes to the graph of `builder`; comparisons give 1 or 0, and `&`, `|` and `~` are logical.
    """

    nodes: Nodes
    period: float = CONTINUOUS
    sound: bool = True
    builder: GraphBuilder | None = None
    width: InputWidth | None = None
    type: FloatType | None = None

    __array_ufunc__ = None  # a numpy number on the left leaves the operation to the signal

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of nodes."""
        return self.nodes.shape

    @property
    def size(self) -> int:
        """Number of elements."""
        return self.nodes.size

    @property
    def flat(self) -> list[int]:
        """Nodes, column by column."""
        return [int(node) for node in self.nodes.ravel(order="F")]

    @property
    def matrix(self) -> Nodes:
        """Nodes as a matrix, a vector as a column."""
        return self.nodes.reshape(-1, 1) if self.nodes.ndim == 1 else self.nodes

    @property
    def elements(self) -> "list[Signal]":
        """Scalar signals, column by column."""
        return [replace(self, nodes=np.array([node], dtype=np.int64), width=None) for node in self.flat]

    __add__ = _operator("add")
    __sub__ = _operator("sub")
    __mul__ = _operator("mul")
    __truediv__ = _operator("div")
    __pow__ = _operator("pow")
    __mod__ = _operator("mod")
    __and__ = _operator("and")
    __or__ = _operator("or")
    __lt__ = _operator("lt")
    __le__ = _operator("le")
    __gt__ = _operator("gt")
    __ge__ = _operator("ge")
    __radd__ = _reflected_operator("add")
    __rsub__ = _reflected_operator("sub")
    __rmul__ = _reflected_operator("mul")
    __rtruediv__ = _reflected_operator("div")
    __rpow__ = _reflected_operator("pow")

    def __neg__(self) -> "Signal":
        return apply("neg", self)

    def __abs__(self) -> "Signal":
        return apply("abs", self)

    def __invert__(self) -> "Signal":
        return apply("not", self)


def apply(op: str, *args: Signal | float) -> Signal:
    """Apply a graph operation element by element; scalars are broadcast, numbers are constants."""
    # handlers mix signals with plain numbers, which know no graph
    builder = next(arg.builder for arg in args if isinstance(arg, Signal) and arg.builder is not None)
    spread = broadcast(*(arg if isinstance(arg, Signal) else constant(builder, arg) for arg in args))
    nodes = elementwise(builder, op, *(signal.nodes for signal in spread))
    # the result of an operation by elements has the width of an operand, except for scalars that were broadcast
    widths = (arg.width for arg in args if isinstance(arg, Signal) and arg.shape == nodes.shape)
    width = next(filter(None, widths), None)
    return Signal(nodes, period_of(spread), builder=builder, width=width, type=_type_of_result(op, args))


def _type_of_result(op: str, args: Sequence[Signal | float]) -> FloatType | None:
    if op in CONDITIONS:
        return FloatType.OTHER
    # a condition that selects has no part in it
    own = args[1:] if op == "select" else args
    return max((arg.type for arg in own if isinstance(arg, Signal) and arg.type is not None), default=None)


def broadcast(*signals: Signal) -> list[Signal]:
    """Broadcast signals to their common shape; raise `EvaluationError` if they do not match."""
    shapes = [signal.shape for signal in signals]
    if shapes.count(shapes[0]) == len(shapes):
        return list(signals)
    shape = common_shape(*shapes)
    if shape is None:
        sizes = ", ".join(size_text(signal.shape) for signal in signals)
        raise EvaluationError(f"its inputs have the sizes {sizes}, which do not match{width_notes(*signals)}")
    return [replace(signal, nodes=fit_to_shape(signal.nodes, shape)) for signal in signals]


def constant(builder: GraphBuilder, *values: float) -> Signal:
    """Return a vector of constants."""
    nodes = np.array([builder.const(value) for value in values], dtype=np.int64)
    return Signal(nodes, CONSTANT, builder=builder)


def select(condition: Signal, yes: Signal | float, no: Signal | float) -> Signal:
    """Select one signal where a condition holds, else the other."""
    return apply("select", condition, yes, no)


def select_by_index(index: Signal, values: Sequence[Signal], first: float) -> Signal:
    """Return the first value if the index is below `first`, the second if it is below `first` + 1, and so on."""
    # from the last to the first, so that an index beyond the end selects the last value
    result = values[-1]
    for at in reversed(range(len(values) - 1)):
        result = select(index < at + first, values[at], result)
    return result


def staircase(x: Signal, start: Signal, steps: Iterable[tuple[float, float]]) -> Signal:
    """Return the value of the last step (limit, value) whose limit x has reached, `start` before the first."""
    for limit, value in steps:
        start = select(x >= limit, value, start)
    return start


def interpolate_line(x: Signal, xs: Sequence[Signal], ys: Sequence[Signal]) -> Signal:
    """Evaluate the line through two points at x."""
    return ys[0] + (x - xs[0]) / (xs[1] - xs[0]) * (ys[1] - ys[0])


def clip(x: Signal, lower: Signal, upper: Signal) -> Signal:
    """Limit a signal; infinite limits have no effect."""
    # an infinite limit would only add a node and a kink for derivatives
    if not _is_constant(lower, -math.inf):
        x = apply("max", x, lower)
    return x if _is_constant(upper, math.inf) else apply("min", x, upper)


def limit(x: Signal, lower: float, upper: float) -> Signal:
    """Limit a signal to numbers."""
    return apply("min", apply("max", x, lower), upper)


def _is_constant(signal: Signal, value: float) -> bool:
    assert signal.builder is not None
    return all(signal.builder.value(node) == value for node in signal.flat)


SignalRule: TypeAlias = Callable[[Signal], Signal]


def scalar(node: int, period: float = CONTINUOUS, builder: GraphBuilder | None = None) -> Signal:
    """Return a signal of one node."""
    return Signal(np.array([node], dtype=np.int64), period, builder=builder)


@dataclass(frozen=True, eq=False)
class Bus:
    """Named signals in bus order."""

    members: Mapping[str, "SignalOrBus"] = field(default_factory=dict)

    @property
    def sound(self) -> bool:
        """True if all its signals are supported."""
        return all(member.sound for member in self.members.values())

    @property
    def period(self) -> float:
        """Shortest sample time of its signals."""
        return period_of(self.members.values())

    def member(self, name: str) -> "SignalOrBus | None":
        """Return the signal or bus of a name, None if there is none."""
        return self.members.get(name)


@dataclass(frozen=True, eq=False)
class ExternalBus(Bus):
    """A bus input of the model whose signals are known only by use: each selected one is an input of its own.

    `name` is its path, "engine.speed"; `create` returns the signal of an input; `why` is the reason why its elements
    are unknown. `members` are signals that were replaced. Used as a signal, it is a single input.
    """

    name: str = ""
    create: Callable[[str], Signal] = lambda name: Signal(np.array([-1]))
    why: str = ""

    @property
    def period(self) -> float:
        """Inputs may change at any time."""
        return CONTINUOUS

    @property
    def signal(self) -> Signal:
        """The single input that it is if no signal is selected."""
        return self.create(self.name)

    def member(self, name: str) -> "SignalOrBus":
        """Return the signal of a name, which may itself be a bus."""
        return self.members.get(name) or replace(self, name=f"{self.name}.{name}", members={})


SignalOrBus: TypeAlias = Signal | Bus


def as_signal(wired: SignalOrBus) -> SignalOrBus:
    """Return the single input that a bus is as long as its elements are unknown; others as they are."""
    return wired.signal if isinstance(wired, ExternalBus) and not wired.members else wired


def leaf_signals(wired: SignalOrBus, name: str = "") -> Iterator[tuple[str, Signal]]:
    """Yield the signals of a bus with their paths `a.b`; a single signal has the given name."""
    if isinstance(wired, ExternalBus):
        wired = wired.signal
    if isinstance(wired, Signal):
        yield name, wired
        return
    for key, member in wired.members.items():
        yield from leaf_signals(member, f"{name}.{key}" if name else key)


def map_members(rule: Callable[..., Signal], mismatch: str, *wired: SignalOrBus, ordered: bool = False) -> SignalOrBus:
    """Apply a rule to signals, or to each member of buses; raise `EvaluationError` if the buses differ."""
    plain = [item.signal if isinstance(item, ExternalBus) else item for item in wired]
    buses = [item for item in plain if isinstance(item, Bus)]
    if not buses:
        return rule(*plain)
    names = [list(bus.members) if ordered else set(bus.members) for bus in buses]
    if len(buses) < len(plain) or any(others != names[0] for others in names):
        raise EvaluationError(mismatch)
    parts = {name: [bus.members[name] for bus in buses] for name in buses[0].members}
    return Bus({name: map_members(rule, mismatch, *part, ordered=ordered) for name, part in parts.items()})


def period_of(signals: Iterable[SignalOrBus]) -> float:
    """Return the sample time of a result computed from these signals, the shortest of theirs."""
    return min((signal.period for signal in signals), default=CONSTANT)


def common_shape(*shapes: tuple[int, ...]) -> tuple[int, ...] | None:
    """Return the shape of an elementwise result, or None: scalars broadcast, a vector matches a one-row or -column
    matrix.

    >>> common_shape((1,), (3,)), common_shape((3,), (3, 1)), common_shape((2,), (3,))
    ((3,), (3, 1), None)
    """
    wide = [shape for shape in shapes if math.prod(shape) != 1]
    if not wide:
        # (1, 1) before (1,)
        return max(shapes, key=len, default=(1,))
    best = max(wide, key=len)
    fits = all(s == best or (len(s) != len(best) and s == (math.prod(best),) and 1 in best) for s in wide)
    return best if fits else None


def as_vector(nodes: Nodes) -> Nodes:
    """Return an array of one row or column as a vector, others unchanged."""
    return nodes.ravel() if nodes.ndim == 2 and 1 in nodes.shape else nodes


def fit_to_shape(nodes: Nodes, shape: tuple[int, ...]) -> Nodes:
    """Return nodes broadcast or reshaped to a shape; raise `EvaluationError` if they do not match it."""
    if nodes.shape == shape:
        return nodes
    if nodes.size not in (1, math.prod(shape)):
        raise EvaluationError(f"its value has {nodes.size} elements, but its signal has size {size_text(shape)}")
    return np.full(shape, nodes.ravel()[0], dtype=np.int64) if nodes.size == 1 else nodes.reshape(shape)
