"""The graph of a model: nodes, exact derivatives, preparation, and the reference interpreter."""

from kennfeld.graph.node import CLOCK, Builder, Graph, Node, State
from kennfeld.graph.operations import OPERATIONS

__all__ = ["CLOCK", "OPERATIONS", "Builder", "Graph", "Node", "State"]
