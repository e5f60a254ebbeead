"""Blocks that hold a program, MATLAB Functions and charts; what follows one is loaded where one occurs."""

from collections.abc import Iterable

from kennfeld.models.simulink.expressions.signals import Wired
from kennfeld.models.simulink.weaving.registry import block
from kennfeld.models.simulink.weaving.site import Site


@block("MATLAB Function")
def matlab_function(site: Site) -> tuple[Wired, ...]:
    """What the function's results are, in the order in which it names them."""
    from kennfeld.models.simulink.blocktypes import functions

    return functions.matlab_function(site)


def _early(site: Site) -> Iterable[int]:
    """The inputs that a chart needs before it runs."""
    from kennfeld.models.simulink.blocktypes import charts

    return charts.early(site)


@block("Chart", needs=_early, held=False)
def chart(site: Site) -> tuple[Wired, ...]:
    """One execution of a chart in each hit of its sample time, or at its events."""
    from kennfeld.models.simulink.blocktypes import charts

    return charts.chart(site)
