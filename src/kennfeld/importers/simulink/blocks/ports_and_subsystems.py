"""Ports & Subsystems library: ports, bound blocks, sinks, conditional and iterated subsystems."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from kennfeld.importers.simulink.blocks.bus_values import fit_to_bus, fit_to_dimensions
from kennfeld.importers.simulink.blocks.continuous import reset_signal
from kennfeld.importers.simulink.flattening.flat_model import (
    RECORDING_TYPES,
    SINK_TYPES,
    FlatBlock,
    SignalSource,
    resets_on_enable,
)
from kennfeld.importers.simulink.lowering import (
    LIKE_INPUT,
    BlockContext,
    Outputs,
    OutputType,
    UnsupportedError,
    block,
    evaluating,
    no_feedthrough,
)
from kennfeld.importers.simulink.lowering.bus_structure import MAX_ELEMENTS
from kennfeld.importers.simulink.lowering.parameter_fields import case_values
from kennfeld.importers.simulink.lowering.pass_state import undefined_reason
from kennfeld.importers.simulink.reader.block_ports import port_number
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import ModelBlock, join_path, split_path
from kennfeld.importers.simulink.signals import (
    CONTINUOUS,
    Bus,
    InputWidth,
    Signal,
    SignalOrBus,
    apply,
    as_signal,
    broadcast,
    fit_to_shape,
    map_members,
    period_of,
    select,
)
from kennfeld.importers.simulink.variables.data_types import BusElement, BusType, UndefinedType
from kennfeld.models.imperative.node_arrays import reduce_nodes

_MAX_ITERATIONS = 1000.0
_DASHBOARD = (
    "CallbackButton", "Checkbox", "CircularGaugeBlock", "ComboBox", "CustomWebBlock", "DashboardScope", "DisplayBlock",
    "EditField", "KnobBlock", "LampBlock", "LinearGaugeBlock", "MultiStateImageBlock", "PanelWebBlock",
    "PushButtonBlock", "QuarterGaugeBlock", "RadioButtonGroup", "RockerSwitchBlock", "RotarySwitchBlock",
    "SemiCircularGaugeBlock", "SliderBlock", "SliderSwitchBlock", "ToggleSwitchBlock",
)  # fmt: skip


@block("From", PortDimensions="-1", SampleTime="-1")
@block("Inport", output=OutputType(floating=True, states=True), PortDimensions="-1", SampleTime="-1")
def inport(block: BlockContext) -> SignalOrBus:
    """Return an input of the model: one channel per element of a vector, one per used signal of a bus."""
    if block.is_on("OutputFunctionCall"):
        return _call_every_step(block)
    inputs, kind = block.compiler.inputs, block.output_type
    # a From without a Goto is an input as well
    if block.flat.type != "Inport":
        return inputs.open_signal(block.flat, inputs.name(block.flat), "it comes from outside of the system")
    if isinstance(kind, BusType):
        return inputs.bus(block.flat, kind)
    if isinstance(kind, UndefinedType) and kind.is_bus:
        return inputs.open_bus(block.flat, undefined_reason(kind))
    shape = _stated_shape(block, "PortDimensions")
    if not shape and isinstance(kind, BusElement):
        shape = kind.dimensions or ()
    if not shape:
        # -1 is inherited: a scalar, or what a block downstream suggests
        return inputs.open_signal(block.flat, inputs.name(block.flat), "its port inherits it")
    _limit_size(shape)
    name = inputs.name(block.flat)
    return inputs.signal(name, shape, InputWidth(name, math.prod(shape), "its port"))


def _call_every_step(block: BlockContext) -> SignalOrBus:
    """Return a function call from outside of the model at each sample hit of its port, by default in every step."""
    period = block.compiler.timing.specified_period(block.flat) or CONTINUOUS
    calls = block.compiler.timing.hits(0.0 if math.isinf(period) else period)
    rhythm = f"every {period:g} s" if calls.period else "in every step"
    block.warn(
        f"is a function call from outside of the model: it is called {rhythm}. To call it otherwise, bind it to a "
        "channel or formula that is not 0 in the steps of its calls"
    )
    return calls


@block(*RECORDING_TYPES, sink=True, VariableName="simulink_output", SampleTime="0")
@block("Outport", output=LIKE_INPUT, SampleTime="-1")
def result(block: BlockContext) -> SignalOrBus:
    """Pass on a result of the model; of a bus whose object is unknown, it is a single signal."""
    return _as_specified(block, as_signal(block.input_or_bus(0)), "PortDimensions")


@block("SignalSpecification", output=LIKE_INPUT, Dimensions="-1")
def signal_specification(block: BlockContext) -> SignalOrBus:
    """Pass on a signal of the specified dimensions, which an inherited width of an input takes over."""
    return _as_specified(block, block.input_or_bus(0), "Dimensions")


def _stated_shape(block: BlockContext, field: str) -> tuple[int, ...]:
    """Return the dimensions that a field specifies, () for -1, with which they are inherited."""
    return tuple(int(n) for n in block.numeric_array(field, "-1").ravel() if n > 0)


def _limit_size(shape: Sequence[int]) -> None:
    """Raise an error for a shape of more elements than there is memory for."""
    if math.prod(shape) > MAX_ELEMENTS:
        raise UnsupportedError(f"it has {math.prod(shape)} elements; at most {MAX_ELEMENTS} are supported")


def _as_specified(block: BlockContext, wired: SignalOrBus, field: str) -> SignalOrBus:
    """Return a signal in the dimensions of a field, or a bus as its object specifies."""
    if isinstance(block.output_type, BusType) and isinstance(wired, Bus):
        return fit_to_bus(block, block.output_type, wired)
    shape = _stated_shape(block, field)
    # what has dimensions is not a bus
    wired = as_signal(wired) if shape else wired
    if not shape or not isinstance(wired, Signal):
        return wired
    _limit_size(shape)
    return fit_to_dimensions(block, wired, shape, "its input", f"its {field}")


@block("SignalConversion", output=LIKE_INPUT)
@block("Environment Controller", linked=True)  # its first input is the one used in simulation
def pass_on(block: BlockContext) -> SignalOrBus:
    """Pass on the first input."""
    return block.input_or_bus(0)


@block("BoundBlock", needs=no_feedthrough)
def bound(block: BlockContext) -> Outputs:
    """Return the signals bound in place of a block."""
    return block.compiler.bound(block.compiler, block.flat)


@block("CMBlock", linked=True, needs=no_feedthrough, sink=True)
@block("DocBlock", needs=no_feedthrough, sink=True, library_mask=True)
@block(
    *_DASHBOARD, "Terminator", "Stop", "Floating Scope", "Assertion", "Model Info",
    "DataTypeDuplicate", "DataTypePropagation", "EventListener", "HitCross Sink", "Note",
    needs=no_feedthrough, sink=True,
)  # fmt: skip
def sink(block: BlockContext) -> SignalOrBus:
    """Lower a sink that only displays or checks; it has no output."""
    return block.constant()


@block(*SINK_TYPES, sink=True)
def display(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the signals that the block displays or writes."""
    return tuple(block.input_or_bus(at) for at in range(block.input_count))


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
        conditions["outer"] = block.signal([outer])
    # a subsystem runs if all of its ports allow it, and the subsystem around it runs
    active = _all(block, list(conditions.values()))
    if "trigger" not in conditions:
        return active, reset_condition(block, active)
    # without the enable port, which a trigger only samples
    triggered = _all(block, [conditions[port] for port in ("trigger", "outer") if port in conditions])
    return active, reset_condition(block, active, triggered)


