"""The compiled functions of one model: simulate, sum the cost, and write the tape of linearised steps.

The tape holds, for each sample, what the sums over samples need and nothing of the model's form:

| array | holds |
|---|---|
| residual, weight | [outputs], 0 where a sample is not scored |
| c | [outputs][carried], slopes of outputs with respect to states |
| a | [carried][carried], slopes of next states with respect to states |
| index, slope | [entries], [entries][outputs + carried]: column and slopes of each value that the step touches |
| count | how many entries |

An entry is a grid point of a lookup; one column may occur in several entries.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from kennfeld.graph import Node
from kennfeld.graph.derivative import Linearization
from kennfeld.native.emitter import PARAMETERS, Item, Layout, Step, emit_items
from kennfeld.native.engine import Engine
from kennfeld.native.entries import entry_items
from kennfeld.native.ir import Function, literal
from kennfeld.native.rows import HEAD, find, load_sample, visit

__all__ = ["Code", "Loss", "Output", "compiled", "cost_code", "start_code", "tape_code", "values_code"]

Loss = Literal["square", "huber", "soft_l1", "excess"]
RANGE = (("i64", "first"), ("i64", "last"))
TAPE = tuple(("ptr", name) for name in ("targets", "scores", "residual", "weight", "c", "a", "index", "slope", "count"))
ZERO = literal(0.0)


@dataclass(frozen=True)
class Output:
    """How the difference between a node and its target counts."""

    node: int
    scale: float = 1.0
    loss: Loss = "square"
    delta: float = 1.0


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


def node_items(nodes: Sequence[Node], roots: Sequence[int]) -> list[Item]:
    """An item for each node that the roots need."""

    def compute(node: int) -> Callable[[Step], None]:
        return lambda step: step.compute(node)

    return [Item(nodes[n].args, compute(n), n) for n in needed_nodes(nodes, roots)]


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


def _loop(name: str, extra: Arguments, tail: Items, line: Linearization, layout: Layout, outputs: int = 0) -> Code:
    """A function that runs the step and `tail` for each sample of a range, `%row` counting from its first.

    Without states, sums over `outputs` targets visit the samples in their order.
    """
    passed = [*PARAMETERS, *extra, ("i64", "row")]
    roots = [needed for item in tail for needed in item.needs] + [state.next for state in line.states]
    items = [*node_items(line.nodes, roots), *tail, *_advance(line, layout)]
    step = emit_items(f"{name}_step", passed, items, line.nodes, layout)
    f = Function(name, [*PARAMETERS, *extra, *RANGE])
    read = [("%data", HEAD + row) for row in layout.inputs.values()] + [("%targets", row) for row in range(outputs)]
    order = f.load("%data", kind="ptr")
    with f.loop("%first", "%last") as k:
        row = f.new(f"sub i64 {k}, %first")
        block, place = find(f, k) if line.states or not outputs else visit(f, order, k, read)
        f.call(f"{name}_step", _arguments(f, passed[:-1], block, row, place))
    return Code(f.name, f.parameters, step + f.text())


def _arguments(f: Function, passed: Arguments, block: str, row: str, place: str) -> Arguments:
    """What a step is called with: the function's own parameters, tables moved on to a block, then row and place."""
    given = [(kind, f.at(f"%{n}", block, "ptr") if n in ("data", "targets") else f"%{n}") for kind, n in passed]
    return [*given, ("i64", row), ("i64", place)]


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
    return _loop("values", [("ptr", "out"), ("i64", "out_stride")], tail, line, layout)


def cost_code(line: Linearization, layout: Layout, outputs: Sequence[Output]) -> Code:
    """`cost(..., targets, sums, first, last)`: adds each output's sum of losses to sums[output]."""

    def add(at: int, output: Output) -> Item:
        def emit(step: Step) -> None:
            f = step.f
            residual, scored = _residual(step, at, output)
            loss, _ = _loss(f, residual, output)
            f.increase(f.select(scored, loss, ZERO), "%sums", at)

        return Item((output.node,), emit)

    tail = [add(at, output) for at, output in enumerate(outputs)]
    return _loop("cost", [("ptr", "targets"), ("ptr", "sums")], tail, line, layout, len(outputs))


def _residual(step: Step, at: int, output: Output) -> tuple[str, str]:
    """(value - target) / scale, and whether the sample is scored: a target of NaN is not."""
    f = step.f
    target, scored = _target(f, at)
    difference = f.new(f"fsub double {step.value(output.node)}, {target}")
    return f.fmul(difference, literal(1.0 / output.scale)), scored


def _target(f: Function, at: int) -> tuple[str, str]:
    """The target of an output, and whether there is one."""
    target = load_sample(f, "%targets", at, "%k")
    return target, f.new(f"fcmp ord double {target}, {target}")


def _counts(f: Function, at: int) -> str:
    """Whether an output has a target and a weight: what is switched off does not count, even where it is not finite."""
    weighted = f.new(f"fcmp one double {f.load('%scores', at)}, {ZERO}")
    return f.new(f"and i1 {_target(f, at)[1]}, {weighted}")


