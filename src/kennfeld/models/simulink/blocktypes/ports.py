"""Where signals enter and leave: inports, outports, cuts, sinks."""

import numpy as np

from kennfeld.models.simulink.blocktypes.registry import block
from kennfeld.models.simulink.signals import CONTINUOUS, Signal, Wired
from kennfeld.models.simulink.site import Site


@block("Inport", "From", PortDimensions="-1", SampleTime="-1")
def inport(site: Site) -> Wired:
    """A channel; one for each element where the port says that it is a vector, for each signal used of a bus."""
    shape: tuple[int, ...] = (1,)
    if site.atom.kind == "Inport":
        shape = tuple(int(n) for n in site.numbers("PortDimensions").ravel() if n > 0) or (1,)
        if site.text("OutDataTypeStr", "").startswith("Bus:"):
            return site.weaver.opened(site.atom)
    name = site.weaver.input_name(site.atom)
    count = int(np.prod(shape))
    names = [name] if count == 1 else [f"{name}[{i + 1}]" for i in range(count)]
    nodes = np.array([site.loom.input(one) for one in names], dtype=np.int64).reshape(shape, order="F")
    return Signal(nodes, CONTINUOUS)


@block("Outport", SampleTime="-1")
def outport(site: Site) -> Wired:
    """The signal that arrives."""
    return site.wired(0)


@block("Bound", needs=lambda site: ())
def bound(site: Site) -> Wired | tuple[Wired, ...]:
    """What is given instead of a block."""
    return site.weaver.bound(site.weaver, site.atom)


@block(
    "Scope", "Terminator", "Display", "ToFile", "Stop", "Floating Scope", "XYGraph", "Assertion", "DocBlock",
    "Model Info", "DataTypeDuplicate", "DataTypePropagation", "EventListener", "HitCross Sink", "Note",
    needs=lambda site: (), sink=True,
)  # fmt: skip
def sink(site: Site) -> Wired:
    """Nothing: it only shows or checks."""
    return site.constant()


@block("ToWorkspace", sink=True, VariableName="simulink_output", SampleTime="0")
def to_workspace(site: Site) -> Wired:
    """The signal that it records."""
    return site.wired(0)


@block("Shown", sink=True)
def shown(site: Site) -> tuple[Wired, ...]:
    """The signals that a scope or display shows, in a model that has no other outputs."""
    return tuple(site.wired(at) for at in range(site.count))


@block("Ground")
def ground(site: Site) -> Wired:
    """0."""
    return site.constant(0.0)
