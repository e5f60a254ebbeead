"""Helpers that know nothing of calibration: errors, arrays, files, processes, tasks, machine code."""
