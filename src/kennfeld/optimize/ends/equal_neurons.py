"""Neurons that no descent can tell apart: their weights are equal, those by which other neurons use them, too.

All derivatives with respect to such weights are equal, so that they stay equal but for rounding errors: the network
fits no better than one with a single neuron in their place. Neurons whose weights have opposite signs are alike in the
same way if the activation is odd.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.dense_layer import DenseLayer

TOLERANCE = 1e-7  # relative to the largest weight
REMEDY = "Start from trained weights, or from random ones in an initial file."

_Neuron = tuple[DenseLayer, int]


def equal_neurons(graph: Graph, parameters: ParameterSet) -> dict[str, tuple[int, int]]:
    """Return for each layer that may change how many of its neurons equal another one, and how many it has.

    Outputs of the network, and neurons that other nodes than layers use, do not count.
    """
    if not graph.layers:
        return {}
    counts = {}
    for layer, following in _following_layers(graph).items():
        block = parameters[layer.name]
        if block.locked.all():
            continue
        neurons = sorted({number for number, _, _ in following})
        columns = [block.values[:, neurons]]
        for name in dict.fromkeys(name for _, name, _ in following):
            rows = {number: row for number, other, row in following if other == name}
            weights = np.zeros((len(neurons), parameters[name].values.shape[1]))  # 0 from neurons that it does not use
            for at, number in enumerate(neurons):
                if number in rows:
                    weights[at] = parameters[name].values[rows[number]]
            columns.append(weights.T)
        if count := _count_equal(np.vstack(columns).T, odd=layer.activation in ("tanh", "identity")):
            counts[layer.name] = count, layer.outputs
    return counts


def find_equal_neurons(graph: Graph, start: ParameterSet, end: ParameterSet) -> Iterator[Finding]:
    """Yield a warning for each layer with equal neurons at the start of a fit.

    A search leaves a start at which all weights are 0 by itself, so that it must still have equal neurons at the end.
    """
    before = equal_neurons(graph, start)
    after = equal_neurons(graph, end) if before else {}
    for name in before:
        if start[name].values.any() or name in after:
            yield Finding(Location(), describe(name, before), REMEDY, severity="warning")


def describe(name: str, counts: Mapping[str, tuple[int, int]]) -> str:
    """Say how many neurons of a layer start with equal weights."""
    equal, neurons = counts[name]
    return (
        f"{equal} of {neurons} neurons of {name} start with equal weights: their derivatives are equal, so that only "
        "rounding errors can make them differ"
    )


def _following_layers(graph: Graph) -> dict[DenseLayer, set[tuple[int, str, int]]]:
    """Return for each layer the rows of other layers that use its neurons: number, name of the other layer, row.

    Nodes between two layers, such as those of an activation, count if they depend on one neuron only.
    """
    neurons: list[_Neuron | None] = []
    following: dict[DenseLayer, set[tuple[int, str, int]]] = {}
    for node in graph.nodes:
        sources = {neurons[at] for at in node.args if graph.nodes[at].op != "const"}
        if node.op == "dense":
            neurons.append((node.payload.layer, node.payload.number))
            for row, at in enumerate(node.args):
                if (source := neurons[at]) is not None:
                    following.setdefault(source[0], set()).add((source[1], node.payload.name, row))
        else:
            # functions of one neuron stand for it, those of several for none
            neurons.append(sources.pop() if len(sources) == 1 else None)
    return following


def _count_equal(neurons: Float, *, odd: bool) -> int:
    """Count the rows that equal another one, or its negative if `odd`.

    >>> _count_equal(np.array([[1.0, 2.0], [0.5, 2.0], [-1.0, -2.0]]), odd=True)
    2
    """
    # equal rows are neighbours in the order of their products with a random vector
    product = neurons @ np.random.default_rng(0).standard_normal(neurons.shape[1])
    if odd:
        # of a neuron and its negative, both get the sign with which the product is positive
        neurons, product = neurons * np.where(product < 0, -1.0, 1.0)[:, None], np.abs(product)
    ordered = neurons[np.argsort(product, kind="stable")]
    same = np.abs(np.diff(ordered, axis=0)).max(axis=1, initial=0.0) <= TOLERANCE * np.abs(neurons).max(initial=0.0)
    marks = np.zeros(len(neurons), dtype=bool)
    marks[:-1] |= same
    marks[1:] |= same
    return int(np.count_nonzero(marks))
