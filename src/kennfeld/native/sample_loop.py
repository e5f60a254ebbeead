"""Compiled loops over samples: simulation of chosen nodes, and the cost with residuals and losses."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.ir import ZERO, FunctionWriter, literal
from kennfeld.domain.criteria import Loss
from kennfeld.graph import Node
from kennfeld.graph.derivative import Linearization
from kennfeld.graph.traversal import ancestors
from kennfeld.native.column_table import HEAD, find, load_sample, visit
from kennfeld.native.emitter import PARAMETERS, CodeItem, MemoryLayout, StepEmitter, emit_items
from kennfeld.native.losses import LOSS_RULES

RANGE = (("i64", "first"), ("i64", "last"))
ROW = ("i64", "row")
NOTHING: Mapping[int, CodeItem] = FrozenDict({})

Items = Sequence[CodeItem]
Arguments = Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Output:
    """Contribution of a node to the cost: loss of (node - target) / scale, times the node `weight` of each sample."""

    node: int
    scale: float = 1.0
    loss: Loss = "square"
    delta: float = 1.0
    weight: int | None = None

    @property
    def nodes(self) -> tuple[int, ...]:
        """The nodes that the loss needs."""
        return (self.node,) if self.weight is None else (self.node, self.weight)


def scaled_residual(step: StepEmitter, at: int, output: Output) -> tuple[str, str]:
    """Return (value - target) / scale, and the condition that the sample is scored, i.e. its target is not NaN."""
    target, scored = _target(step.f, at)
    difference = step.f.new(f"fsub double {step.value(output.node)}, {target}")
    return step.f.fmul(difference, literal(1.0 / output.scale)), scored


def _target(f: FunctionWriter, at: int) -> tuple[str, str]:
    """Return the target of an output, and the condition that there is one."""
    target = load_sample(f, "%targets", at, "%k")
    return target, f.new(f"fcmp ord double {target}, {target}")


def is_counted(f: FunctionWriter, at: int) -> str:
    """Return the condition that an output has a target and a weight; without, it does not count even if not finite."""
    # ordered: a weight that is NaN does not count either
    weighted = f.new(f"fcmp one double {f.load('%scores', at)}, {ZERO}")
    return f.new(f"and i1 {_target(f, at)[1]}, {weighted}")


def apply_weight(step: StepEmitter, factor: str, output: Output) -> str:
    """Return a factor of the loss times the weight of the sample."""
    return factor if output.weight is None else step.f.fmul(factor, step.value(output.weight))


def loss_of(f: FunctionWriter, r: str, output: Output) -> tuple[str, str]:
    """Return the loss of a residual r, and its slope over 2 r, the weight of the equivalent square."""
    return LOSS_RULES[output.loss].code(f, r, output.delta)


def node_items(nodes: Sequence[Node], roots: Sequence[int], behind: Mapping[int, CodeItem] = NOTHING) -> list[CodeItem]:
    """Return an item for each node that the roots need; those of `behind` follow their node at once."""

    def compute(node: int) -> Callable[[StepEmitter], None]:
        return lambda step: step.compute(node)

    items: list[CodeItem] = []
    for n in ancestors(nodes, [*roots, *behind]):
        items.append(CodeItem(_needs(nodes, n), compute(n), n))
        if n in behind:
            items.append(behind[n])
    return items


def _needs(nodes: Sequence[Node], n: int) -> tuple[int, ...]:
    """Return the nodes whose values a node takes, and the coordinates of the cells that it interpolates in."""
    own = nodes[n].args
    return (*own, *(nodes[a].args[0] for a in own if nodes[a].op == "position"))


def step_items(
    line: Linearization, layout: MemoryLayout, tail: Items, behind: Mapping[int, CodeItem] = NOTHING
) -> list[CodeItem]:
    """Return items for the nodes that `tail` and the states need, for `tail`, and for the states' step."""
    # the states step last: an item of `tail` sees those of its own sample
    roots = [needed for item in tail for needed in item.needs] + [state.next for state in line.states]
    return [*node_items(line.nodes, roots, behind), *tail, *_advance(line)]


