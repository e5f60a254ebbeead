"""MATLAB expressions over arrays of graph nodes."""
