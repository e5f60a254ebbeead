"""Lowering of flat blocks to graph nodes: order, sample times, execution conditions and states.

This is what block handlers import: the context of a block, its registration, and the error of what is unsupported.
"""

from kennfeld.importers.simulink.lowering.block_context import BlockContext
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError, evaluating
from kennfeld.importers.simulink.lowering.registry import (
    ARITHMETIC,
    BLOCK_TYPES,
    LIKE_INPUT,
    Outputs,
    OutputType,
    block,
    no_feedthrough,
)

__all__ = [
    "ARITHMETIC",
    "BLOCK_TYPES",
    "LIKE_INPUT",
    "BlockContext",
    "OutputType",
    "Outputs",
    "UnsupportedError",
    "block",
    "evaluating",
    "no_feedthrough",
]
