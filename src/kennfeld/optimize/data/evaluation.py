"""Expressions over the channels of a dataset."""

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.graph import CLOCK, Graph
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.lowering import lower
from kennfeld.native import Simulator
from kennfeld.optimize.data.binding import bind
from kennfeld.parameters import ParameterSet

__all__ = ["evaluated", "uses_clock"]


def uses_clock(graph: Graph) -> bool:
    """Whether the graph reads the time or the step."""
    return any(node.op == "input" and node.payload in CLOCK for node in graph.nodes)


def evaluated(graph: Graph, dataset: Dataset) -> Float:
    """The node `value` of a graph over all samples of a dataset; NaN where an input is missing."""
    if graph.states or uses_clock(graph):
        return _simulated(graph, dataset)
    columns = {name: dataset[name].values for name in graph.inputs}
    with np.errstate(all="ignore"):
        found = evaluate(graph, columns, ParameterSet())["value"]
    return np.array(np.broadcast_to(found, dataset.samples))


def _simulated(graph: Graph, dataset: Dataset) -> Float:
    """With memory: states start anew at each piece and after each gap."""
    bound = bind(dataset, graph, {})
    lowered = lower(graph, ParameterSet())
    simulator = Simulator(lowered, [lowered.graph.names["value"]], ParameterSet())
    result = np.full(dataset.samples, np.nan)
    result[bound.kept] = simulator.over(bound.columns, bound.count, ParameterSet(), bound.starts.tolist())[0]
    return result
