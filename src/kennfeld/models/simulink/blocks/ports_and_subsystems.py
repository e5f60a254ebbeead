"""Where signals enter and leave: inports, outports, cuts, sinks.

Subsystems that run several times in a step: what counts their passes, and what comes out of them.

Subsystems that do not run in every step, and what decides and joins them.
"""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import reduce_nodes
from kennfeld.models.simulink.blocks.continuous import reset_signal
from kennfeld.models.simulink.flattening.flat_model import SINK_TYPES, SignalSource, resets
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import case_values
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.reader.block_ports import port_number
from kennfeld.models.simulink.reader.model_tree import ModelBlock, join_path, split_path
from kennfeld.models.simulink.signals import (
    CONTINUOUS,
    Bus,
    ExternalBus,
    Signal,
    SignalOrBus,
    fastest_sample_time,
    fit_to_shape,
    scalar,
)

__all__ = []

_WIDEST = 10_000  # elements of a port from outside, each of them an input

_DASHBOARD = (
    "CallbackButton", "Checkbox", "CircularGaugeBlock", "ComboBox", "CustomWebBlock", "DashboardScope", "DisplayBlock",
    "EditField", "KnobBlock", "LampBlock", "LinearGaugeBlock", "MultiStateImageBlock", "PanelWebBlock",
    "PushButtonBlock", "QuarterGaugeBlock", "RadioButtonGroup", "RockerSwitchBlock", "RotarySwitchBlock",
    "SemiCircularGaugeBlock", "SliderBlock", "SliderSwitchBlock", "ToggleSwitchBlock",
)  # fmt: skip

_LARGEST = 1000.0  # passes


@block("Inport", "From", PortDimensions="-1", SampleTime="-1")
def inport(site: BlockContext) -> SignalOrBus:
    """A channel; one for each element where the port says that it is a vector, for each signal used of a bus."""
    shape: tuple[int, ...] = (1,)
    if site.atom.kind == "Inport":
        shape = tuple(int(n) for n in site.numbers("PortDimensions").ravel() if n > 0)
        shape = shape or site.compiler.shapes.open(site.atom)
        if site.text("OutDataTypeStr", "").startswith("Bus:"):
            return site.compiler.inputs.opened(site.atom)
    name = site.compiler.inputs.name(site.atom)
    count = math.prod(shape)
    if count > _WIDEST:
        raise UnsupportedError(f"it is {count} elements wide; {_WIDEST} are the most")
    names = [name] if count == 1 else [f"{name}[{i + 1}]" for i in range(count)]
    nodes = np.array([site.builder.input(one) for one in names], dtype=np.int64).reshape(shape, order="F")
    return Signal(nodes, CONTINUOUS)


@block("Outport", SampleTime="-1")
def outport(site: BlockContext) -> SignalOrBus:
    """The signal that arrives."""
    return site.wired(0)