def _control_input(block: BlockContext, port: str) -> Signal:
    """Return the signal at a control port; the control ports are the inputs, in order."""
    return block.input(list(block.flat.control_ports).index(port))


def _all(block: BlockContext, conditions: list[Signal]) -> Signal:
    return block.hold_in_minor_steps(block.reduce("and", conditions or [block.constant(1.0)]))


def reset_condition(block: BlockContext, active: Signal, triggered: Signal | None = None) -> Signal:
    """Return 1 if the states of a subsystem are reset: by an enclosing subsystem, by enabling, or by a reset port.

    `triggered` is the trigger of a triggered subsystem, at which its enable port is evaluated.
    """
    around = block.compiler.gates.reset_condition(block.flat)
    events = [] if around is None else [block.signal([around])]
    if resets_on_enable(block.flat):
        events.append(_enabled_again(block, active, triggered))
    if "reset" in block.flat.control_ports:
        port = block.flat.control_ports["reset"]
        events.append(reset_signal(block, _control_input(block, "reset"), port.value("ResetTriggerType") or "level"))
    return block.reduce("or", events)


def _enabled_again(block: BlockContext, active: Signal, triggered: Signal | None) -> Signal:
    """Return 1 if a subsystem runs and was disabled at the previous evaluation."""
    earlier: list[Signal] = []

    def evaluate(before: Signal) -> Signal:
        earlier.append(before)
        return active if triggered is None else select(triggered, active, before)

    # unconditional, because it must see the steps in which the subsystem does not run
    block.unconditional_feedback(block.constant(0.0), evaluate)
    return active & ~earlier[0]


