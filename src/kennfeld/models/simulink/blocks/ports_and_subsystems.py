"""Ports & Subsystems library: ports, bound blocks, sinks, conditional and iterated subsystems."""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import reduce_nodes
from kennfeld.models.simulink.blocks.continuous import reset_signal
from kennfeld.models.simulink.flattening.flat_model import SINK_TYPES, SignalSource, resets_on_enable
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

_MAX_PORT_WIDTH = 10_000  # elements of a root inport, each an input of the model

_DASHBOARD = (
    "CallbackButton", "Checkbox", "CircularGaugeBlock", "ComboBox", "CustomWebBlock", "DashboardScope", "DisplayBlock",
    "EditField", "KnobBlock", "LampBlock", "LinearGaugeBlock", "MultiStateImageBlock", "PanelWebBlock",
    "PushButtonBlock", "QuarterGaugeBlock", "RadioButtonGroup", "RockerSwitchBlock", "RotarySwitchBlock",
    "SemiCircularGaugeBlock", "SliderBlock", "SliderSwitchBlock", "ToggleSwitchBlock",
)  # fmt: skip

_MAX_ITERATIONS = 1000.0  # passes


@block("Inport", "From", PortDimensions="-1", SampleTime="-1")
def inport(block: BlockContext) -> SignalOrBus:
    """Return an input of the model: one channel per element of a vector, one per used signal of a bus."""
    shape: tuple[int, ...] = (1,)
    if block.flat.type == "Inport":
        shape = tuple(int(n) for n in block.numeric_array("PortDimensions").ravel() if n > 0)
        shape = shape or block.compiler.shapes.input_shape(block.flat)
        if block.field_text("OutDataTypeStr", "").startswith("Bus:"):
            return block.compiler.inputs.open_bus(block.flat)
    name = block.compiler.inputs.name(block.flat)
    count = math.prod(shape)
    if count > _MAX_PORT_WIDTH:
        raise UnsupportedError(f"it has {count} elements; at most {_MAX_PORT_WIDTH} are supported")
    names = [name] if count == 1 else [f"{name}[{i + 1}]" for i in range(count)]
    nodes = np.array([block.builder.input(text) for text in names], dtype=np.int64).reshape(shape, order="F")
    return Signal(nodes, CONTINUOUS)


@block("Outport", SampleTime="-1")
def outport(block: BlockContext) -> SignalOrBus:
    """Return the input."""
    return block.input_or_bus(0)