@block("Bound", needs=lambda site: ())
def bound(site: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """What is given instead of a block."""
    return site.compiler.bound(site.compiler, site.atom)


@block(
    *_DASHBOARD, "SpectrumAnalyzer", "Terminator", "Stop", "Floating Scope", "Assertion", "DocBlock", "Model Info",
    "DataTypeDuplicate", "DataTypePropagation", "EventListener", "HitCross Sink", "Note",
    needs=lambda site: (), sink=True,
)  # fmt: skip
def sink(site: BlockContext) -> SignalOrBus:
    """Nothing: it only shows or checks."""
    return site.constant()


@block(*SINK_TYPES, sink=True)
def shown(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The signals that it shows or writes."""
    return tuple(site.wired(at) for at in range(site.count))


@block("ToWorkspace", sink=True, VariableName="simulink_output", SampleTime="0")
def to_workspace(site: BlockContext) -> SignalOrBus:
    """The signal that it records."""
    return site.wired(0)


@block("Ground")
def ground(site: BlockContext) -> SignalOrBus:
    """0."""
    return site.constant(0.0)


@block("Control")
def control(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """Whether a conditional subsystem runs, and whether the memories in it begin anew."""
    ports = [port for port in site.atom.special if port != "reset"]
    conditions = {port: _condition(site, port, _at(site, port)) for port in ports}
    outer = site.compiler.gates.active(site.atom)
    if outer is not None:
        conditions["outer"] = scalar(outer)
    active = _all(site, list(conditions.values()))
    if "trigger" not in conditions:
        return active, reset_condition(site, active)
    triggered = _all(site, [conditions[port] for port in ("trigger", "outer") if port in conditions])
    return active, reset_condition(site, active, triggered)


def _at(site: BlockContext, port: str) -> Signal:
    """The signal at one of the special ports, which are the inputs in their order."""
    return site.input(list(site.atom.special).index(port))


def _all(site: BlockContext, conditions: list[Signal]) -> Signal:
    return site.compiler.timing.at_major(site.fold("and", conditions or [site.constant(1.0)]))


def reset_condition(site: BlockContext, active: Signal, triggered: Signal | None = None) -> Signal:
    """1 where the memories of a subsystem begin anew: those around it do, it is enabled again, or it is reset.

    Whether a subsystem with a trigger is enabled is only seen where it is `triggered`.
    """
    around = site.compiler.gates.restart(site.atom)
    events = [] if around is None else [scalar(around)]
    if resets(site.atom):
        events.append(_enabled_again(site, active, triggered))
    if "reset" in site.atom.special:
        port = site.atom.special["reset"]
        events.append(reset_signal(site, _at(site, "reset"), port.value("ResetTriggerType") or "level"))
    return site.fold("or", events) if events else site.constant(0.0)


def _enabled_again(site: BlockContext, active: Signal, triggered: Signal | None) -> Signal:
    """1 where a subsystem runs that was not enabled when that was last seen."""
    made: list[Signal] = []
    before = site.compiler.memories.always_later(site, site.constant(0.0), lambda: made[0])
    made.append(active if triggered is None else site.select(triggered, active, before))
    return site.call("and", active, site.call("not", before))


def _condition(site: BlockContext, port: str, u: Signal) -> Signal:
    special = site.atom.special[port]
    zero = site.constant(0.0)
    if port == "enable":
        return _any(site, site.call("gt", u, zero))
    kind = special.value("TriggerType") or "rising"
    if port == "ifaction" or kind == "function-call":
        if u.size > 1:
            remedy = "Give each caller a subsystem of its own."
            raise UnsupportedError(f"{u.size} calls arrive at its {port} port, which is not supported", remedy)
        return site.call("ne", u, zero)
    if kind not in ("rising", "falling", "either"):
        raise UnsupportedError(f"TriggerType is {kind!r}, which is not supported")
    return _any(site, site.edge(site.compiler.timing.at_major(u), kind))


def _any(site: BlockContext, truths: Signal) -> Signal:
    """1 where one of the elements is: a control signal that is a vector counts by any of them."""
    return scalar(reduce_nodes(site.builder, "or", truths.flat), truths.period)


@block("Held", InitialOutput="[]", OutputWhenDisabled="held")
def held(site: BlockContext) -> SignalOrBus:
    """An output of a conditional subsystem: what it computes while it runs, else what it was or the initial value."""
    return _held(site, site.wired(0))


def _held(site: BlockContext, wired: SignalOrBus) -> SignalOrBus:
    wired = wired.signal if isinstance(wired, ExternalBus) else wired
    if isinstance(wired, Bus):
        return Bus({name: _held(site, member) for name, member in wired.members.items()})
    init = site.initial_output() or site.constant(0.0)
    active = site.compiler.gates.active(site.atom)
    if active is None:
        return wired
    runs = scalar(active, wired.period)
    init = Signal(fit_to_shape(init.nodes, wired.shape))
    control_of = site.atom.control
    resettable = control_of is not None and "trigger" not in control_of.special
    if site.text("OutputWhenDisabled") == "reset" and resettable:
        return site.select(runs, wired, init)
    made: list[Signal] = []
    before = site.compiler.memories.always_later(site, init, lambda: made[0])
    made.append(site.select(runs, wired, before))
    return made[0]


@block("Merge", Inputs="2", InitialOutput="[]")
def merge(site: BlockContext) -> SignalOrBus:
    """The output of the subsystem that ran last; of several that run in a step, of the last one."""
    sources = [source for source in site.atom.inputs if source is not None]
    init = _merged_initially(site, sources)
    return _merged(site, init, [_runs(site, source) for source in sources], [site.compiler.value(s) for s in sources])


def _merged(site: BlockContext, init: Signal, running: list[Signal], arriving: list[SignalOrBus]) -> SignalOrBus:
    buses = [wired for wired in arriving if isinstance(wired, Bus) and not isinstance(wired, ExternalBus)]
    if not buses:
        signals = [wired.signal if isinstance(wired, ExternalBus) else wired for wired in arriving]
        return _last(site, init, running, [signal for signal in signals if isinstance(signal, Signal)])
    names = list(buses[0].members)
    if len(buses) < len(arriving) or any(list(bus.members) != names for bus in buses):
        raise UnsupportedError("it merges buses that do not have the same signals")
    return Bus({name: _merged(site, init, running, [bus.members[name] for bus in buses]) for name in names})


def _last(site: BlockContext, init: Signal, running: list[Signal], signals: list[Signal]) -> Signal:
    """The last of those signals whose subsystem runs, else what was there before."""
    made: list[Signal] = []
    y = site.compiler.memories.always_later(site, site.spread(init, *signals)[0], lambda: made[0])
    for runs, signal in zip(running, signals, strict=True):
        y = site.select(runs, signal, y)
    made.append(y)
    return y


def _merged_initially(site: BlockContext, sources: Sequence[SignalSource]) -> Signal:
    """What a Merge begins with: its own initial output, else the last one that the outputs before it state."""
    stating = [site, *(site.compiler.site(source.atom) for source in reversed(sources) if source.atom.kind == "Held")]
    for one in stating:
        if (stated := one.initial_output()) is not None:
            return stated
    return site.constant(0.0)


def _runs(site: BlockContext, source: SignalSource) -> Signal:
    if source.atom.kind != "Held" or source.atom.control is None:
        raise UnsupportedError(f"its input from {source.atom.path} is not the output of a conditional subsystem")
    return site.compiler.signal(SignalSource(source.atom.control, 0))


@block("If", IfExpression="u1 > 0", ElseIfExpressions="", ShowElse="on", NumInputs="1", SampleTime="-1")
def if_block(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """For each output whether it is the first whose condition holds."""
    texts = [site.text("IfExpression"), *(t for t in site.text("ElseIfExpressions").split(",") if t.strip())]
    names = {f"u{at + 1}": site.input(at).nodes.reshape(-1, 1) for at in range(site.count)}
    outputs: list[SignalOrBus] = []
    none = site.constant(1.0)
    for text in texts:
        try:
            nodes = site.compiler.expressions.array(text, site.atom.scope, names=names)
        except EvaluationError as error:
            raise UnsupportedError(
                f"its condition {text[:60]} cannot be built: {error}", undefined=error.undefined
            ) from None
        if nodes.size != 1:
            raise UnsupportedError(f"its condition {text[:60]} has {nodes.size} values where one is expected")
        holds = Signal(nodes.ravel(), fastest_sample_time([one.period for one in site.inputs]))
        outputs.append(site.call("and", none, holds))
        none = site.call("and", none, site.call("not", holds))
    return (*outputs, none) if site.on("ShowElse") else tuple(outputs)


@block("SwitchCase", CaseConditions="{1}", ShowDefaultCase="on", CaseShowDefault="on", SampleTime="-1")
def switch_case(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """For each output whether the input is among its cases; the last one where it is among none."""
    u = site.truncated(site.input())
    outputs: list[SignalOrBus] = []
    none = site.constant(1.0)
    for cases in case_values(site, "CaseConditions"):
        holds = site.among(u, cases)
        outputs.append(site.call("and", none, holds))
        none = site.call("and", none, site.call("not", holds))
    return (*outputs, none)


@block("Function-Call Generator", sample_time="1", numberOfIterations="1")
def function_call_generator(site: BlockContext) -> SignalOrBus:
    """A call at each hit of its sample time."""
    if site.number("numberOfIterations") != 1:
        raise UnsupportedError("it calls several times in a step")
    return site.compiler.timing.hits(site.number("sample_time"))


@block("ForIterator", IterationLimit="5", IterationSource="internal", IndexMode="One-based", ResetStates="held")
def for_iterator(site: BlockContext) -> SignalOrBus:
    """The number of the pass."""
    _in_passes(site, bool(site.atom.passes))
    if site.text("IterationSource") == "external":
        _count(site, _fixed(site))
    return site.constant(site.atom.passes[-1] - (site.text("IndexMode") == "Zero-based"))


def _fixed(site: BlockContext) -> float:
    """The fixed value at the input that says how many passes there are."""
    signal = site.input()
    value = site.builder.value(signal.flat[0]) if signal.size == 1 else None
    source = site.source()
    if value is None and source is not None and source.atom.kind == "Constant":
        try:
            numbers = site.compiler.expressions.numbers(source.atom.block.value("Value") or "1", source.atom.scope)
        except EvaluationError as error:
            raise UnsupportedError(
                f"the number of its passes has no value: {error}", undefined=error.undefined
            ) from None
        value = float(numbers.item()) if numbers.size == 1 else None
    if value is None:
        remedy = "Feed it from a Constant, or count the passes in the block itself."
        raise UnsupportedError("the number of its passes is not fixed", remedy)
    return value


def _count(site: BlockContext, found: float) -> None:
    """Note how many passes a subsystem has; where it was built with others, it is built once more."""
    if not (found.is_integer() and 1 <= found <= _LARGEST):
        raise UnsupportedError(f"it asks for {found:g} passes in a step; 1 to {_LARGEST:g} are possible")
    site.compiler.counted(join_path(*split_path(site.atom.path)[:-1]), int(found))


def _in_passes(site: BlockContext, inside: bool) -> None:
    if not inside:
        raise UnsupportedError("its subsystem runs several times in a step", "Import the system around it.")


@block("WhileIterator", needs=no_feedthrough)
def while_iterator(site: BlockContext) -> SignalOrBus:
    """The number of the pass."""
    _in_passes(site, bool(site.atom.passes))
    return site.constant(float(site.atom.passes[-1]))


@block("Pass")
def iteration(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """Whether a pass takes place, and whether the memories in it begin anew."""
    active = site.constant(1.0)
    for signal in site.inputs:
        active = site.call("and", active, site.call("ne", site.compiler.timing.at_major(signal), site.constant(0.0)))
    before = site.atom.earlier
    said = site.compiler.value(SignalSource(before, 0)) if before is not None else None
    outer = site.compiler.gates.active(site.atom)
    if site.atom.passes[-1] > 1 and isinstance(said, Signal):
        active = site.call("and", said, active)
    elif outer is not None:
        active = site.call("and", scalar(outer), active)
    return active, reset_condition(site, active)


@block("Iterated", InitialOutput="[]")
def iterated(site: BlockContext) -> SignalOrBus:
    """What the last pass gives that takes place; the output of the step before where none does."""
    if site.count == 1:
        return site.wired(0)
    passes = [site.input(at) for at in range(1, site.count, 2)]
    return _last_pass(site, [site.wired(at) for at in range(0, site.count, 2)], passes)


def _last_pass(site: BlockContext, outputs: list[SignalOrBus], passes: list[Signal]) -> SignalOrBus:
    if isinstance(outputs[0], Bus):
        members = {name: [_member(one, name) for one in outputs] for name in outputs[0].members}
        return Bus({name: _last_pass(site, several, passes) for name, several in members.items()})
    signals = [one for one in outputs if isinstance(one, Signal)]
    made: list[Signal] = []
    y = signals[0]
    if site.builder.value(passes[0].flat[0]) != 1:
        init = site.initial_output() or site.constant(0.0)
        init = Signal(fit_to_shape(init.nodes, y.shape))
        y = site.select(passes[0], y, site.compiler.memories.always_later(site, init, lambda: made[0]))
    for active, signal in zip(passes[1:], signals[1:], strict=True):
        y = site.select(active, signal, y)
    made.append(y)
    return y


def _member(wired: SignalOrBus, name: str) -> SignalOrBus:
    assert isinstance(wired, Bus)
    return wired.members[name]


# for each


@block("ForEach", needs=no_feedthrough, IndexMode="Zero-based")
def for_each(site: BlockContext) -> SignalOrBus:
    """The number of the element."""
    _in_passes(site, site.atom.element > 0)
    return site.constant(site.atom.element - (site.text("IndexMode") == "Zero-based"))


@block("Part")
def part(site: BlockContext) -> SignalOrBus:
    """The part of a signal that an element gets."""
    each, number = _each(site)
    width, dimension = _setting(each, "InputPartitionWidth", number), _setting(each, "InputPartitionDimension", number)
    if _setting(each, "InputPartitionOffset", number, 0):
        raise UnsupportedError("its parts overlap or leave something out, which is not supported")
    x = site.input()
    if not 1 <= dimension <= len(x.shape):
        raise UnsupportedError(f"it is parted along dimension {dimension}, which its signal does not have")
    length = x.shape[dimension - 1]
    if length % width:
        raise UnsupportedError(f"its {length} elements cannot be parted by {width}")
    count, element = length // width, site.atom.element - 1
    if (each.value("SpecifiedNumIters") or "-1").strip() == "-1":
        _count(site, float(count))
        element %= count  # a first attempt may have had more
    if element >= count:
        raise UnsupportedError(f"it has {count} elements, less than are asked for")
    start = element * width
    return Signal(np.take(x.nodes, range(start, start + width), axis=dimension - 1), x.period)


def _each(site: BlockContext) -> tuple[ModelBlock, int]:
    """The block that says how a port is parted or put together, and the number of the port."""
    each = site.atom.special.get("each")
    if each is None:
        raise UnsupportedError("it is no port of a For Each subsystem")
    return each, port_number(site.atom.block)


def _setting(each: ModelBlock, name: str, number: int, otherwise: int = 1) -> int:
    listed = each.listed(name)
    text = listed[number - 1].strip() if number <= len(listed) else ""
    if text and not text.isdecimal():
        raise UnsupportedError(f"{name} is {text[:40]}, not a whole number")
    return int(text) if text else otherwise


@block("Joined")
def together(site: BlockContext) -> SignalOrBus:
    """The outputs of all elements along a dimension."""
    each, number = _each(site)
    if "off" in each.listed("OutputConcatenation")[number - 1 : number]:
        raise UnsupportedError("its elements are not put together, which is not supported")
    dimension = _setting(each, "OutputConcatenationDimension", number)
    parts = site.inputs
    if len({one.shape for one in parts}) > 1 or dimension not in (1, 2):
        raise UnsupportedError(f"its elements cannot be put together along dimension {dimension}")
    arrays = [one.nodes.reshape(-1, 1) if dimension == 2 and one.nodes.ndim == 1 else one.nodes for one in parts]
    return Signal(np.concatenate(arrays, axis=dimension - 1), fastest_sample_time([one.period for one in parts]))