def _condition(block: BlockContext, port: str, u: Signal) -> Signal:
    if port == "enable":
        return _any(block, u > 0.0)
    written = block.flat.control_ports[port].value("TriggerType") or "rising"
    kind = match_word(written, ("rising", "falling", "either", "function-call"))
    if port == "ifaction" or kind == "function-call":
        if u.size > 1:
            remedy = "Use a separate subsystem for each caller."
            raise UnsupportedError(f"its {port} port receives {u.size} function calls, which is not supported", remedy)
        return apply("ne", u, 0.0)
    if kind is None:
        raise UnsupportedError(f"TriggerType {written[:60]!r} is not supported")
    # Simulink looks for edges at major steps only, not within a step of the solver
    return _any(block, block.zero_crossing(block.hold_in_minor_steps(u), kind))


def _any(block: BlockContext, truths: Signal) -> Signal:
    """Return 1 if any element of a control signal is true."""
    return block.signal([reduce_nodes(block.builder, "or", truths.flat)], truths.period)


@block("ConditionalOutput", output=OutputType((0,)), InitialOutput="[]", OutputWhenDisabled="held")
def conditional_output(block: BlockContext) -> SignalOrBus:
    """Pass on an output of a conditional subsystem while it runs; else hold it, or set it to the initial value."""
    return map_members(lambda signal: _hold_output(block, signal), "", block.input_or_bus(0))


def _hold_output(block: BlockContext, signal: Signal) -> Signal:
    active, control = block.compiler.gates.run_condition(block.flat), block.flat.control
    stated = block.initial_output() or block.constant(0.0)
    if active is None:
        return signal
    runs = block.signal([active], signal.period)
    init = block.signal(fit_to_shape(stated.nodes, signal.shape))
    # between triggers, outputs are held whatever the setting
    resettable = control is not None and "trigger" not in control.control_ports
    if block.is_set_to("OutputWhenDisabled", "reset") and resettable:
        return select(runs, signal, init)
    return block.unconditional_feedback(init, lambda before: select(runs, signal, before))


@block("Merge", output=OutputType(states=True), Inputs="2", InitialOutput="[]")
def merge(block: BlockContext) -> SignalOrBus:
    """Pass on the output of the subsystem that ran last; if several run in a step, of the last of them."""
    sources = [source for source in block.flat.inputs if source is not None]
    init = _initial_merge_value(block, sources)
    running = [_runs(block, source) for source in sources]
    arriving = [block.compiler.value(source) for source in sources]

    def last_running(*signals: Signal) -> Signal:
        first = broadcast(init, *signals)[0]
        return block.unconditional_feedback(first, lambda before: _last_selected(before, running, signals))

    return map_members(last_running, "it merges buses with different signals", *arriving, ordered=True)


def _last_selected(y: Signal, conditions: Sequence[Signal], signals: Sequence[Signal]) -> Signal:
    """Return the last of the signals whose condition holds, `y` if none does."""
    for holds, signal in zip(conditions, signals, strict=True):
        y = select(holds, signal, y)
    return y


def _initial_merge_value(block: BlockContext, sources: Sequence[SignalSource]) -> Signal:
    """Return the initial value of a Merge: its own, else the last one of its inputs that has one."""
    conditional = [flat for flat in _merged(reversed(sources)) if flat.type in ("ConditionalOutput", "Merge")]
    for context in (block, *map(block.of, conditional)):
        if (stated := context.initial_output()) is not None:
            return stated
    return block.constant(0.0)


