"""Breakpoints that are fitted."""
