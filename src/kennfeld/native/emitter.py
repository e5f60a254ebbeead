"""LLVM IR of one step of the model: the nodes of a lowered graph as straight-line code.

The code is a list of items, nodes first, in order. Long lists are split into several functions, because the run time of
LLVM's passes grows faster than the length of a block; values used across functions are kept in a frame in memory.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field
from functools import reduce
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.engine import SharedFunction, shared_function
from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import LANES, ONE, ZERO, FunctionWriter, literal
from kennfeld.domain.free_axes import AxisKey
from kennfeld.graph import Node
from kennfeld.graph.dense_layer import ACTIVATIONS, DenseLayer, DenseOutput
from kennfeld.graph.external_function import ExternalFunction, ExternalOutput
from kennfeld.graph.lookup_lowering import AxisRef, ExpansionRef, LoweredGraph, TableRef
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.column_table import HEAD, load_sample
from kennfeld.native.dense_code import write_layer, write_pull
from kennfeld.native.elementwise import CONDITIONS, VALUES, guarded_product, power
from kennfeld.native.rbf_code import KERNELS, write_evaluation, write_value_slopes
from kennfeld.native.table_lookup import Cell, Window, corners, find_cell, smooth_window

SEGMENT = 600  # items a function

PARAMETERS = (
    ("ptr", "data"),  # ptr[1 + inputs][stride], the order and the inputs, see `rows`; a step's begins at its block
    ("i64", "stride"),  # blocks of samples
    ("ptr", "values"),  # double[values], all parameters one after the other
    ("ptr", "axes"),  # double[breakpoints], see Layout.breakpoints
    ("ptr", "widths"),  # double[axes], standard deviations of the smoothing
    ("ptr", "memory"),  # double[cells], the states
    ("ptr", "hints"),  # i64[hints], ring positions and last cells
)


@dataclass(frozen=True)
class MemoryLayout:
    """Offsets of inputs, values, axes and states in the arrays that the compiled code receives."""

    inputs: Mapping[str, int]
    offsets: Mapping[str, int]  # first value of each parameter
    shapes: Mapping[str, tuple[int, ...]]
    axes: tuple[Float, ...]
    latencies: tuple[int, ...]  # of the states
    moving: Mapping[AxisKey, int] = field(default_factory=dict)  # first value of each free axis
    free: int = 0  # values before this one are fitted; expansions behind it hold reciprocals of their widths
    axis_offsets: tuple[int, ...] = field(init=False)
    searches: Mapping[tuple[int, int], int] = field(default_factory=dict)  # number of each node searched in an axis
    memory_offsets: tuple[int, ...] = field(init=False)

    @classmethod
    def of(cls, lowered: LoweredGraph, nodes: Sequence[Node], values: ValueLayout) -> "MemoryLayout":
        """Return the layout for a lowered graph; the inputs are those of `nodes`, in their order."""
        inputs = dict.fromkeys(node.payload for node in nodes if node.op == "input")
        searched = [(node.args[0], node.payload.number) for node in nodes if node.op in ("position", "density")]
        return cls(
            {name: row for row, name in enumerate(inputs)},
            values.offsets,
            lowered.shapes,
            lowered.axes,
            tuple(state.latency for state in lowered.graph.states),
            values.moving,
            values.free,
            {search: number for number, search in enumerate(dict.fromkeys(searched))},
        )

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis_offsets", _before([a.size for a in self.axes]))
        object.__setattr__(self, "memory_offsets", _before(self.latencies))

    @property
    def breakpoints(self) -> Float:
        """All axes one after the other, Float[breakpoints + LANES], so that whole vectors can be read at the end."""
        return np.concatenate([*self.axes, np.zeros(LANES)])

    @property
    def memory(self) -> int:
        """Number of doubles for the states."""
        return sum(self.latencies)

    @property
    def hints(self) -> int:
        """Number of integers for ring buffers and searches."""
        return max(len(self.latencies) + len(self.searches), 1)

    def hint(self, x: int, axis: AxisRef) -> int:
        """Return the index at which the search of node `x` in an axis stores its last cell."""
        return len(self.latencies) + self.searches[x, axis.number]

    def strides(self, table: str) -> list[int]:
        """Return the distance of neighbours along each axis of a table, in values."""
        shape = self.shapes[table]
        return [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]


def _before(sizes: Sequence[int]) -> tuple[int, ...]:
    return tuple(int(n) for n in np.cumsum([0, *sizes])[:-1])


@dataclass(frozen=True)
class CodeItem:
    """A piece of code: a node, or an action at the end that uses the values of the nodes `needs`."""

    needs: tuple[int, ...]
    emit: "Callable[[StepEmitter], None]"
    node: int | None = None


class Condition(NamedTuple):
    """An i1, possibly negated: the negation costs nothing in a select."""

    register: str
    negated: bool = False


class ExternalCall(NamedTuple):
    """A call of an external function, which computes all its outputs."""

    function: ExternalFunction
    args: tuple[int, ...]


class LayerMemory(NamedTuple):
    """Addresses of the inputs of a layer, followed by a 1, and of its outputs, followed by their slopes."""

    inputs: str
    outputs: str


class StepEmitter:
    """Code under construction within one function, for the sample at index `%k` of its block."""

    def __init__(
        self, f: FunctionWriter, nodes: Sequence[Node], layout: MemoryLayout, frame: Mapping[int, int]
    ) -> None:
        self.f = f
        self.nodes = nodes
        self.layout = layout
        self.frame = frame
        self._values: dict[int, str] = {}
        self._truths: dict[int, Condition] = {}
        self._cells: dict[tuple[int, int], Cell] = {}
        self._windows: dict[tuple[int, AxisRef], Window] = {}
        self._expansions: dict[tuple[str, tuple[int, ...]], str] = {}
        self._externals: dict[ExternalCall, str] = {}
        self.sloped: Mapping[ExternalCall, Collection[int]] = {}  # arguments along which slopes are needed
        self._layers: dict[tuple[DenseLayer, tuple[int, ...]], LayerMemory] = {}
        self._pulls: dict[tuple[DenseLayer, tuple[int, ...]], str] = {}

    def value(self, node: int) -> str:
        """Return the double of a node computed before."""
        if node not in self._values:
            # a condition stays an i1 until it is used as a number
            if node in self._truths:
                self._values[node] = self.choose(node, ONE, ZERO)
            else:
                self._values[node] = self.f.load("%frame", self.frame[node])
        return self._values[node]

    def _is_known(self, node: int) -> bool:
        return node in self._values or node in self._truths or node in self.frame

    def _truth(self, node: int) -> Condition:
        if node not in self._truths:
            self._truths[node] = Condition(self.f.new(f"fcmp une double {self.value(node)}, {ZERO}"))
        return self._truths[node]

    def _condition(self, node: int) -> str:
        """Return the truth of a node as an i1; NaN is true."""
        register, negated = self._truth(node)
        return self.f.new(f"xor i1 {register}, true") if negated else register

    def choose(self, node: int, a: str, b: str) -> str:
        """Return the double a if a node is true, else b."""
        register, negated = self._truth(node)
        return self.f.select(register, b, a) if negated else self.f.select(register, a, b)

    def compute(self, node: int) -> None:
        """Emit one node."""
        op, args, payload = self.nodes[node]
        f = self.f
        if op in CONDITIONS:
            a, b = (self.value(x) for x in args)
            self._truths[node] = Condition(f.new(f"fcmp {CONDITIONS[op]} double {a}, {b}"))
        elif op in ("and", "or"):
            self._truths[node] = Condition(f.new(f"{op} i1 {self._condition(args[0])}, {self._condition(args[1])}"))
        elif op == "not":
            register, negated = self._truth(args[0])
            self._truths[node] = Condition(register, not negated)
        else:
            self._values[node] = self._double(node, op, args, payload)

    def _double(self, node: int, op: str, args: tuple[int, ...], payload: object) -> str:
        f = self.f
        match op, payload:
            case "const", float():
                return literal(payload)
            case "input", str():
                return load_sample(f, "%data", HEAD + self.layout.inputs[payload], "%k")
            case "state", int():
                return f.load("%memory", self.ring(payload))
            case "position", AxisRef():
                cell = self._search(node, args[0], payload)
                return f.new(f"fadd double {f.new(f'sitofp i64 {cell.index} to double')}, {cell.fraction}")
            case "density", AxisRef():
                return self._density(args[0], payload)
            case "interpolate", TableRef():
                return self._table(payload, args, None)
            case "slope", (TableRef() as table, int() as axis):
                return self._table(table, args, axis)
            case "expansion", ExpansionRef():
                return f.load(self._expansion(payload, args))
            case "expansion_slope", (ExpansionRef() as ref, int() as axis):
                return f.load(self._expansion(ref, args), 1 + axis)
            case "external", ExternalOutput(function, number):
                return f.load(self._external(function, args), number)
            case "external_slope", (ExternalOutput(function, number), int() as axis):
                return f.load(self._external(function, args), function.outputs + number * function.inputs + axis)
            case "dense", DenseOutput(layer, number):
                return f.load(self.layer(layer, args).outputs, number)
            case "dense_slope", (DenseOutput(layer, number), int() as axis):
                weight = f.load("%values", self.layout.offsets[layer.name] + axis * layer.outputs + number)
                return f.fmul(f.load(self.layer(layer, args).outputs, layer.outputs + number), weight)
            case "dense_pull", (DenseLayer() as layer, int() as axis):
                return f.load(self._pull(layer, args), axis)
            case "select", _:
                return self.choose(args[0], self.value(args[1]), self.value(args[2]))
            case "pow", _ if self._is_short_power(args[1]):
                return power(f, self.value(args[0]), int(self.nodes[args[1]].payload))
            case _:
                return VALUES[op](f, *(self.value(a) for a in args))

    def _is_short_power(self, node: int) -> bool:
        op, _, payload = self.nodes[node]
        return op == "const" and float(payload).is_integer() and abs(payload) <= 16

    def ring(self, state: int) -> str:
        """Return the index of the memory cell that holds the current value of a state."""
        base = self.layout.memory_offsets[state]
        if self.layout.latencies[state] == 1:
            return str(base)
        return self.f.add(self.f.load("%hints", state, "i64"), base)

    def _search(self, node: int, x: int, axis: AxisRef) -> Cell:
        f, points = self.f, self.layout.axes[axis.number]
        if points.size == 1:
            # 0, but NaN for a coordinate that is not finite
            cell = Cell("0", f.fmul(self.value(x), ZERO), single=True)
        else:
            index, past, width = self._find_cell(x, axis)
            fraction = f.new(f"fdiv double {past}, {width}")
            # two selects and no branch; NaN fails both comparisons and stays
            if axis.extrapolation == "clip":
                fraction = f.select(f.new(f"fcmp olt double {fraction}, {ZERO}"), ZERO, fraction)
                fraction = f.select(f.new(f"fcmp ogt double {fraction}, {ONE}"), ONE, fraction)
            cell = Cell(index, fraction)
        # kept: split again from the rounded sum, a coordinate just below a breakpoint could be in the cell above it
        self._cells[node, points.size] = cell
        return cell

    def _find_cell(self, x: int, axis: AxisRef) -> tuple[str, str, str]:
        hint = self.f.at("%hints", self.layout.hint(x, axis), "i64")
        return find_cell(self.f, self.value(x), self._points(axis), self.layout.axes[axis.number].size, hint)

    def _points(self, axis: AxisRef) -> str:
        """Return the address of the breakpoints of an axis."""
        if axis.key is not None:
            return self.f.at("%values", self.layout.moving[axis.key])
        return self.f.at("%axes", self.layout.axis_offsets[axis.number])

    def _density(self, x: int, axis: AxisRef) -> str:
        f, points = self.f, self.layout.axes[axis.number]
        if points.size == 1:
            return ZERO
        _, _, width = self._find_cell(x, axis)
        slope = f.new(f"fdiv double {ONE}, {width}")
        if axis.extrapolation == "linear":
            return slope
        low, high = (
            literal(float(points[i])) if axis.key is None else f.load(self._points(axis), i % points.size)
            for i in (0, -1)
        )
        # both ends belong to the axis: there the slope is that of the cell
        above = f.new(f"fcmp oge double {self.value(x)}, {low}")
        below = f.new(f"fcmp ole double {self.value(x)}, {high}")
        # nested selects, as an `and` of comparisons leaves the fast path of LLVM's instruction selection
        return f.select(above, f.select(below, slope, ZERO), ZERO)

    def sides(self, table: TableRef, args: Sequence[int]) -> list[Cell | Window]:
        """Return the grid points around the coordinate, one entry per axis."""
        shape = self.layout.shapes[table.name]
        return [
            self._window(a, axis) if smoothed else self.cell(a, count)
            for a, axis, smoothed, count in zip(args, table.axes, table.smoothed, shape, strict=True)
        ]

    def cell(self, node: int, count: int) -> Cell:
        """Return the two of `count` grid points around a position."""
        if (node, count) not in self._cells:
            op, args, payload = self.nodes[node]
            if op == "position" and self._is_known(args[0]):
                # in a later function than the position: searched again, as its sum has lost bits of the fraction
                return self._search(node, args[0], payload)
            f, place = self.f, self.value(node)
            if count == 1:
                return Cell("0", f.fmul(place, ZERO), single=True)
            # clamped as a double, since clamped integers leave the fast path of LLVM's instruction selection; beyond
            # the ends the fraction is < 0 or > 1, which is linear extrapolation, and for NaN it is NaN in cell 0
            low = f.select(f.new(f"fcmp ogt double {place}, {ZERO}"), place, ZERO)
            last = literal(float(count - 2))
            index = f.new(f"fptosi double {f.select(f.new(f'fcmp olt double {low}, {last}'), low, last)} to i64")
            past = f.new(f"fsub double {place}, {f.new(f'sitofp i64 {index} to double')}")
            self._cells[node, count] = Cell(index, past)
        return self._cells[node, count]

    def _window(self, x: int, axis: AxisRef) -> Window:
        if (x, axis) not in self._windows:
            at = self.f.at("%axes", self.layout.axis_offsets[axis.number])
            width = self.f.load("%widths", axis.number)
            count = self.layout.axes[axis.number].size
            linear = axis.extrapolation == "linear"
            self._windows[x, axis] = smooth_window(self.f, self.value(x), at, count, width, linear)
        return self._windows[x, axis]

    def _expansion(self, ref: ExpansionRef, args: tuple[int, ...]) -> str:
        """Return the address of an expansion's value, followed by its slopes along the inputs."""
        if (ref.name, args) not in self._expansions:
            # widths that are not fitted are stored as their reciprocals, see `MemoryLayout.free`
            reciprocal = self.layout.offsets[ref.name] >= self.layout.free
            function = shared_function(write_evaluation, ref.inputs, KERNELS.index(ref.kernel), reciprocal)
            out = self.f.slot("double", 1 + ref.inputs)
            self._call_expansion(function, ref, args, out)
            self._expansions[ref.name, args] = out
        return self._expansions[ref.name, args]

    def expansion_weights(self, ref: ExpansionRef, args: tuple[int, ...]) -> tuple[int, str]:
        """Return the number of values of an expansion, and the address of its slopes with respect to them."""
        count = int(np.prod(self.layout.shapes[ref.name]))
        function = shared_function(write_value_slopes, ref.inputs, KERNELS.index(ref.kernel))
        out = self.f.slot("double", count)
        self._call_expansion(function, ref, args, out)
        return count, out

    def _call_expansion(self, function: SharedFunction, ref: ExpansionRef, args: tuple[int, ...], out: str) -> None:
        f, x = self.f, self.f.slot("double", ref.inputs)
        for d, a in enumerate(args):
            f.store(self.value(a), x, d)
        values = f.at("%values", self.layout.offsets[ref.name])
        f.do(f"call void {function.pointer(f)}(ptr {values}, i64 {ref.centres}, ptr {x}, ptr {out})")

    def layer(self, layer: DenseLayer, args: tuple[int, ...]) -> LayerMemory:
        """Return the inputs and outputs of a dense layer."""
        if (layer, args) not in self._layers:
            f = self.f
            memory = LayerMemory(f.slot("double", layer.inputs + 1), f.slot("double", 2 * layer.outputs))
            for j, a in enumerate(args):
                f.store(self.value(a), memory.inputs, j)
            # the input of the biases, whose slope it is
            f.store(ONE, memory.inputs, layer.inputs)
            evaluate = shared_function(write_layer, ACTIVATIONS.index(layer.activation))
            arguments = f"{self._weights(layer)}, double {literal(layer.alpha)}"
            f.do(f"call void {evaluate.pointer(f)}({arguments}, ptr {memory.inputs}, ptr {memory.outputs})")
            self._layers[layer, args] = memory
        return self._layers[layer, args]

    def _pull(self, layer: DenseLayer, args: tuple[int, ...]) -> str:
        """Return the address of the adjoints of a layer's inputs, given its inputs and the adjoints of its outputs."""
        if (layer, args) not in self._pulls:
            f = self.f
            slopes = f.at(self.layer(layer, args[: layer.inputs]).outputs, layer.outputs)
            adjoints, out = f.slot("double", layer.outputs), f.slot("double", layer.inputs)
            for i, a in enumerate(args[layer.inputs :]):
                f.store(self.value(a), adjoints, i)
            arguments = f"{self._weights(layer)}, ptr {slopes}, ptr {adjoints}, ptr {out}"
            f.do(f"call void {shared_function(write_pull).pointer(f)}({arguments})")
            self._pulls[layer, args] = out
        return self._pulls[layer, args]

    def _weights(self, layer: DenseLayer) -> str:
        """Return the arguments with which functions of a layer begin."""
        return f"ptr {self.f.at('%values', self.layout.offsets[layer.name])}, i64 {layer.inputs}, i64 {layer.outputs}"

    def _external(self, function: ExternalFunction, args: tuple[int, ...]) -> str:
        """Return the address of the outputs of an external function, followed by their slopes if these are needed."""
        call = ExternalCall(function, args)
        if call not in self._externals:
            f, x = self.f, self.f.slot("double", max(function.inputs, 1))
            for d, a in enumerate(args):
                f.store(self.value(a), x, d)
            out = f.slot("double", function.outputs * (1 + function.inputs))
            slopes = f.at(out, function.outputs) if call in self.sloped else "null"
            for axis in range(function.inputs if call in self.sloped else 0):
                # the first slopes mark the arguments along which slopes are needed; see `LoadedFunction.address`
                f.store(ONE if axis in self.sloped[call] else ZERO, slopes, axis)
            f.do(f"call void {c_pointer(f, function.symbol)}(ptr {x}, ptr {out}, ptr {slopes})")
            self._externals[call] = out
        return self._externals[call]

    def _table(self, table: TableRef, args: Sequence[int], slope: int | None) -> str:
        f = self.f
        base = f.at("%values", self.layout.offsets[table.name])
        sides, strides = self.sides(table, args), self.layout.strides(table.name)
        terms = (guarded_product(f, c.weight, f.load(base, c.index)) for c in corners(f, sides, strides, slope))
        if not any(isinstance(side, Window) for side in sides):
            # in this order, which `f.sum` would leave to LLVM: exported C code adds in the same one
            return reduce(lambda a, b: f.new(f"fadd double {a}, {b}"), terms)
        total = f.variable("double", ZERO)
        for term in terms:  # within the loops of the windows
            f.increase(term, total.pointer)
        return total.get()


