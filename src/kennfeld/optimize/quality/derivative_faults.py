"""The first sample at which a derivative of the model is not finite, and the node to which it belongs."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.adjoints import AdjointProgram
from kennfeld.graph.derivative import Linearization, differentiate
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.graph.node import Graph, extract
from kennfeld.graph.traversal import ancestors
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator


class DerivativeFault(NamedTuple):
    """A derivative that is not finite: its node, the number of its dataset, and of the sample there, from 0."""

    node: str
    dataset: int
    sample: int


def describe_derivative_fault(problem: Problem, parameters: ParameterSet) -> str:
    """Return a sentence on the first sample with a derivative that is not finite; empty if there is none.

    Args:
        problem: the problem, whose derivatives are those of its criteria with respect to the free values.
        parameters: the values at which they are computed.
    """
    partitions = problem.partitions
    if partitions is None:
        places: Iterable[list[tuple[str, int]]] = [[(bound.dataset.name, 0) for bound in problem.training]]
    else:
        places = partitions.places
    for own, fault in zip(places, problem.each(find_derivative_fault, parameters), strict=True):
        if fault is not None:
            name, first = own[fault.dataset]
            return f"The derivative of {fault.node} is not finite at sample {first + fault.sample + 1} of {name}."
    return ""


def find_derivative_fault(problem: Problem, parameters: ParameterSet) -> DerivativeFault | None:
    """Return the first derivative that is not finite; None if there is none. For arguments see above."""
    lowered = lower_lookups(problem.graph, parameters)
    outputs = [lowered.graph.names[name] for name in problem.differences]
    line = differentiate(lowered.graph, outputs, (*problem.free_names, *problem.free_axes))
    # nodes of derivatives have higher numbers the later they are computed
    slopes = sorted(_slopes(line))
    nodes = _simulator(lowered, line, slopes, parameters)
    for number, bound in enumerate(problem.training):
        for at, values in nodes.blocks(bound, parameters):
            broken = ~np.isfinite(values)
            if not broken.any():
                continue
            column = int(np.argmax(broken.any(axis=0)))
            sample = at.start + column
            # at the first sample, the first node on the way to the derivative that is not finite is the cause
            causes = _derived(lowered.graph, line, slopes[int(np.argmax(broken[:, column]))])
            present = _simulator(lowered, line, causes, parameters).at(bound, sample, parameters)
            name = _name_of(lowered.graph, line, causes[int(np.argmax(~np.isfinite(present)))])
            return DerivativeFault(name, number, int(bound.kept[sample]))
    return None


def _slopes(line: Linearization) -> set[int]:
    """Return the nodes that are derivatives, or the factors of which they are products."""
    if isinstance(line.slopes, AdjointProgram):
        return {pull.factor for pull in line.slopes.pulls}
    return {at for row in line.slopes.rows for at in row.values()}


def _simulator(
    lowered: LoweredGraph, line: Linearization, nodes: Sequence[int], parameters: ParameterSet
) -> NodeSimulator:
    names = {f"derivative {number}": at for number, at in enumerate(nodes)}
    graph = extract(line.nodes, line.states, names, {}, ())
    return NodeSimulator.of_lowered(replace(lowered, graph=graph), parameters, list(names))


def _derived(graph: Graph, line: Linearization, slope: int) -> list[int]:
    """Return the nodes of a derivative, in the order of computation, without those of the graph."""
    return [at for at in ancestors(line.nodes, [slope]) if at >= len(graph.nodes)]


def _name_of(graph: Graph, line: Linearization, slope: int) -> str:
    """Return the first name that depends on the last node of the graph from which a slope is computed."""
    last = max(at for at in ancestors(line.nodes, [slope]) if at < len(graph.nodes))
    names = sorted((at, name) for name, at in graph.names.items() if name.isprintable())
    return next((name for at, name in names if last in ancestors(graph.nodes, [at])), "the model")
