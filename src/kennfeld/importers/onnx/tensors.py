"""Tensors of a network as it is written into a graph: constants, or arrays of nodes."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.onnx.network import Array
from kennfeld.models.imperative.node_arrays import Nodes, elementwise

MAX_ELEMENTS = 1_000_000  # of a tensor
MAX_NODES = 250_000  # of the graph
MAX_COMPUTED = 4 * MAX_NODES  # elements that depend on the inputs; equal ones share a node, but take their time
MAX_FOLDED = 8 * MAX_ELEMENTS  # elements of constants


class UnsupportedOperatorError(Exception):
    """An operator cannot be computed; the text says why."""


class NodeTensor(NamedTuple):
    """A tensor that depends on the inputs; `kind` is "float", "int" or "bool"."""

    nodes: Nodes
    kind: str = "float"


Tensor: TypeAlias = Array | NodeTensor


def shape_of(tensor: Tensor) -> tuple[int, ...]:
    """Return the dimensions of a tensor."""
    return tensor.nodes.shape if isinstance(tensor, NodeTensor) else tensor.shape


def kind_of(tensor: Tensor) -> str:
    """Return the kind of the elements."""
    if isinstance(tensor, NodeTensor):
        return tensor.kind
    return {"f": "float", "b": "bool"}.get(tensor.dtype.kind, "int")


def constant(tensor: Tensor | None, argument: str) -> Array:
    """Return a tensor that must be constant."""
    if tensor is None or isinstance(tensor, NodeTensor):
        raise UnsupportedOperatorError(f"its argument {argument} depends on the inputs")
    return tensor


def check_size(shape: Sequence[int]) -> None:
    """Raise `UnsupportedOperatorError` if a tensor would be too large."""
    if np.prod([float(size) for size in shape]) > MAX_ELEMENTS:
        size = "x".join(map(str, shape))
        raise UnsupportedOperatorError(f"it creates a tensor of {size} elements; the maximum is {MAX_ELEMENTS}")


def nodes_of(builder: GraphBuilder, tensor: Tensor) -> Nodes:
    """Return the nodes of a tensor, in its shape; constants become nodes."""
    if isinstance(tensor, NodeTensor):
        return tensor.nodes
    numbers = np.asarray(tensor, dtype=np.float64)
    # equal numbers share a node, which is looked up once
    values, places = np.unique(numbers, return_inverse=True)
    nodes = np.array([builder.const(float(value)) for value in values], dtype=np.int64)
    return nodes[places].reshape(numbers.shape) if nodes.size else np.zeros(numbers.shape, dtype=np.int64)


def rearrange(change: Callable[[Array], Array], tensor: Tensor) -> Tensor:
    """Apply a function that only moves, repeats or selects elements."""
    if isinstance(tensor, NodeTensor):
        return NodeTensor(np.asarray(change(tensor.nodes), dtype=np.int64), tensor.kind)
    return np.asarray(change(tensor))


class Arithmetic:
    """Elementwise operations on tensors with the broadcasting of numpy: `apply("mul", x, 2.0)`."""

    def __init__(self, builder: GraphBuilder) -> None:
        self.builder = builder
        self._computed = self._folded = 0  # elements

    def __call__(self, op: str, *args: Tensor | float) -> Tensor:
        tensors = [np.asarray(arg, dtype=np.float64) if isinstance(arg, float | int) else arg for arg in args]
        shape = np.broadcast_shapes(*(shape_of(tensor) for tensor in tensors))
        check_size(shape)
        depends = any(isinstance(tensor, NodeTensor) for tensor in tensors)
        self._count(int(np.prod(shape)), depends)
        spread = [np.broadcast_to(nodes_of(self.builder, tensor), shape) for tensor in tensors]
        # the builder computes operations of constants at once, so that their nodes hold the results
        nodes = elementwise(self.builder, op, *spread) if np.prod(shape) else np.zeros(shape, dtype=np.int64)
        self._check_nodes()
        if depends:
            return NodeTensor(nodes)
        values = [self.builder.nodes[int(node)].payload for node in nodes.ravel()]
        return np.array(values, dtype=np.float64).reshape(shape)

    def _count(self, size: int, depends: bool) -> None:
        """Raise `UnsupportedOperatorError` if all operations together are too many, whether or not they are equal."""
        self._check_nodes()  # of an operator before this one
        if depends:
            self._computed += size
        else:
            self._folded += size
        if self._computed > MAX_COMPUTED:
            raise UnsupportedOperatorError(f"the network computes more than {MAX_COMPUTED} elements")
        if self._folded > MAX_FOLDED:
            raise UnsupportedOperatorError(f"the network computes more than {MAX_FOLDED} elements of constants")

    def _check_nodes(self) -> None:
        if len(self.builder.nodes) > MAX_NODES:
            raise UnsupportedOperatorError(f"the network requires more than {MAX_NODES} operations per step")

    def fold(self, op: str, tensors: Sequence[Tensor]) -> Tensor:
        """Combine tensors from first to last."""
        result = tensors[0]
        for tensor in tensors[1:]:
            result = self(op, result, tensor)
        return result

    def reduce(self, op: str, tensor: Tensor, axes: Sequence[int]) -> Tensor:
        """Combine the elements along axes, which become 1 long."""
        for axis in axes:
            parts = [
                rearrange(lambda array, i=i, axis=axis: np.take(array, [i], axis), tensor)  # type: ignore[misc]
                for i in range(shape_of(tensor)[axis])
            ]
            if not parts:
                raise UnsupportedOperatorError("it reduces an empty tensor")
            tensor = self.fold(op, parts)
        return tensor
