"""Lowering of flat blocks to graph nodes: order, sample times, execution conditions and states."""