@block("BoundBlock", needs=lambda block: ())
def bound(block: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Return the signals bound in place of a block."""
    return block.compiler.bound(block.compiler, block.flat)


@block(
    *_DASHBOARD, "SpectrumAnalyzer", "Terminator", "Stop", "Floating Scope", "Assertion", "DocBlock", "Model Info",
    "DataTypeDuplicate", "DataTypePropagation", "EventListener", "HitCross Sink", "Note",
    needs=lambda block: (), sink=True,
)  # fmt: skip
def sink(block: BlockContext) -> SignalOrBus:
    """Lower a sink that only displays or checks; it has no output."""
    return block.constant()


@block(*SINK_TYPES, sink=True)
def shown(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the signals that the block displays or writes."""
    return tuple(block.input_or_bus(at) for at in range(block.input_count))


@block("ToWorkspace", sink=True, VariableName="simulink_output", SampleTime="0")
def to_workspace(block: BlockContext) -> SignalOrBus:
    """Return the recorded signal."""
    return block.input_or_bus(0)


@block("Ground")
def ground(block: BlockContext) -> SignalOrBus:
    """Return 0."""
    return block.constant(0.0)


@block("ConditionalSubsystem")
def control(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return for a conditional subsystem its condition and its reset condition."""
    ports = [port for port in block.flat.control_ports if port != "reset"]
    conditions = {port: _condition(block, port, _control_input(block, port)) for port in ports}
    outer = block.compiler.gates.run_condition(block.flat)
    if outer is not None:
        conditions["outer"] = scalar(outer)
    active = _all(block, list(conditions.values()))
    if "trigger" not in conditions:
        return active, reset_condition(block, active)
    triggered = _all(block, [conditions[port] for port in ("trigger", "outer") if port in conditions])
    return active, reset_condition(block, active, triggered)


def _control_input(block: BlockContext, port: str) -> Signal:
    """Return the signal at a control port; the control ports are the inputs, in order."""
    return block.input(list(block.flat.control_ports).index(port))


def _all(block: BlockContext, conditions: list[Signal]) -> Signal:
    return block.compiler.timing.hold_in_minor_steps(block.reduce("and", conditions or [block.constant(1.0)]))


def reset_condition(block: BlockContext, active: Signal, triggered: Signal | None = None) -> Signal:
    """Return 1 if the states of a subsystem are reset: by an enclosing subsystem, by enabling, or by a reset port.

    `triggered` is the trigger of a triggered subsystem, at which its enable port is evaluated.
    """
    around = block.compiler.gates.reset_condition(block.flat)
    events = [] if around is None else [scalar(around)]
    if resets_on_enable(block.flat):
        events.append(_enabled_again(block, active, triggered))
    if "reset" in block.flat.control_ports:
        port = block.flat.control_ports["reset"]
        events.append(reset_signal(block, _control_input(block, "reset"), port.value("ResetTriggerType") or "level"))
    return block.reduce("or", events) if events else block.constant(0.0)


def _enabled_again(block: BlockContext, active: Signal, triggered: Signal | None) -> Signal:
    """Return 1 if a subsystem runs and was disabled at the previous evaluation."""
    signals: list[Signal] = []
    before = block.compiler.memories.delay_unconditionally(block, block.constant(0.0), lambda: signals[0])
    signals.append(active if triggered is None else block.select(triggered, active, before))
    return block.apply("and", active, block.apply("not", before))


def _condition(block: BlockContext, port: str, u: Signal) -> Signal:
    special = block.flat.control_ports[port]
    zero = block.constant(0.0)
    if port == "enable":
        return _any(block, block.apply("gt", u, zero))
    kind = special.value("TriggerType") or "rising"
    if port == "ifaction" or kind == "function-call":
        if u.size > 1:
            remedy = "Use a separate subsystem for each caller."
            raise UnsupportedError(f"its {port} port receives {u.size} function calls, which is not supported", remedy)
        return block.apply("ne", u, zero)
    if kind not in ("rising", "falling", "either"):
        raise UnsupportedError(f"TriggerType {kind!r} is not supported")
    return _any(block, block.zero_crossing(block.compiler.timing.hold_in_minor_steps(u), kind))


def _any(block: BlockContext, truths: Signal) -> Signal:
    """Return 1 if any element of a control signal is true."""
    return scalar(reduce_nodes(block.builder, "or", truths.flat), truths.period)


@block("ConditionalOutput", InitialOutput="[]", OutputWhenDisabled="held")
def held(block: BlockContext) -> SignalOrBus:
    """Return an output of a conditional subsystem: computed while it runs, else held or set to the initial value."""
    return _held(block, block.input_or_bus(0))


def _held(block: BlockContext, wired: SignalOrBus) -> SignalOrBus:
    wired = wired.signal if isinstance(wired, ExternalBus) else wired
    if isinstance(wired, Bus):
        return Bus({name: _held(block, member) for name, member in wired.members.items()})
    init = block.initial_output() or block.constant(0.0)
    active = block.compiler.gates.run_condition(block.flat)
    if active is None:
        return wired
    runs = scalar(active, wired.period)
    init = Signal(fit_to_shape(init.nodes, wired.shape))
    control_of = block.flat.control
    resettable = control_of is not None and "trigger" not in control_of.control_ports
    if block.field_text("OutputWhenDisabled") == "reset" and resettable:
        return block.select(runs, wired, init)
    signals: list[Signal] = []
    before = block.compiler.memories.delay_unconditionally(block, init, lambda: signals[0])
    signals.append(block.select(runs, wired, before))
    return signals[0]


@block("Merge", Inputs="2", InitialOutput="[]")
def merge(block: BlockContext) -> SignalOrBus:
    """Return the output of the subsystem that ran last; if several run in a step, of the last of them."""
    sources = [source for source in block.flat.inputs if source is not None]
    init = _initial_merge_value(block, sources)
    return _merged(
        block, init, [_runs(block, source) for source in sources], [block.compiler.value(s) for s in sources]
    )


def _merged(block: BlockContext, init: Signal, running: list[Signal], arriving: list[SignalOrBus]) -> SignalOrBus:
    buses = [wired for wired in arriving if isinstance(wired, Bus) and not isinstance(wired, ExternalBus)]
    if not buses:
        signals = [wired.signal if isinstance(wired, ExternalBus) else wired for wired in arriving]
        return _last_running(block, init, running, [signal for signal in signals if isinstance(signal, Signal)])
    names = list(buses[0].members)
    if len(buses) < len(arriving) or any(list(bus.members) != names for bus in buses):
        raise UnsupportedError("it merges buses with different signals")
    return Bus({name: _merged(block, init, running, [bus.members[name] for bus in buses]) for name in names})


def _last_running(block: BlockContext, init: Signal, running: list[Signal], signals: list[Signal]) -> Signal:
    """Return the last of the signals whose subsystem runs, else the previous value."""
    results: list[Signal] = []
    y = block.compiler.memories.delay_unconditionally(block, block.broadcast(init, *signals)[0], lambda: results[0])
    for runs, signal in zip(running, signals, strict=True):
        y = block.select(runs, signal, y)
    results.append(y)
    return y


def _initial_merge_value(block: BlockContext, sources: Sequence[SignalSource]) -> Signal:
    """Return the initial value of a Merge: its own, else the last one of its inputs that has one."""
    stating = [
        block,
        *(
            block.compiler.block_context(source.flat)
            for source in reversed(sources)
            if source.flat.type == "ConditionalOutput"
        ),
    ]
    for context in stating:
        if (stated := context.initial_output()) is not None:
            return stated
    return block.constant(0.0)


def _runs(block: BlockContext, source: SignalSource) -> Signal:
    if source.flat.type != "ConditionalOutput" or source.flat.control is None:
        raise UnsupportedError(f"its input from {source.flat.path} is not the output of a conditional subsystem")
    return block.compiler.signal(SignalSource(source.flat.control, 0))


@block("If", IfExpression="u1 > 0", ElseIfExpressions="", ShowElse="on", NumInputs="1", SampleTime="-1")
def if_block(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return 1 at the output of the first condition that holds."""
    texts = [
        block.field_text("IfExpression"),
        *(t for t in block.field_text("ElseIfExpressions").split(",") if t.strip()),
    ]
    names = {f"u{at + 1}": block.input(at).nodes.reshape(-1, 1) for at in range(block.input_count)}
    outputs: list[SignalOrBus] = []
    none = block.constant(1.0)
    for text in texts:
        try:
            nodes = block.compiler.expressions.array(text, block.flat.scope, names=names)
        except EvaluationError as error:
            raise UnsupportedError(
                f"its condition {text[:60]} is not supported: {error}", undefined=error.undefined
            ) from None
        if nodes.size != 1:
            raise UnsupportedError(f"its condition {text[:60]} must be scalar, got {nodes.size} values")
        holds = Signal(nodes.ravel(), fastest_sample_time([signal.period for signal in block.inputs]))
        outputs.append(block.apply("and", none, holds))
        none = block.apply("and", none, block.apply("not", holds))
    return (*outputs, none) if block.is_on("ShowElse") else tuple(outputs)


@block("SwitchCase", CaseConditions="{1}", ShowDefaultCase="on", CaseShowDefault="on", SampleTime="-1")
def switch_case(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return 1 at the output of the case that contains the input, or at the default output."""
    u = block.truncate(block.input())
    outputs: list[SignalOrBus] = []
    none = block.constant(1.0)
    for cases in case_values(block, "CaseConditions"):
        holds = block.is_among(u, cases)
        outputs.append(block.apply("and", none, holds))
        none = block.apply("and", none, block.apply("not", holds))
    return (*outputs, none)


@block("Function-Call Generator", sample_time="1", numberOfIterations="1")
def function_call_generator(block: BlockContext) -> SignalOrBus:
    """Return a function call at each sample hit."""
    if block.numeric_field("numberOfIterations") != 1:
        raise UnsupportedError("it issues several calls in a step, which is not supported")
    return block.compiler.timing.hits(block.numeric_field("sample_time"))


@block("ForIterator", IterationLimit="5", IterationSource="internal", IndexMode="One-based", ResetStates="held")
def for_iterator(block: BlockContext) -> SignalOrBus:
    """Return the iteration number."""
    _in_passes(block, bool(block.flat.passes))
    if block.field_text("IterationSource") == "external":
        _count(block, _fixed(block))
    return block.constant(block.flat.passes[-1] - (block.field_text("IndexMode") == "Zero-based"))


def _fixed(block: BlockContext) -> float:
    """Return the constant iteration count at the input."""
    signal = block.input()
    value = block.builder.value(signal.flat[0]) if signal.size == 1 else None
    source = block.source()
    if value is None and source is not None and source.flat.type == "Constant":
        try:
            numbers = block.compiler.expressions.numbers(source.flat.block.value("Value") or "1", source.flat.scope)
        except EvaluationError as error:
            raise UnsupportedError(f"its iteration count has no value: {error}", undefined=error.undefined) from None
        value = float(numbers.item()) if numbers.size == 1 else None
    if value is None:
        remedy = "Feed it from a Constant block, or set the iteration limit in the block itself."
        raise UnsupportedError("its iteration count is not constant", remedy)
    return value


def _count(block: BlockContext, value: float) -> None:
    """Record the iteration count of a subsystem; if it was flattened with another one, it is flattened again."""
    if not (value.is_integer() and 1 <= value <= _MAX_ITERATIONS):
        raise UnsupportedError(
            f"it requires {value:g} iterations in a step; it must be between 1 and {_MAX_ITERATIONS:g}"
        )
    block.compiler.note_iteration_count(join_path(*split_path(block.flat.path)[:-1]), int(value))


def _in_passes(block: BlockContext, inside: bool) -> None:
    if not inside:
        raise UnsupportedError("its subsystem is iterated", "Import the enclosing system.")


@block("WhileIterator", needs=no_feedthrough)
def while_iterator(block: BlockContext) -> SignalOrBus:
    """Return the iteration number."""
    _in_passes(block, bool(block.flat.passes))
    return block.constant(float(block.flat.passes[-1]))


@block("IterationCondition")
def iteration(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the condition and the reset condition of an iteration."""
    active = block.constant(1.0)
    for signal in block.inputs:
        active = block.apply(
            "and", active, block.apply("ne", block.compiler.timing.hold_in_minor_steps(signal), block.constant(0.0))
        )
    before = block.flat.previous_pass
    said = block.compiler.value(SignalSource(before, 0)) if before is not None else None
    outer = block.compiler.gates.run_condition(block.flat)
    if block.flat.passes[-1] > 1 and isinstance(said, Signal):
        active = block.apply("and", said, active)
    elif outer is not None:
        active = block.apply("and", scalar(outer), active)
    return active, reset_condition(block, active)


@block("IterationOutput", InitialOutput="[]")
def iterated(block: BlockContext) -> SignalOrBus:
    """Return the output of the last iteration that runs, or of the previous step if none does."""
    if block.input_count == 1:
        return block.input_or_bus(0)
    passes = [block.input(at) for at in range(1, block.input_count, 2)]
    return _last_pass(block, [block.input_or_bus(at) for at in range(0, block.input_count, 2)], passes)


def _last_pass(block: BlockContext, outputs: list[SignalOrBus], passes: list[Signal]) -> SignalOrBus:
    if isinstance(outputs[0], Bus):
        members = {name: [_member(output, name) for output in outputs] for name in outputs[0].members}
        return Bus({name: _last_pass(block, signals, passes) for name, signals in members.items()})
    signals = [signal for signal in outputs if isinstance(signal, Signal)]
    results: list[Signal] = []
    y = signals[0]
    if block.builder.value(passes[0].flat[0]) != 1:
        init = block.initial_output() or block.constant(0.0)
        init = Signal(fit_to_shape(init.nodes, y.shape))
        y = block.select(passes[0], y, block.compiler.memories.delay_unconditionally(block, init, lambda: results[0]))
    for active, signal in zip(passes[1:], signals[1:], strict=True):
        y = block.select(active, signal, y)
    results.append(y)
    return y


def _member(wired: SignalOrBus, name: str) -> SignalOrBus:
    assert isinstance(wired, Bus)
    return wired.members[name]


@block("ForEach", needs=no_feedthrough, IndexMode="Zero-based")
def for_each(block: BlockContext) -> SignalOrBus:
    """Return the element number."""
    _in_passes(block, block.flat.element > 0)
    return block.constant(block.flat.element - (block.field_text("IndexMode") == "Zero-based"))


@block("ForEachPartition")
def part(block: BlockContext) -> SignalOrBus:
    """Return the part of a signal that belongs to an element."""
    each, number = _each(block)
    width, dimension = _setting(each, "InputPartitionWidth", number), _setting(each, "InputPartitionDimension", number)
    if _setting(each, "InputPartitionOffset", number, 0):
        raise UnsupportedError("its partitions overlap or leave gaps, which is not supported")
    x = block.input()
    if not 1 <= dimension <= len(x.shape):
        raise UnsupportedError(f"it is partitioned along dimension {dimension}, which its signal does not have")
    length = x.shape[dimension - 1]
    if length % width:
        raise UnsupportedError(f"its {length} elements cannot be partitioned into parts of {width}")
    count, element = length // width, block.flat.element - 1
    if (each.value("SpecifiedNumIters") or "-1").strip() == "-1":
        _count(block, float(count))
        element %= count  # an earlier attempt may have had more elements
    if element >= count:
        raise UnsupportedError(f"it has {count} elements, fewer than the iterations")
    start = element * width
    return Signal(np.take(x.nodes, range(start, start + width), axis=dimension - 1), x.period)


def _each(block: BlockContext) -> tuple[ModelBlock, int]:
    """Return the For Each block that describes a port's partition or concatenation, and the port number."""
    each = block.flat.control_ports.get("each")
    if each is None:
        raise UnsupportedError("it is not a port of a For Each subsystem")
    return each, port_number(block.flat.block)


def _setting(each: ModelBlock, name: str, number: int, otherwise: int = 1) -> int:
    listed = each.listed(name)
    text = listed[number - 1].strip() if number <= len(listed) else ""
    if text and not text.isdecimal():
        raise UnsupportedError(f"{name} must be an integer, got {text[:40]}")
    return int(text) if text else otherwise


@block("ForEachConcatenation")
def together(block: BlockContext) -> SignalOrBus:
    """Concatenate the outputs of all elements along a dimension."""
    each, number = _each(block)
    if "off" in each.listed("OutputConcatenation")[number - 1 : number]:
        raise UnsupportedError("its elements are not concatenated, which is not supported")
    dimension = _setting(each, "OutputConcatenationDimension", number)
    parts = block.inputs
    if len({signal.shape for signal in parts}) > 1 or dimension not in (1, 2):
        raise UnsupportedError(f"its elements cannot be concatenated along dimension {dimension}")
    arrays = [
        signal.nodes.reshape(-1, 1) if dimension == 2 and signal.nodes.ndim == 1 else signal.nodes for signal in parts
    ]
    return Signal(np.concatenate(arrays, axis=dimension - 1), fastest_sample_time([signal.period for signal in parts]))
