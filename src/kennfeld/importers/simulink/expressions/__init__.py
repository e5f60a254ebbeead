"""Evaluation of expressions in block fields."""
