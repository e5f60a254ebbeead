"""Registry of operators, and what their rules work with."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.parameters import Block
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.dense_layer import DenseLayer
from kennfeld.importers.onnx.element_types import with_declared_kinds
from kennfeld.importers.onnx.network import Network, Operator
from kennfeld.importers.onnx.tensors import Arithmetic, NodeTensor, Tensor, UnsupportedOperatorError, nodes_of
from kennfeld.models.imperative.node_arrays import Nodes

Arguments = Sequence[Tensor | None]
Rule = Callable[["Context", Operator, Arguments], Tensor | Sequence[Tensor] | None]

MAX_PRODUCTS = 20_000_000  # of all layers

RULES: dict[tuple[str, str], Rule] = {}  # by domain and kind


def operator(*kinds: str, domain: str = "") -> Callable[[Rule], Rule]:
    """Register the rule of operators. It returns the first outputs, or None if it has set them."""

    def register(rule: Rule) -> Rule:
        RULES.update({(domain, kind): rule for kind in kinds})
        return rule

    return register


class Context:
    """A network that is being written into a graph.

    Attributes:
        builder: builder of the graph.
        apply: elementwise operations.
        tensors: tensors computed so far, by name.
        layers: weights of dense layers, by the name of their parameter.
        absorbed: first outputs of operators that are part of a layer.
        remarks: what is computed differently.
    """

    def __init__(self, network: Network, builder: GraphBuilder, prefix: str) -> None:
        self.network, self.builder, self._prefix = network, builder, prefix
        self.apply = Arithmetic(builder)
        self.tensors: dict[str, Tensor] = dict(network.constants)
        self.layers: dict[str, Block] = {}
        self.absorbed: set[str] = set()
        self.remarks: list[str] = []
        self._names: dict[bytes, str] = {}  # of layers, by their weights
        self._consumers = _consumers(network)
        self._products = 0

    def remark(self, text: str) -> None:
        """Note what is computed differently from other programs."""
        if text not in self.remarks:
            self.remarks.append(text)

    def compute(self, op: Operator, arguments: Arguments) -> None:
        """Set the outputs of an operator."""
        outputs = RULES[op.domain, op.kind](self, op, arguments)
        if outputs is not None:
            results = [outputs] if isinstance(outputs, NodeTensor | np.ndarray | np.generic) else outputs
            tensors = [result if isinstance(result, NodeTensor) else np.asarray(result) for result in results]
            # an operator may leave out its last outputs
            self.tensors.update(zip(op.outputs, with_declared_kinds(op, tensors, arguments), strict=False))

    def run(self, body: Network, arguments: Sequence[Tensor]) -> list[Tensor]:
        """Compute the outputs of a graph within an operator."""
        inner = Context(body, self.builder, self._prefix)
        # shared, so that names of layers are counted through and passes of a loop share their weights
        inner.layers, inner.remarks, inner._names = self.layers, self.remarks, self._names
        inner._products, inner.apply = self._products, self.apply
        inner.tensors.update(zip((port.name for port in body.inputs), arguments, strict=True))
        for op in body.used_operators:
            if (op.domain, op.kind) not in RULES:
                raise UnsupportedOperatorError(f"operator {op.label} within it is not supported")
            if op.outputs[0] not in inner.absorbed:
                inner.compute(op, [inner.within(name) if name else None for name in op.inputs])
        self._products = inner._products
        return [inner.within(port.name) for port in body.outputs]

    def within(self, name: str) -> Tensor:
        """Return a tensor that a graph within an operator must compute itself."""
        if name not in self.tensors:
            raise UnsupportedOperatorError(f"the graph within it uses {name!r}, which it does not compute")
        return self.tensors[name]

    def sole_consumer(self, name: str) -> Operator | None:
        """Return the operator that alone uses a tensor; None if there are several, or if it is an output."""
        return self._consumers.get(name)

    def dense(self, rows: Nodes, weights: Float, activation: str = "identity", alpha: float = 0.0) -> Nodes:
        """Apply a layer to each row: [rows, inputs] -> [rows, outputs].

        `weights` have a row per input, then the biases; [inputs + 1, outputs].
        """
        # equal weights are one parameter: the passes of a loop or steps of a sequence share theirs
        content = np.array(weights.shape).tobytes() + weights.tobytes()
        name = self._names.setdefault(content, f"{self._prefix}layer{len(self._names) + 1}")
        inputs, outputs = weights.shape[0] - 1, weights.shape[1]
        self._products += len(rows) * inputs * outputs
        if self._products > MAX_PRODUCTS:
            raise UnsupportedOperatorError(f"the layers take more than {MAX_PRODUCTS} multiplications per step")
        if name not in self.layers:
            description = f"Weights of {inputs} inputs, then the biases, along x; the outputs along y."
            self.layers[name] = Block(name, weights, description=description, locked=True)
        layer = DenseLayer(name, inputs, outputs, activation, alpha)
        nodes = [self.builder.dense(layer, *map(int, row)) for row in rows]
        return np.array(nodes, dtype=np.int64).reshape(len(rows), outputs)

    def nodes(self, tensor: Tensor) -> Nodes:
        """Return the nodes of a tensor."""
        return nodes_of(self.builder, tensor)

    def where(self, condition: Tensor, a: Tensor | float, b: Tensor | float) -> Tensor:
        """Select elements."""
        return self.apply("select", condition, a, b)

    def truth(self, op: str, *args: Tensor | float) -> Tensor:
        """Apply a comparison or logical operation."""
        result = self.apply(op, *args)
        return NodeTensor(result.nodes, "bool") if isinstance(result, NodeTensor) else result != 0


def _consumers(network: Network) -> Mapping[str, Operator]:
    counts = Counter(name for operator in network.used_operators for name in operator.inputs)
    # an output of the network has a user more, so that no layer absorbs what follows it
    counts.update(port.name for port in network.outputs)
    users = {name: operator for operator in network.used_operators for name in operator.inputs}
    return {name: user for name, user in users.items() if counts[name] == 1}
