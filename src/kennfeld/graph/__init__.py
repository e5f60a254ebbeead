"""The graph of a model: nodes, exact derivatives, preparation, and the reference interpreter."""

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import CLOCK, Graph, Node, State
from kennfeld.graph.operations import OPERATIONS

__all__ = ["CLOCK", "OPERATIONS", "Graph", "GraphBuilder", "Node", "State"]