def loop_code(
    name: str, extra: Arguments, tail: Items, line: Linearization, layout: MemoryLayout, outputs: int = 0
) -> FunctionWriter:
    """Write a function that runs the step and `tail` for each sample of a range; see `each_sample`."""
    own = [*PARAMETERS, *extra]
    step = emit_items(f"{name}_step", [*own, ROW], step_items(line, layout, tail), line.nodes, layout)
    f = FunctionWriter(name, [*own, *RANGE], before=step)
    with each_sample(f, line, layout, outputs) as sample:
        f.call(f"{name}_step", [*sample.arguments(own), *sample.place])
    return f


@dataclass(frozen=True)
class SampleCursor:
    """Position of a native function: number `row` of its range, in a block of the measurement."""

    f: FunctionWriter
    row: str
    block: str
    at: str

    def arguments(self, parameters: Arguments) -> Arguments:
        """Return the function's own parameters as arguments of its step, with tables advanced to the block."""
        tables = ("data", "targets")
        return [(kind, self.f.at(f"%{n}", self.block, "ptr") if n in tables else f"%{n}") for kind, n in parameters]

    @property
    def place(self) -> Arguments:
        """The last arguments of a step."""
        return [("i64", self.row), ("i64", self.at)]


@contextmanager
def each_sample(
    f: FunctionWriter, line: Linearization, layout: MemoryLayout, outputs: int = 0
) -> Iterator[SampleCursor]:
    """Run the body for each sample from `%first` to before `%last`.

    Without states, sums over `outputs` targets visit the samples in their visiting order.
    """
    read = [("%data", HEAD + row) for row in layout.inputs.values()] + [("%targets", row) for row in range(outputs)]
    order = f.load("%data", kind="ptr")
    with f.loop("%first", "%last") as k:
        row = f.new(f"sub i64 {k}, %first")
        yield SampleCursor(f, row, *(find(f, k) if line.states or not outputs else visit(f, order, k, read)))


def _advance(line: Linearization) -> list[CodeItem]:
    """Return the item that writes the next value of every state, after all reads."""

    def emit(step: StepEmitter) -> None:
        f = step.f
        for i, state in enumerate(line.states):
            f.store(step.value(state.next), "%memory", step.ring(i))
            if state.latency > 1:
                f.advance("%hints", i, state.latency)

    return [CodeItem(tuple(state.next for state in line.states), emit)] if line.states else []


def values_code(line: Linearization, layout: MemoryLayout, roots: Sequence[int]) -> FunctionWriter:
    """Write `values(..., out, out_stride, first, last)`: out[root][sample - first] = value of the root."""

    def write(at: int, root: int) -> CodeItem:
        def emit(step: StepEmitter) -> None:
            step.f.store(step.value(root), step.f.at("%out", step.f.mul("%out_stride", at)), "%row")

        return CodeItem((root,), emit)

    tail = [write(at, root) for at, root in enumerate(roots)]
    return loop_code("values", [("ptr", "out"), ("i64", "out_stride")], tail, line, layout)


def cost_code(line: Linearization, layout: MemoryLayout, outputs: Sequence[Output]) -> FunctionWriter:
    """Write `cost(..., targets, sums, first, last)`: sums[output] += losses of the range."""

    def add(at: int, output: Output) -> CodeItem:
        def emit(step: StepEmitter) -> None:
            f = step.f
            residual, scored = scaled_residual(step, at, output)
            loss, _ = loss_of(f, residual, output)
            # selected, since 0 times a loss that is not finite is NaN
            f.increase(f.select(scored, apply_weight(step, loss, output), ZERO), "%sums", at)

        return CodeItem(output.nodes, emit)

    tail = [add(at, output) for at, output in enumerate(outputs)]
    return loop_code("cost", [("ptr", "targets"), ("ptr", "sums")], tail, line, layout, len(outputs))
