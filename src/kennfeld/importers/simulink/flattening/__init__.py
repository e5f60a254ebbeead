"""Flattening: subsystems dissolved into one list of connected blocks."""