def _loss(f: Function, r: str, output: Output) -> tuple[str, str]:
    """The loss of a residual, and its slope over 2 r, the weight of the equivalent square."""
    square = f.fmul(r, r)
    delta = literal(output.delta)
    match output.loss:
        case "square":
            return square, literal(1.0)
        case "huber":
            size = f.new(f"call double @llvm.fabs.f64(double {r})")
            beyond = f.new(f"fcmp ogt double {size}, {delta}")
            line = f.fmul(delta, f.new(f"fsub double {f.fmul(literal(2.0), size)}, {delta}"))
            return f.select(beyond, line, square), f.select(beyond, f.new(f"fdiv double {delta}, {size}"), literal(1.0))
        case "soft_l1":
            share = f.fmul(square, literal(output.delta**-2))
            root = f.new(f"call double @llvm.sqrt.f64(double {f.new(f'fadd double {literal(1.0)}, {share}')})")
            # 2 r^2 / (root + 1) is 2 delta^2 (root - 1) without the cancellation
            loss = f.new(f"fdiv double {f.fmul(literal(2.0), square)}, {f.fadd(root, literal(1.0))}")
            return loss, f.new(f"fdiv double {literal(1.0)}, {root}")
        case "excess":
            beyond = f.new(f"fcmp ogt double {r}, {ZERO}")
            return f.select(beyond, square, ZERO), f.select(beyond, literal(1.0), ZERO)


def tape_code(line: Linearization, layout: Layout, outputs: Sequence[Output]) -> Code:
    """`tape(..., targets, scores, residual, ..., count, first, last)`: the tape of a range, see the module.

    `scores[output]` is the weight of the dataset and criterion.
    """
    m, n = len(outputs), len(line.carried)

    def residuals(at: int, output: Output) -> Item:
        def emit(step: Step) -> None:
            f = step.f
            residual, _ = _residual(step, at, output)
            scored = _counts(f, at)
            _, weight = _loss(f, residual, output)
            scored_weight = f.fmul(weight, f.load("%scores", at))
            place = f.add(f.mul("%row", m), at)
            f.store(f.select(scored, residual, ZERO), "%residual", place)
            f.store(f.select(scored, scored_weight, ZERO), "%weight", place)
            for i, seed in enumerate(line.seeds):
                slope = _output_slope(step, line, output, at, seed)
                f.store(slope, "%c", f.add(f.mul(place, n), i))

        needs = (output.node, *_present(line.slopes[at], line.seeds))
        return Item(needs, emit)

    def next_state(row: int) -> Item:
        slopes = line.slopes[m + row]

        def emit(step: Step) -> None:
            f = step.f
            place = f.mul(f.add(f.mul("%row", n), row), n)
            for i, seed in enumerate(line.seeds):
                slope = _state_slope(step, following, slopes[seed]) if seed in slopes else ZERO
                f.store(slope, "%a", f.add(place, i))

        following = line.states[line.carried[row]].next
        return Item((following, *_present(slopes, line.seeds)), emit)

    tail = [residuals(at, output) for at, output in enumerate(outputs)]
    tail += [next_state(row) for row in range(n)]

    def slope_of(step: Step, row: int, atom: int) -> str:
        if row < m:
            return _output_slope(step, line, outputs[row], row, atom)
        return _state_slope(step, line.states[line.carried[row - m]].next, line.slopes[row][atom])

    tail += entry_items(line, layout, line.atoms, line.slopes, slope_of, [line.states[i].next for i in line.carried])
    return _loop("tape", TAPE, tail, line, layout, m)


def _present(slopes: Mapping[int, int], seeds: Sequence[int]) -> tuple[int, ...]:
    return tuple(slopes[seed] for seed in seeds if seed in slopes)


def _output_slope(step: Step, line: Linearization, output: Output, at: int, seed: int) -> str:
    """Slope of a residual; 0 where the sample is not scored, whatever the slope is there."""
    f = step.f
    if seed not in line.slopes[at]:
        return ZERO
    scored = _counts(f, at)
    slope = f.fmul(step.value(line.slopes[at][seed]), literal(1.0 / output.scale))
    return f.select(scored, slope, ZERO)


def _state_slope(step: Step, state: int, slope: int) -> str:
    """A slope of a state; 0 where the state is not finite, as then only a condition can keep it from the outputs."""
    f = step.f
    nothing = f.new(f"fsub double {step.value(state)}, {step.value(state)}")
    return f.select(f.new(f"fcmp oeq double {nothing}, {ZERO}"), step.value(slope), ZERO)


def start_code(line: Linearization, layout: Layout) -> Code:
    """`start(..., index, slope, count, k)`: first values of all states at sample k, and the entries of their slopes."""

    def slope_of(step: Step, row: int, atom: int) -> str:
        return _state_slope(step, line.starts[line.carried[row]], line.start_slopes[row][atom])

    def fill(step: Step) -> None:
        f = step.f
        for i, state in enumerate(line.states):
            first = step.value(line.starts[i])
            base = f.at("%memory", layout.memory_offsets[i])
            with f.loop(0, state.latency) as slot:
                f.store(first, base, slot)
            if state.latency > 1:
                f.store("0", "%hints", i, "i64")

    items = node_items(line.nodes, [*line.starts, *(at for row in line.start_slopes for at in row.values())])
    items += entry_items(line, layout, line.start_atoms, line.start_slopes, slope_of, line.starts)
    items.append(Item(tuple(line.starts), fill))
    extra = [("ptr", "index"), ("ptr", "slope"), ("ptr", "count")]
    passed = [*PARAMETERS, *extra, ("i64", "row")]
    step = emit_items("start_step", passed, items, line.nodes, layout)
    f = Function("start", [*PARAMETERS, *extra, ("i64", "k")])
    block, place = find(f, "%k")
    f.call("start_step", _arguments(f, passed[:-1], block, "0", place))
    return Code(f.name, f.parameters, step + f.text())
