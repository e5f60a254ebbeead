"""A point held, by the reference interpreter."""

import numpy as np

import kennfeld as kf
from kennfeld.graph.interpreter import evaluate


def held(text, u, parameters, samples, step=0.1):
    """The node y over all samples of a point."""
    graph = kf.formula(text, parameters=list(parameters)).graph
    columns = {"u": np.full(samples, u), "dt": np.full(samples, step), "t": step * np.arange(samples)}
    return np.asarray(evaluate(graph, columns, parameters)["y"])
