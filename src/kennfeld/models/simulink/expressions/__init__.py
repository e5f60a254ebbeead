"""Expressions in block fields."""
