"""The compiled functions of one model: what they are made of, and those that simulate and sum the cost."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType

from kennfeld.graph import Node
from kennfeld.graph.derivative import Linearization
from kennfeld.native.emitter import PARAMETERS, Item, Layout, Step, emit_items
from kennfeld.native.engine import Engine
from kennfeld.native.ir import Function, literal
from kennfeld.native.output import Output, loss_of, scaled_residual, weighted
from kennfeld.native.rows import HEAD, find, visit

__all__ = [
    "RANGE",
    "ROW",
    "Code",
    "Sample",
    "compiled",
    "cost_code",
    "each_sample",
    "loop_code",
    "node_items",
    "step_items",
    "values_code",
]

RANGE = (("i64", "first"), ("i64", "last"))
ROW = ("i64", "row")
NOTHING: Mapping[int, Item] = MappingProxyType({})
ZERO = literal(0.0)


def needed_nodes(nodes: Sequence[Node], roots: Sequence[int]) -> list[int]:
    """The nodes that the roots need, in order."""
    seen = set(roots)
    stack = list(seen)
    while stack:
        for a in nodes[stack.pop()].args:
            if a not in seen:
                seen.add(a)
                stack.append(a)
    return sorted(seen)


def node_items(nodes: Sequence[Node], roots: Sequence[int], behind: Mapping[int, Item] = NOTHING) -> list[Item]:
    """An item for each node that the roots need; those of `behind` follow their node at once."""

    def compute(node: int) -> Callable[[Step], None]:
        return lambda step: step.compute(node)

    items: list[Item] = []
    for n in needed_nodes(nodes, [*roots, *behind]):
        items.append(Item(nodes[n].args, compute(n), n))
        if n in behind:
            items.append(behind[n])
    return items


Items = Sequence[Item]
Arguments = Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Code:
    """LLVM IR of a function and the helpers it calls."""

    name: str
    parameters: tuple[tuple[str, str], ...]
    text: str


def compiled(*codes: Code) -> list[Callable[..., None]]:
    """The functions, compiled as one module."""
    engine = Engine("".join(code.text for code in codes))
    return [engine.function(code.name, code.parameters) for code in codes]


def step_items(line: Linearization, layout: Layout, tail: Items, behind: Mapping[int, Item] = NOTHING) -> list[Item]:
    """The nodes that `tail` and the states need, `tail`, and the states' step; see `node_items` for `behind`."""
    roots = [needed for item in tail for needed in item.needs] + [state.next for state in line.states]
    return [*node_items(line.nodes, roots, behind), *tail, *_advance(line, layout)]


def loop_code(name: str, extra: Arguments, tail: Items, line: Linearization, layout: Layout, outputs: int = 0) -> Code:
    """A function that runs the step and `tail` for each sample of a range; see `each_sample`."""
    own = [*PARAMETERS, *extra]
    step = emit_items(f"{name}_step", [*own, ROW], step_items(line, layout, tail), line.nodes, layout)
    f = Function(name, [*own, *RANGE])
    with each_sample(f, line, layout, outputs) as sample:
        f.call(f"{name}_step", [*sample.given(own), *sample.place])
    return Code(f.name, f.parameters, step + f.text())


@dataclass(frozen=True)
class Sample:
    """Where a native function stands: at number `row` of its range, which lies in a block of the measurement."""

    f: Function
    row: str
    block: str
    at: str

    def given(self, parameters: Arguments) -> Arguments:
        """The function's own parameters as arguments of its step, tables moved on to the block."""
        tables = ("data", "targets")
        return [(kind, self.f.at(f"%{n}", self.block, "ptr") if n in tables else f"%{n}") for kind, n in parameters]

    @property
    def place(self) -> Arguments:
        """The last arguments of a step."""
        return [("i64", self.row), ("i64", self.at)]


@contextmanager
def each_sample(f: Function, line: Linearization, layout: Layout, outputs: int = 0) -> Iterator[Sample]:
    """Run the body for each sample from `%first` to before `%last`.

    Without states, sums over `outputs` targets visit the samples in their order.
    """
    read = [("%data", HEAD + row) for row in layout.inputs.values()] + [("%targets", row) for row in range(outputs)]
    order = f.load("%data", kind="ptr")
    with f.loop("%first", "%last") as k:
        row = f.new(f"sub i64 {k}, %first")
        yield Sample(f, row, *(find(f, k) if line.states or not outputs else visit(f, order, k, read)))


def _advance(line: Linearization, layout: Layout) -> list[Item]:
    """Write the next value of every state, after all reads."""

    def emit(step: Step) -> None:
        f = step.f
        for i, state in enumerate(line.states):
            f.store(step.value(state.next), "%memory", step.ring(i))
            if state.latency > 1:
                following = f.add(f.load("%hints", i, "i64"), 1)
                wrapped = f.new(f"icmp eq i64 {following}, {state.latency}")
                f.store(f.new(f"select i1 {wrapped}, i64 0, i64 {following}"), "%hints", i, "i64")

    return [Item(tuple(state.next for state in line.states), emit)] if line.states else []


def values_code(line: Linearization, layout: Layout, roots: Sequence[int]) -> Code:
    """`values(..., out, out_stride, first, last)`: the roots of each sample, out[root][sample - first]."""

    def write(at: int, root: int) -> Item:
        def emit(step: Step) -> None:
            f = step.f
            f.store(step.value(root), f.at("%out", f.mul("%out_stride", at)), "%row")

        return Item((root,), emit)

    tail = [write(at, root) for at, root in enumerate(roots)]
    return loop_code("values", [("ptr", "out"), ("i64", "out_stride")], tail, line, layout)


def cost_code(line: Linearization, layout: Layout, outputs: Sequence[Output]) -> Code:
    """`cost(..., targets, sums, first, last)`: adds each output's sum of losses to sums[output]."""

    def add(at: int, output: Output) -> Item:
        def emit(step: Step) -> None:
            f = step.f
            residual, scored = scaled_residual(step, at, output)
            loss, _ = loss_of(f, residual, output)
            f.increase(f.select(scored, weighted(step, loss, output), ZERO), "%sums", at)

        return Item(output.nodes, emit)

    tail = [add(at, output) for at, output in enumerate(outputs)]
    return loop_code("cost", [("ptr", "targets"), ("ptr", "sums")], tail, line, layout, len(outputs))
