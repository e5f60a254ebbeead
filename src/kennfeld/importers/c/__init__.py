"""Functions in C: translated to graphs, or compiled by the C compiler of the system."""
