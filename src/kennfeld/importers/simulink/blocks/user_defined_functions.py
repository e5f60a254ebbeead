"""User-Defined Functions library: MATLAB Functions and charts, whose modules are imported on first use."""

from collections.abc import Iterable

from kennfeld.importers.simulink.lowering import BlockContext, block
from kennfeld.importers.simulink.signals import SignalOrBus


@block("MATLAB Function")
def matlab_function(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the results of a MATLAB Function in the order of its outputs."""
    from kennfeld.importers.simulink import matlab_function as lowering

    return lowering.matlab_function(block)


def _early(block: BlockContext) -> Iterable[int]:
    """Return the inputs that a chart needs before it runs."""
    from kennfeld.importers.simulink.stateflow import chart_block

    return chart_block.early_inputs(block)


@block("Chart", needs=_early, held=False)
def chart(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Execute a chart at each sample hit, or at its events."""
    from kennfeld.importers.simulink.stateflow import chart_block

    return chart_block.compile_chart(block)