def _merged(sources: Iterable[SignalSource]) -> Iterator[FlatBlock]:
    """Yield the blocks before a Merge, those before another Merge among them included."""
    for source in sources:
        yield source.flat
        if source.flat.type == "Merge":
            yield from _merged(inner for inner in reversed(source.flat.inputs) if inner is not None)


def _runs(block: BlockContext, source: SignalSource) -> Signal:
    if source.flat.type == "Merge":
        # merges in a row are one: the first passes a new value on if one of its own inputs has one
        before = [inner for inner in source.flat.inputs if inner is not None]
        return block.reduce("or", [_runs(block, inner) for inner in before])
    if source.flat.type != "ConditionalOutput" or source.flat.control is None:
        raise UnsupportedError(f"its input from {source.flat.path} is not the output of a conditional subsystem")
    return block.compiler.signal(SignalSource(source.flat.control, 0))


@block("If", IfExpression="u1 > 0", ElseIfExpressions="", ShowElse="on", NumInputs="1", SampleTime="-1")
def if_block(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Set the output of the first condition that holds to 1, the others to 0."""
    others = [text for text in block.field_text("ElseIfExpressions").split(",") if text.strip()]
    names = {f"u{at + 1}": block.input(at).nodes.reshape(-1, 1) for at in range(block.input_count)}
    conditions: list[Signal] = []
    for text in (block.field_text("IfExpression"), *others):
        with evaluating(f"its condition {text[:60]} is not supported"):
            nodes = block.compiler.expressions.array(text, block.flat.scope, names=names)
        if nodes.size != 1:
            raise UnsupportedError(f"its condition {text[:60]} must be scalar, got {nodes.size} values")
        conditions.append(block.signal(nodes.ravel(), period_of(block.inputs)))
    outputs = _first_true(block, conditions)
    return outputs if block.is_on("ShowElse") else outputs[:-1]


def _first_true(block: BlockContext, conditions: Iterable[Signal]) -> tuple[Signal, ...]:
    """Return 1 for the first condition that holds, last 1 if none does."""
    outputs: list[Signal] = []
    none = block.constant(1.0)
    for holds in conditions:
        outputs.append(none & holds)
        none = none & ~holds
    return (*outputs, none)


@block("SwitchCase", CaseConditions="{1}", ShowDefaultCase="on", CaseShowDefault="on", SampleTime="-1")
def switch_case(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Set the output of the case that contains the input, or the default output, to 1, the others to 0."""
    # cases are integers, and Simulink cuts the control signal off towards 0
    u = block.truncate(block.input())
    return _first_true(block, [block.is_among(u, cases) for cases in case_values(block, "CaseConditions")])


@block("Function-Call Generator", sample_time="1", numberOfIterations="1")
def function_call_generator(block: BlockContext) -> SignalOrBus:
    """Return a function call at each sample hit."""
    if block.numeric_field("numberOfIterations") != 1:
        raise UnsupportedError("it issues several calls in a step, which is not supported")
    return block.compiler.timing.hits(block.numeric_field("sample_time"))


@block("FunctionCallSplit", NumOutputPorts="2")
def function_call_split(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Pass a function call on to all outputs; called systems run in the order of their data."""
    ports = block.flat.block.ports
    count = ports.outputs if ports is not None and ports.outputs else block.integer_field("NumOutputPorts", 1, 1000)
    return (block.input(),) * count


@block("ForIterator", IterationLimit="5", IterationSource="internal", IndexMode="One-based", ResetStates="held")
def for_iterator(block: BlockContext) -> SignalOrBus:
    """Return the iteration number."""
    _check_inside(bool(block.flat.passes))
    if block.is_set_to("IterationSource", "external"):
        _count(block, _constant_count(block))
    return block.constant(block.flat.passes[-1] - block.is_set_to("IndexMode", "Zero-based"))


def _constant_count(block: BlockContext) -> float:
    """Return the constant iteration count at the input."""
    signal = block.input()
    value = block.builder.value(signal.flat[0]) if signal.size == 1 else None
    source = block.source()
    # a variable in a Constant block is a parameter elsewhere; here its number is read as a constant
    if value is None and source is not None and source.flat.type == "Constant":
        with evaluating("its iteration count has no value"):
            numbers = block.compiler.expressions.numbers(source.flat.block.value("Value") or "1", source.flat.scope)
        value = float(numbers.item()) if numbers.size == 1 else None
    if value is None:
        remedy = "Feed it from a Constant block, or set the iteration limit in the block itself."
        raise UnsupportedError("its iteration count is not constant", remedy)
    return value


def _count(block: BlockContext, value: float) -> None:
    """Record the iteration count of a subsystem; if it was flattened with another one, it is flattened again."""
    if not (value.is_integer() and 1 <= value <= _MAX_ITERATIONS):
        limits = f"it must be between 1 and {_MAX_ITERATIONS:g}"
        raise UnsupportedError(f"it requires {value:g} iterations in a step; {limits}")
    path, counts = join_path(*split_path(block.flat.path)[:-1]), block.compiler.counts
    if counts.setdefault(path, int(value)) != value:
        raise UnsupportedError(f"its inputs require {counts[path]} and {value:.0f} iterations")


def _check_inside(inside: bool) -> None:
    if not inside:
        raise UnsupportedError("its subsystem is iterated", "Import the enclosing system.")


@block("WhileIterator", needs=no_feedthrough)
def while_iterator(block: BlockContext) -> SignalOrBus:
    """Return the iteration number."""
    _check_inside(bool(block.flat.passes))
    return block.constant(float(block.flat.passes[-1]))


@block("IterationCondition")
def iteration(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the condition and the reset condition of an iteration."""
    active = block.reduce("and", [block.constant(1.0), *map(block.is_true, range(block.input_count))])
    before = block.flat.previous_pass
    earlier = block.compiler.value(SignalSource(before, 0)) if before is not None else None
    outer = block.compiler.gates.run_condition(block.flat)
    if block.flat.passes[-1] > 1 and isinstance(earlier, Signal):
        # an iteration runs only if all before it did
        active = earlier & active
    elif outer is not None:
        active = block.signal([outer]) & active
    return active, reset_condition(block, active)


@block("IterationOutput", InitialOutput="[]")
def iteration_output(block: BlockContext) -> SignalOrBus:
    """Return the output of the last iteration that runs, or of the previous step if none does."""
    if block.input_count == 1:
        return block.input_or_bus(0)
    passes = [block.input(at) for at in range(1, block.input_count, 2)]
    outputs = [block.input_or_bus(at) for at in range(0, block.input_count, 2)]

    def last_pass(*signals: Signal) -> Signal:
        # a do-while loop always runs once, so that nothing from the step before is needed
        if block.builder.value(passes[0].flat[0]) == 1:
            return _last_selected(signals[0], passes, signals)
        init = block.initial_output() or block.constant(0.0)
        first = block.signal(fit_to_shape(init.nodes, signals[0].shape))
        return block.unconditional_feedback(first, lambda before: _last_selected(before, passes, signals))

    return map_members(last_pass, "its iterations have different buses", *outputs)


@block("ForEach", needs=no_feedthrough, IndexMode="Zero-based")
def for_each(block: BlockContext) -> SignalOrBus:
    """Return the element number."""
    _check_inside(block.flat.element > 0)
    return block.constant(block.flat.element - block.is_set_to("IndexMode", "Zero-based"))


@block("ForEachPartition")
def part(block: BlockContext) -> SignalOrBus:
    """Cut the part that belongs to an element out of a signal."""
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
    return block.signal(np.take(x.nodes, range(start, start + width), axis=dimension - 1), x.period)


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
def for_each_concatenation(block: BlockContext) -> SignalOrBus:
    """Concatenate the outputs of all elements along a dimension."""
    each, number = _each(block)
    if "off" in each.listed("OutputConcatenation")[number - 1 : number]:
        raise UnsupportedError("its elements are not concatenated, which is not supported")
    dimension = _setting(each, "OutputConcatenationDimension", number)
    parts = block.inputs
    if len({signal.shape for signal in parts}) > 1 or dimension not in (1, 2):
        raise UnsupportedError(f"its elements cannot be concatenated along dimension {dimension}")
    arrays = [signal.matrix if dimension == 2 else signal.nodes for signal in parts]
    return block.signal(np.concatenate(arrays, axis=dimension - 1), period_of(parts))
