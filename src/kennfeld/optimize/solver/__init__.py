"""Minimisation of a sum of squares within linear limits."""
