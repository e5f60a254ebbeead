"""A held point, by the reference interpreter."""

import numpy as np

import kennfeld as kf
from kennfeld.graph.interpreter import evaluate
from tests.clocks import even_clock


def held_output(text, u, parameters, samples, step=0.1):
    """The node y over all samples of a point."""
    graph = kf.formula(text, parameters=list(parameters)).graph
    columns = {"u": np.full(samples, u), **even_clock(step, samples)}
    return np.asarray(evaluate(graph, columns, parameters)["y"])
