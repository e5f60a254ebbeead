"""Lowering of lookups for a given set of parameters: search each axis once, then interpolate.

Axes with equal breakpoints are merged, so tables over the same axes share their searches.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.free_axes import AxisKey, free_axes, key_of
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Extrapolation, Parameter
from kennfeld.domain.rbf import RBF, Hinge, Kernel
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Graph, Node
from kennfeld.graph.stable_forms import rebuild
from kennfeld.graph.traversal import dependents, rewrite

Free = Collection[str | AxisKey]  # parameters and axes whose values are fitted


class AxisRef(NamedTuple):
    """An axis of the lowered graph and its extrapolation; `key` identifies it if its breakpoints are free."""

    number: int
    extrapolation: Extrapolation
    key: AxisKey | None = None


class TableRef(NamedTuple):
    """A table, its axes, and a flag for each axis that is smoothed."""

    name: str
    axes: tuple[AxisRef, ...]
    smoothed: tuple[bool, ...]


class ExpansionRef(NamedTuple):
    """A parameter of kind rbf, with its numbers of inputs and centres, and its kernel."""

    name: str
    inputs: int
    centres: int
    kernel: Kernel = "gaussian"


@dataclass(frozen=True)
class LoweredGraph:
    """A graph whose lookups are `position` and `interpolate` nodes, and the breakpoints of its axes.

    Breakpoints that are free are values like those of the tables; `axes` holds their start.
    """

    graph: Graph
    axes: tuple[Float, ...]
    shapes: Mapping[str, tuple[int, ...]]


def lower_lookups(graph: Graph, parameters: ParameterSet, smooth: Collection[str] = ()) -> LoweredGraph:
    """Lower the lookups of a graph onto the axes of `parameters`, and write logarithms in stable forms.

    Axes whose coordinate depends on one of the parameters `smooth` directly, not through a state, are smoothed: their
    lookups take the coordinate itself. Free axes are not smoothed.

    Raises:
        ArgumentError: a parameter is missing, or a table has another number of axes than coordinates in the graph.
    """
    _check(graph, parameters)
    axes: dict[bytes | AxisKey, int] = {}
    kept: list[Float] = []
    movable = free_axes(parameters)

    def axis_ref(parameter: Parameter, which: int) -> AxisRef:
        points = parameter.index_axes[which].breakpoints
        key = key_of(parameter, which) if parameter.axes else None
        key = key if key in movable else None
        # equal bytes are one axis; breakpoints that are fitted may part, so those have their key
        number = axes.setdefault(key or points.tobytes(), len(kept))
        if number == len(kept):
            kept.append(points)
        return AxisRef(number, parameter.extrapolation, key)

    moving = dependents(graph, lambda node: node.parameter in smooth, through_states=False)

    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        op, old, payload = graph.nodes[at]
        if op != "lookup":
            return rebuild(b, graph.nodes[at], args)
        parameter = parameters[payload]
        if isinstance(parameter, RBF):
            ref = ExpansionRef(payload, parameter.coordinates, parameter.centres, parameter.kernel)
            return _with_hinges(b, b.node("expansion", args, ref), parameter.hinges, args)
        refs = tuple(axis_ref(parameter, i) for i in range(len(args)))
        smoothed = tuple(
            a in moving and ref.key is None and kept[ref.number].size > 1 for a, ref in zip(old, refs, strict=True)
        )
        places = tuple(
            x if soft else b.node("position", (x,), ref) for x, ref, soft in zip(args, refs, smoothed, strict=True)
        )
        return b.node("interpolate", places, TableRef(payload, refs, smoothed))

    shapes = {name: parameters[name].values.shape for name in graph.parameters}
    return LoweredGraph(rewrite(graph, resolve), tuple(kept), FrozenDict(shapes))


def _with_hinges(b: GraphBuilder, y: int, hinges: Sequence[Hinge], args: tuple[int, ...]) -> int:
    """Return the value of an expansion with hinges, given that of its plane and bells."""
    for along, position, height in hinges:
        beyond = b.call("max", b.call("sub", args[along], b.const(position)), b.const(0.0))
        y = b.call("add", y, b.call("mul", b.const(height), beyond))
    return y


def _check(graph: Graph, parameters: ParameterSet) -> None:
    for layer in dict.fromkeys(n.payload.layer for n in graph.nodes if n.op == "dense"):
        if layer.name not in parameters:
            raise ArgumentError(f"the model has a layer {layer.name}, whose weights are not in the parameter set")
        shape = parameters[layer.name].values.shape
        if shape != layer.shape:
            raise ArgumentError(f"the weights of layer {layer.name} must have shape {layer.shape}, got {shape}")
    for name, count in dict.fromkeys((n.payload, len(n.args)) for n in graph.nodes if n.op == "lookup"):
        if name not in parameters:
            raise ArgumentError(f"the model looks up {name}, which is not in the parameter set")
        expected = parameters[name].coordinates
        if expected != count:
            has = "inputs" if isinstance(parameters[name], RBF) else "axes"
            raise ArgumentError(f"the model looks up {name} with {count} coordinates, but it has {expected} {has}")


def is_atom(node: Node, free: Free) -> bool:
    """Return True if free values enter a step at this node: values of a table, or breakpoints of an axis.

    >>> is_atom(Node("position", (0,), AxisRef(0, "clip", AxisKey("AxisSpeed"))), [AxisKey("AxisSpeed")])
    True
    """
    if node.op == "position":
        return node.payload.key is not None and node.payload.key in free
    return node.op in ("interpolate", "expansion", "dense") and node.payload.name in free
