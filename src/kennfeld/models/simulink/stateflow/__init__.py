"""Stateflow charts: from the tree that `charts.py` reads to the graph of one step."""
