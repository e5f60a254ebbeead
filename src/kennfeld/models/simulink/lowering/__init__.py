"""Blocks to graph: their order, sample times, conditions and memories."""
