"""Writes a network into a graph, operator by operator, and collects all that is not supported."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.onnx import (  # noqa: F401
    convolutions,
    einsum,
    elementwise,
    layers,
    linear_models,
    loops,
    normalization,
    quantization,
    recurrent,
    reductions,
    scores,
    selection,
    shapes,
    support_vectors,
    tree_operators,
)
from kennfeld.importers.onnx.network import Network, Operator
from kennfeld.importers.onnx.registry import RULES, Context
from kennfeld.importers.onnx.tensors import NodeTensor, Tensor, UnsupportedOperatorError, nodes_of, shape_of
from kennfeld.models.imperative.evaluation_errors import EvaluationError

_REMEDY = "Export this part of the network with other operators, see docs/functions.md."


def is_supported(domain: str, kind: str) -> bool:
    """Return True if there is a rule for an operator."""
    return (domain, kind) in RULES


def unsupported(network: Network) -> list[Finding]:
    """List an error for each kind of operator that is not supported."""
    counts = Counter(op.label for op in network.used_operators if (op.domain, op.kind) not in RULES)
    location = Location.of_file(network.file)
    return [
        Finding(location, f"operator {kind} is not supported" + (f" ({count} times)" if count > 1 else ""), _REMEDY)
        for kind, count in counts.items()
    ]


def write_network(network: Network, builder: GraphBuilder, arguments: Sequence[int], prefix: str) -> Context:
    """Write a network into a graph.

    Args:
        network: the network.
        builder: builder of the graph.
        arguments: nodes of the elements of the inputs, one input after the other.
        prefix: precedes the names of the layers.

    Raises:
        InputError: operators, or ways in which they are used, are not supported; names all of them.
    """
    findings = unsupported(network)
    context = Context(network, builder, prefix)
    rest = list(arguments)
    for port in network.inputs:
        own, rest = rest[: len(port.labels)], rest[len(port.labels) :]
        kind = "bool" if port.kind == "bool" else "float" if "float" in port.kind else "int"
        context.tensors[port.name] = NodeTensor(np.array(own, dtype=np.int64).reshape(port.shape or ()), kind)
    for op in network.used_operators:
        # a layer has already computed the bias or activation that it absorbed
        if (op.domain, op.kind) in RULES and op.outputs[0] not in context.absorbed:
            findings += _apply(context, op)
    if findings:
        raise InputError(findings)
    return context


def _apply(context: Context, op: Operator) -> list[Finding]:
    """Compute the outputs of an operator; do nothing if an operator before it failed."""
    arguments: list[Tensor | None] = []
    for name in op.inputs:
        if name and name not in context.tensors:
            return []
        arguments.append(context.tensors[name] if name else None)
    try:
        context.compute(op, arguments)
    except (UnsupportedOperatorError, EvaluationError) as error:
        return [Finding(_location(context, op), str(error), _REMEDY)]
    # rules trust shapes and attributes; in a damaged file, those that do not fit show in numpy or in the rule itself
    except (ValueError, IndexError, TypeError, KeyError, AttributeError, AssertionError, OverflowError, MemoryError):
        message = "its arguments or attributes do not fit together"
        return [Finding(_location(context, op), message, "Export the network again.")]
    return []


def _location(context: Context, op: Operator) -> Location:
    return Location.of_file(context.network.file).within(f"{op.label} {op.name}".strip())


def output_nodes(context: Context) -> list[int]:
    """Collect the nodes of the elements of the outputs that are numbers, one output after the other.

    Raises:
        InputError: an output is not computed.
    """
    nodes: list[int] = []
    for port in context.network.number_outputs:
        tensor = context.tensors.get(port.name)
        if tensor is None:
            location = Location.of_file(context.network.file).within(port.name)
            raise InputError.of(location, "no operator computes this output", "Export the network again.")
        nodes += map(int, nodes_of(context.builder, tensor).ravel())
    return nodes


def output_labels(context: Context) -> list[str]:
    """Name the elements of the outputs, by the shapes that they have after the computation."""
    ports = [replace(port, shape=shape_of(context.tensors[port.name])) for port in context.network.number_outputs]
    return [label for port in ports for label in port.labels]