def emit_items(
    name: str, passed: Sequence[tuple[str, str]], items: Sequence[CodeItem], nodes: Sequence[Node], layout: MemoryLayout
) -> str:
    """Write a function `name` that runs the items for the sample at `%k`; long lists become several functions.

    `passed` are its parameters in addition to `k`.
    """
    segments = [items[i : i + SEGMENT] for i in range(0, len(items), SEGMENT)] or [[]]
    whole = FunctionWriter(name, [*passed, ("i64", "k")], "alwaysinline")
    if len(segments) == 1:
        _emit_segment(StepEmitter(whole, nodes, layout, {}), items)
        return whole.text()
    # registers end with their function: what a later segment uses is kept in memory
    frame = _crossing(segments)
    room = whole.slot("double", max(len(frame), 1))
    arguments = [(kind, f"%{parameter}") for kind, parameter in whole.parameters] + [("ptr", room)]
    texts = []
    for number, segment in enumerate(segments):
        part = FunctionWriter(f"{name}_{number}", [*whole.parameters, ("ptr", "frame")], "noinline")
        step = StepEmitter(part, nodes, layout, frame)
        _emit_segment(step, segment)
        for item in segment:
            if item.node is not None and item.node in frame:
                part.store(step.value(item.node), "%frame", frame[item.node])
        texts.append(part.text())
        whole.call(part.name, arguments)
    return "".join(texts) + whole.text()


def _emit_segment(step: StepEmitter, items: Sequence[CodeItem]) -> None:
    # of this segment only, as calls are shared within a function and not across segments
    sloped: dict[ExternalCall, set[int]] = {}
    for node in (step.nodes[item.node] for item in items if item.node is not None):
        if node.op == "external_slope":
            output, axis = node.payload
            sloped.setdefault(ExternalCall(output.function, node.args), set()).add(axis)
    step.sloped = sloped
    for item in items:
        # loaded before the item begins: a register set in a loop of the item could not be used after it
        for needed in item.needs:
            step.value(needed)
        item.emit(step)


def _crossing(segments: Sequence[Sequence[CodeItem]]) -> dict[int, int]:
    """Assign frame slots to the nodes that are used in a later segment than their own."""
    home: dict[int, int] = {}
    frame: dict[int, int] = {}
    for number, segment in enumerate(segments):
        for item in segment:
            for needed in item.needs:
                if home.get(needed, number) != number:
                    frame.setdefault(needed, len(frame))
            if item.node is not None:
                home[item.node] = number
    return frame
