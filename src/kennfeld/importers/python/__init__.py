"""Functions in Python: translated to graphs, or called."""
