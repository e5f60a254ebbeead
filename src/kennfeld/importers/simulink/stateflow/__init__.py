"""Stateflow charts as nodes of the graph."""
