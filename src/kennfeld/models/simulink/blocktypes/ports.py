"""Where signals enter and leave: inports, outports, cuts, sinks."""

import math

import numpy as np

from kennfeld.models.simulink.expressions.signals import CONTINUOUS, Signal, Wired
from kennfeld.models.simulink.flattening.atoms import SHOWING
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site

_WIDEST = 10_000  # elements of a port from outside, each of them an input


@block("Inport", "From", PortDimensions="-1", SampleTime="-1")
def inport(site: Site) -> Wired:
    """A channel; one for each element where the port says that it is a vector, for each signal used of a bus."""
    shape: tuple[int, ...] = (1,)
    if site.atom.kind == "Inport":
        shape = tuple(int(n) for n in site.numbers("PortDimensions").ravel() if n > 0)
        shape = shape or site.weaver.shapes.open(site.atom)
        if site.text("OutDataTypeStr", "").startswith("Bus:"):
            return site.weaver.inputs.opened(site.atom)
    name = site.weaver.inputs.name(site.atom)
    count = math.prod(shape)
    if count > _WIDEST:
        raise UnsupportedError(f"it is {count} elements wide; {_WIDEST} are the most")
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


_DASHBOARD = (
    "CallbackButton", "Checkbox", "CircularGaugeBlock", "ComboBox", "CustomWebBlock", "DashboardScope", "DisplayBlock",
    "EditField", "KnobBlock", "LampBlock", "LinearGaugeBlock", "MultiStateImageBlock", "PanelWebBlock",
    "PushButtonBlock", "QuarterGaugeBlock", "RadioButtonGroup", "RockerSwitchBlock", "RotarySwitchBlock",
    "SemiCircularGaugeBlock", "SliderBlock", "SliderSwitchBlock", "ToggleSwitchBlock",
)  # fmt: skip


@block(
    *_DASHBOARD, "SpectrumAnalyzer", "Terminator", "Stop", "Floating Scope", "Assertion", "DocBlock", "Model Info",
    "DataTypeDuplicate", "DataTypePropagation", "EventListener", "HitCross Sink", "Note",
    needs=lambda site: (), sink=True,
)  # fmt: skip
def sink(site: Site) -> Wired:
    """Nothing: it only shows or checks."""
    return site.constant()


@block(*SHOWING, sink=True)
def shown(site: Site) -> tuple[Wired, ...]:
    """The signals that it shows or writes."""
    return tuple(site.wired(at) for at in range(site.count))


@block("ToWorkspace", sink=True, VariableName="simulink_output", SampleTime="0")
def to_workspace(site: Site) -> Wired:
    """The signal that it records."""
    return site.wired(0)


@block("Ground")
def ground(site: Site) -> Wired:
    """0."""
    return site.constant(0.0)
