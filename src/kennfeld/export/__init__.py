"""Exports the calibrated function for control units and their tests: C99, FMU, MATLAB."""
