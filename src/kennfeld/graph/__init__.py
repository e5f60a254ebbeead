"""Computation graph of one time step of a model: nodes, exact derivatives, graph passes and a reference interpreter."""

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import CLOCK, Graph, Node, State
from kennfeld.graph.operations import OPERATIONS

__all__ = ["CLOCK", "OPERATIONS", "Graph", "GraphBuilder", "Node", "State"]
