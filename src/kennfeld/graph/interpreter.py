"""Reference interpreter of graphs in numpy, one node after the other. All other backends are tested against it."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import ArrayLike, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.free_axes import AxisKey, free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.rbf import RBF
from kennfeld.graph.dense_layer import DenseLayer, evaluate_layer
from kennfeld.graph.derivative import Linearization, Slopes, Written
from kennfeld.graph.external_function import evaluate_points
from kennfeld.graph.interpolation import (
    cell_weights,
    density,
    interpolate,
    position,
    smooth_weights,
    table_weights,
)
from kennfeld.graph.lookup_lowering import AxisRef, ExpansionRef, LoweredGraph, TableRef, lower_lookups
from kennfeld.graph.node import Graph, Node, State
from kennfeld.graph.operations import OPERATIONS


def evaluate(
    graph: Graph, columns: Mapping[str, ArrayLike], parameters: ParameterSet, starts: Sequence[int] = (0,)
) -> dict[str, Float]:
    """Evaluate every named node of a graph over the samples.

    Args:
        graph: graph with lookups.
        parameters: the parameters it looks up.
        columns: inputs by name, shape (samples,) each; `dt` and `t` in s if the graph uses them.
        starts: samples at which the states start anew.

    Returns:
        The values of each named node, shape (samples,).
    """
    arrays = {name: np.asarray(column, dtype=np.float64) for name, column in columns.items()}
    lowered = lower_lookups(graph, parameters)
    run = Interpreter(lowered, parameters).run(lowered.graph.nodes, lowered.graph.states, arrays, starts)
    return {name: run[at] for name, at in lowered.graph.names.items()}


Evaluation = list[Float]  # one array a node, Float[samples]


@dataclass(frozen=True)
class Rows:
    """Residual outputs and their derivatives: `values` (samples, outputs), `jacobian` (samples, outputs, columns)."""

    values: Float
    jacobian: Float


class Interpreter:
    """Evaluator of lowered graphs and linearizations; `widths[axis]` is the smoothing of the lookups of an axis."""

    def __init__(self, lowered: LoweredGraph, parameters: ParameterSet, widths: Sequence[float] = ()) -> None:
        self.axes = lowered.axes
        self.parameters = parameters
        self.moving = {key: free.axis.breakpoints for key, free in free_axes(parameters).items()}
        self.widths = tuple(widths) or (0.0,) * len(lowered.axes)

    def run(
        self,
        nodes: Sequence[Node],
        states: Sequence[State],
        columns: Mapping[str, Float],
        starts: Sequence[int] = (0,),
        firsts: Sequence[int] | None = None,
    ) -> Evaluation:
        """Compute the values of all nodes over columns, Float[samples]. `firsts` are nodes of first values, if known.

        Pieces of the data that begin at different `starts` do not depend on each other and are computed side by side.
        """
        samples = next((c.size for c in columns.values()), 1)
        if not states:
            return [np.broadcast_to(v, samples) for v in self._step(nodes, columns, ())]
        begins, lengths = _longest_first(starts, samples)
        result = np.empty((len(nodes), samples))
        memory: list[list[Float]] = []  # of each state a ring of as many arrays as its latency, Float[pieces]
        for k in range(max(lengths, default=0)):
            here = begins[lengths > k] + k  # pieces that have ended are the last ones
            now = {name: column[here] for name, column in columns.items()}
            if k == 0:
                memory = self._start(nodes, states, now, firsts)
            values = self._step(nodes, now, [ring[0][: here.size] for ring in memory])
            for row, value in zip(result, values, strict=True):
                row[here] = value
            for ring, state in zip(memory, states, strict=True):
                # the value that the state has in `latency` steps
                ring.append(result[state.next, here])
                del ring[0]
        return list(result)

    def _start(
        self, nodes: Sequence[Node], states: Sequence[State], here: Mapping[str, Float], firsts: Sequence[int] | None
    ) -> list[list[Float]]:
        """Return the contents of the states before the first sample; a state may start from others."""
        # nodes of first values read no states, see `Linearization.starts`
        if firsts is not None:
            values = self._step(nodes, here, [np.array([np.nan])] * len(states))
            current = [values[at] for at in firsts]
        else:
            order = _first_nodes(nodes, states)
            current = self._settle(nodes, states, here) if order is None else self._first(nodes, states, here, order)
        pieces = next((column.size for column in here.values()), 1)
        return [[np.broadcast_to(value, pieces)] * state.latency for value, state in zip(current, states, strict=True)]

    def _first(
        self, nodes: Sequence[Node], states: Sequence[State], here: Mapping[str, Float], order: Sequence[int]
    ) -> list[Float]:
        """Compute the first values; each node they need is computed once, in this order."""
        values: dict[int, Float] = {}
        for at in order:
            node = nodes[at]
            if node.op == "state":
                values[at] = values[states[node.payload].init]
            else:
                values[at] = self._node(node, [values[a] for a in node.args], here, ())
        return [values[state.init] for state in states]

    def _settle(self, nodes: Sequence[Node], states: Sequence[State], here: Mapping[str, Float]) -> list[Float]:
        """Compute first values that depend on each other: sweep from NaN until nothing changes."""
        current = [np.array([np.nan])] * len(states)
        for _ in states:
            values = self._step(nodes, here, current)
            before, current = current, [values[state.init] for state in states]
            if all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, current, strict=True)):
                break
        return current

    def _step(self, nodes: Sequence[Node], columns: Mapping[str, Float], memory: Sequence[Float]) -> list[Float]:
        values: list[Float] = []
        for node in nodes:
            values.append(self._node(node, [values[a] for a in node.args], columns, memory))
        return values

    def _node(self, node: Node, args: list[Float], columns: Mapping[str, Float], memory: Sequence[Float]) -> Float:
        op, _, payload = node
        match op:
            case "const":
                return np.array([payload])
            case "input":
                return columns[payload]
            case "state":
                held: Float = memory[payload]
                return held
            case "position":
                return position(args[0], self._points(payload), payload.extrapolation)
            case "density":
                return density(args[0], self._points(payload), payload.extrapolation)
            case "interpolate":
                return interpolate(self.parameters[payload.name].values, [w for w, _ in self._sides(payload, args)])
            case "slope":
                table, axis = payload
                sides = [s if i == axis else w for i, (w, s) in enumerate(self._sides(table, args))]
                return interpolate(self.parameters[table.name].values, sides)
            case "expansion":
                return self._rbf(payload).expansion.without_hinges(_points(args))
            case "expansion_slope":
                ref, axis = payload
                along: Float = self._rbf(ref).expansion.without_hinges.gradient(_points(args))[:, axis]
                return along
            case "external":
                return evaluate_points(payload.function, _points(args))[0][:, payload.number]
            case "external_slope":
                output, axis = payload
                return evaluate_points(output.function, _points(args))[1][:, output.number, axis]
            case "dense":
                return self._layer(payload.layer, args)[0][:, payload.number]
            case "dense_slope":
                output, axis = payload
                slopes = self._layer(output.layer, args)[1][:, output.number]
                return slopes * float(self.parameters[output.name].values[axis, output.number])
            case "dense_pull":
                layer, axis = payload
                slopes, adjoints = self._layer(layer, args)[1], _points(args[layer.inputs :])
                shares = np.where(adjoints == 0, 0.0, adjoints * slopes)
                pulled: Float = shares @ self.parameters[layer.name].values[axis]
                return pulled
            case _:
                result: Float = OPERATIONS[op].evaluate(*args)
                return result

    def _rbf(self, ref: ExpansionRef) -> RBF:
        parameter = self.parameters[ref.name]
        assert isinstance(parameter, RBF)
        return parameter

    def _layer(self, layer: DenseLayer, args: Sequence[Float]) -> tuple[Float, Float]:
        return evaluate_layer(layer, self.parameters[layer.name].values, _points(args)[:, : layer.inputs])

    def _points(self, axis: AxisRef) -> Float:
        return self.axes[axis.number] if axis.key is None else self.moving.get(axis.key, self.axes[axis.number])

    def _sides(self, table: TableRef, args: Sequence[Float]) -> list[tuple[Float, Float]]:
        shape = self.parameters[table.name].values.shape
        length = max((a.size for a in args), default=1)
        sides = []
        for place, axis, smoothed, count in zip(args, table.axes, table.smoothed, shape, strict=True):
            x = np.broadcast_to(place, length)
            points, width = self.axes[axis.number], self.widths[axis.number]
            sides.append(smooth_weights(x, points, axis.extrapolation, width) if smoothed else cell_weights(x, count))
        return sides

    def rows(
        self,
        line: Linearization,
        offsets: Mapping[str | AxisKey, int],
        columns: Mapping[str, Float],
        starts: Sequence[int] = (0,),
    ) -> Rows:
        """Compute outputs and their derivatives with respect to all values, by forward sensitivities.

        S[k+1] = A[k] S[k] + B[k],  J[k] = C[k] S[k] + D[k], with the derivatives A, B of the next states and C, D of
        the outputs with respect to states and values.

        `offsets` gives the first column of each free parameter and axis; its values follow in C order.
        """
        samples = next(c.size for c in columns.values())
        run = self.run(line.nodes, line.states, columns, starts, line.starts)
        width = sum(self.parameters[n].size if isinstance(n, str) else self.moving[n].size for n in offsets)
        # dense over all columns: the reference is simple rather than fast
        weights = {at: self._atom(at, line.nodes, run, offsets, width) for at in {*line.atoms, *line.start_atoms}}
        jacobian = np.zeros((samples, len(line.outputs), width))
        memory: list[list[Float]] = []
        for k in range(samples):
            if k in starts:
                first = [self._row(slopes, {}, weights, k, width) for slopes in _slopes(line.start_slopes, run, k)]
                memory = [[f] * line.states[i].latency for f, i in zip(first, line.carried, strict=True)]
            now = dict(zip(line.seeds, (ring[0] for ring in memory), strict=True))
            sensitivity_rows = [self._row(slopes, now, weights, k, width) for slopes in _slopes(line.slopes, run, k)]
            jacobian[k] = sensitivity_rows[: len(line.outputs)]
            for ring, row in zip(memory, sensitivity_rows[len(line.outputs) :], strict=True):
                ring.append(row)
                del ring[0]
        return Rows(np.stack([run[at] for at in line.outputs], axis=1), jacobian)

    def _atom(
        self, at: int, nodes: Sequence[Node], run: Evaluation, offsets: Mapping[str | AxisKey, int], width: int
    ) -> Float:
        """Compute the weights of one lookup or position over all columns, shape (samples, columns)."""
        node = nodes[at]
        if node.op == "position":
            first = offsets[node.payload.key]
            weights = cell_weights(run[at], self._points(node.payload).size)[0]
        elif node.op == "expansion":
            first = offsets[node.payload.name]
            weights = self._rbf(node.payload).value_slopes(_points([run[a] for a in node.args]))
        elif node.op == "dense":
            layer, number = node.payload
            first, args = offsets[layer.name], [run[a] for a in node.args]
            weights = np.zeros((len(run[0]), *layer.shape))
            # dy_i/dw_ji = a'(z_i) x_j, with x = 1 for the bias
            weights[:, :-1, number], weights[:, -1, number] = _points(args), 1.0
            weights[:, :, number] *= self._layer(layer, args)[1][:, number, None]
            weights = weights.reshape(len(weights), -1)
        else:
            first, shape = offsets[node.payload.name], self.parameters[node.payload.name].values.shape
            weights = table_weights([w for w, _ in self._sides(node.payload, [run[a] for a in node.args])], shape)
        spread = np.zeros((len(run[0]), width))
        spread[:, first : first + weights.shape[1]] = weights
        return spread

    @staticmethod
    def _row(
        slopes: Mapping[int, float], now: Mapping[int, Float], weights: Mapping[int, Float], k: int, width: int
    ) -> Float:
        row = np.zeros(width)
        for leaf, slope in slopes.items():
            if slope != 0:
                row += slope * (now[leaf] if leaf in now else weights[leaf][k])
        return row


def _longest_first(starts: Sequence[int], samples: int) -> tuple[Int, Int]:
    """Return where the pieces of the samples begin and how long they are, longest first."""
    begins = np.unique((0, *starts))
    begins = begins[begins < samples]
    lengths = np.diff(begins, append=samples)
    order = np.argsort(-lengths, kind="stable")
    return begins[order], lengths[order]


def _first_nodes(nodes: Sequence[Node], states: Sequence[State]) -> list[int] | None:
    """Return the nodes that first values need, each after those it reads; None if a first value depends on itself."""
    order: list[int] = []
    done: set[int] = set()
    entered: set[int] = set()  # and not left yet
    stack = [state.init for state in states]
    while stack:
        at = stack[-1]
        if at in done or at in entered:
            # the second visit of an entered node: all that it reads is done
            stack.pop()
            if at in entered:
                entered.remove(at)
                done.add(at)
                order.append(at)
            continue
        entered.add(at)
        # at the first sample, the read of a state is its first value
        read = (states[nodes[at].payload].init,) if nodes[at].op == "state" else nodes[at].args
        # a node that is still being computed: a loop
        if not entered.isdisjoint(read):
            return None
        stack.extend(a for a in read if a not in done)
    return order


def _points(coordinates: Sequence[Float]) -> Float:
    """Stack the coordinates, Float[samples, inputs]."""
    return np.stack(np.broadcast_arrays(*coordinates), axis=-1)


def _slopes(slopes: Slopes, run: Evaluation, k: int) -> list[Mapping[int, float]]:
    """Return the derivatives of each row at sample k, by atom or state."""
    if isinstance(slopes, Written):
        return [{leaf: float(run[at][k]) for leaf, at in row.items()} for row in slopes.rows]
    return [slopes.of_row(row, lambda node: float(run[node][k])) for row in range(len(slopes.roots))]
