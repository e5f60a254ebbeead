"""Time constants are never below 0: where a table is one, its values are bounded so.

Without the bound, a fit that presses a time constant towards 0 would have its steps rejected one after the other, for
all values together, and get nowhere.
"""

from dataclasses import replace

import numpy as np

from kennfeld.graph import Graph
from kennfeld.optimize.problem import Problem
from kennfeld.parameters import Parameter

__all__ = ["bounded", "time_constants"]


def time_constants(graph: Graph) -> list[int]:
    """The nodes T of `if(T < 0, nan, share)`, which is how a lag says that its time constant is invalid."""
    nodes = graph.nodes
    found: dict[int, None] = {}
    for op, args, _ in nodes:
        if op == "select" and nodes[args[0]].op == "lt" and nodes[args[1]].op == "const":
            left, right = nodes[args[0]].args
            if nodes[right].op == "const" and nodes[right].payload == 0.0 and np.isnan(nodes[args[1]].payload):
                found[left] = None
    return list(found)


def bounded(problem: Problem) -> Problem:
    """The problem with a lower bound of 0 for free parameters that are time constants and nothing else.

    Locked values, and parameters that may only be negative, stay as they are.
    """
    graph = problem.model.graph
    lags = set(time_constants(graph))
    elsewhere = {n.payload for at, n in enumerate(graph.nodes) if n.op == "lookup" and at not in lags}
    names = {graph.nodes[at].payload for at in lags if graph.nodes[at].op == "lookup"} - elsewhere
    found = [_from_zero(problem.parameters[n]) for n in problem.free_names if n in names and n in problem.parameters]
    changed = [parameter for parameter in found if parameter is not None]
    return replace(problem, parameters=problem.parameters.with_parameters(*changed)) if changed else problem


def _from_zero(parameter: Parameter) -> Parameter | None:
    """The parameter with its lower bounds at least 0; None where they are already, or cannot be."""
    lower, upper = (np.broadcast_to(side, parameter.values.shape) for side in (parameter.lower, parameter.upper))
    raised = np.where(parameter.locked, lower, np.maximum(lower, 0.0))
    if np.array_equal(raised, lower) or np.any(raised > upper):
        return None
    return parameter.with_bounds(raised, upper)
