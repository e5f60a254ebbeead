"""Blocks that hold a program, MATLAB Functions and charts; what follows one is loaded where one occurs."""

from collections.abc import Iterable

from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import SignalOrBus


@block("MATLAB Function")
def matlab_function(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """What the function's results are, in the order in which it names them."""
    from kennfeld.models.simulink import matlab_function as lowering

    return lowering.matlab_function(site)


def _early(site: BlockContext) -> Iterable[int]:
    """The inputs that a chart needs before it runs."""
    from kennfeld.models.simulink.stateflow import chart_block

    return chart_block.early(site)


@block("Chart", needs=_early, held=False)
def chart(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """One execution of a chart in each hit of its sample time, or at its events."""
    from kennfeld.models.simulink.stateflow import chart_block

    return chart_block.chart(site)
