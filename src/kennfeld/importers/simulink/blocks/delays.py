"""Delays by a number of samples: constant or variable, with enable and reset ports, tapped, or by one sample."""

from collections.abc import Callable, Iterable

from kennfeld.importers.simulink.blocks.bus_states import delay_members
from kennfeld.importers.simulink.blocks.bus_values import parameter_or_bus
from kennfeld.importers.simulink.blocks.continuous import external_reset, has_external_reset, reset_signal
from kennfeld.importers.simulink.lowering import LIKE_INPUT, BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.signals import (
    Signal,
    SignalOrBus,
    SignalRule,
    apply,
    period_of,
    select,
    select_by_index,
)

_MAX_STEPS = 2000  # of a delay with a separate state for each step

# one-sample delays by the inputs in order: u, E enables, R resets, IC and RV are initial values
_INPUTS = {
    "Unit Delay Enabled": "u E",
    "Unit Delay Resettable": "u R",
    "Unit Delay External IC": "u IC",
    "Unit Delay Enabled Resettable": "u E R",
    "Unit Delay Enabled External IC": "u E IC",
    "Unit Delay Resettable External IC": "u R IC",
    "Unit Delay Enabled Resettable External IC": "u E R IC",
    "Unit Delay With Preview Enabled": "u E",
    "Unit Delay With Preview Resettable": "u R",
    "Unit Delay With Preview Enabled Resettable": "u E R",
    "Unit Delay With Preview Resettable External RV": "u R RV",
    "Unit Delay With Preview Enabled Resettable External RV": "u E R RV",
}
_PREVIEWS = [name for name in _INPUTS if "Preview" in name]
_DELAYS = [name for name in _INPUTS if "Preview" not in name]


def _ports(block: BlockContext) -> dict[str, int]:
    """Return the port numbers of the inputs of a delay in addition to the signal."""
    # in the order of the ports
    present = {
        "length": block.option("DelayLengthSource", "Dialog", "Input port") == "Input port",
        "enable": block.is_on("ShowEnablePort"),
        "reset": has_external_reset(block),
        "init": not block.is_set_to("InitialConditionSource", "Dialog"),
    }
    return {name: at for at, name in enumerate((name for name, there in present.items() if there), 1)}


def _delay_needs(block: BlockContext) -> Iterable[int]:
    ports = _ports(block)
    shortest = _shortest(block) if "length" in ports else _steps(block, "DelayLength")
    return ports.values() if shortest else [0, *ports.values()]


def _steps(block: BlockContext, field: str) -> int:
    """Return the samples of a constant delay; a delay by none passes its input on."""
    return block.integer_field(field, 0, 100_000)


def _shortest(block: BlockContext) -> int:
    return 1 if block.is_on("PreventDirectFeedthrough") else 0


@block("Delay", output=LIKE_INPUT,
       needs=_delay_needs, DelayLength="2", DelayLengthSource="Dialog", DelayLengthUpperLimit="100",
       InitialCondition="0.0", InitialConditionSource="Dialog", ExternalReset="None", ShowEnablePort="off",
       PreventDirectFeedthrough="off", SampleTime="-1")  # fmt: skip
def delay(block: BlockContext) -> SignalOrBus:
    """Delay the input by a number of samples."""
    ports = _ports(block)
    if not ports:
        steps = _steps(block, "DelayLength")
        start = parameter_or_bus(block, "InitialCondition")
        return delay_members(block, start, lambda init, arriving: _delay_by(block, init, steps, arriving))
    init = block.input(ports["init"]) if "init" in ports else block.parameter("InitialCondition")
    if "length" not in ports:
        steps = _steps(block, "DelayLength")
        if "enable" not in ports and "reset" not in ports:
            return _delay_by(block, init, steps, block.input)
        return _controlled_delay(block, ports, init, steps, None)
    steps = block.integer_field("DelayLengthUpperLimit", 1, _MAX_STEPS)
    if init.size != 1 and steps != 1:
        raise UnsupportedError("it has several initial values but a variable delay length")
    return _controlled_delay(block, ports, init, steps, apply("floor", block.input(ports["length"])))


@block("Integer Delay", "IntegerDelay", needs=lambda block: range(not _steps(block, "NumDelays")), sample="samptime",
       NumDelays="4", vinit="0.0", samptime="-1", InitialCondition="0.0")  # fmt: skip
def integer_delay(block: BlockContext) -> SignalOrBus:
    """Delay the input by a number of samples (block of older releases)."""
    init = block.parameter(block.field_name("InitialCondition", "vinit"))
    return _delay_by(block, init, _steps(block, "NumDelays"), block.input)


def _delay_by(block: BlockContext, init: Signal, steps: int, arriving: Callable[[], Signal]) -> Signal:
    if steps == 0:
        return arriving()
    # one state that is read `steps` steps later; a block that skips steps needs a state for each of its samples
    if init.size == 1 and block.compiler.gates.is_written_every_step(block.flat):
        return block.discrete_state(init, lambda _: arriving(), steps)
    return _taps(block, init, steps, None, None, arriving)[-1]


def _initial_content(init: Signal, steps: int) -> list[Signal]:
    """Return the initial contents, latest first; of several initial values, the first is output first."""
    if init.size == 1 or steps == 1:
        return [init] * steps
    if init.size != steps:
        raise UnsupportedError(f"it has {init.size} initial values for a delay of {steps} steps")
    return init.elements[::-1]


def _taps(
    block: BlockContext,
    init: Signal,
    steps: int,
    runs: Signal | None,
    anew: Signal | None,
    arriving: Callable[[], Signal] | None = None,
) -> list[Signal]:
    """Return the inputs of the last samples, latest first; they shift while `runs` holds and are reset by `anew`."""
    if steps > _MAX_STEPS:
        states = f"a separate state for each of its {steps} steps"
        raise UnsupportedError(f"it needs {states}; at most {_MAX_STEPS} are supported")
    taps: list[Signal] = []
    arriving = arriving or block.input

    def following(at: int) -> SignalRule:
        def then(_: Signal) -> Signal:
            # shift register: tap 0 takes the input, each other one what the tap before it held
            new = arriving() if at == 0 else taps[at - 1]
            return new if runs is None else select(runs, new, taps[at])

        return then

    for at, first in enumerate(_initial_content(init, steps)):
        signal = block.discrete_state(first, following(at))
        taps.append(signal if anew is None else select(anew, first, signal))
    return taps


def _controlled_delay(
    block: BlockContext, ports: dict[str, int], init: Signal, steps: int, length: Signal | None
) -> Signal:
    runs = block.is_true(ports["enable"]) if "enable" in ports else None
    anew = _restarts(block, ports, runs)
    taps = _taps(block, init, steps, runs, anew)
    shortest = _shortest(block)
    # nothing to refill in a delay by 0 samples, which an enable port may hold all the same
    y = taps[-1] if taps else block.input(0)
    if length is not None:
        # length n selects tap n - 1; without PreventDirectFeedthrough, length 0 selects the input
        y = select_by_index(length, taps if shortest else [block.input(0), *taps], shortest + 1.0)
    if runs is None:
        return y
    return block.feedback(block.constant(0.0), lambda before: select(runs, y, before))  # 0 before it first runs


def _restarts(block: BlockContext, ports: dict[str, int], runs: Signal | None) -> Signal | None:
    """Return 1 if the content is reset: by the reset port, and when the block is enabled again.

    A disabled block does not see its reset port, so an edge is one between two steps in which the block runs.
    """
    if runs is None:
        return external_reset(block, port=ports["reset"]) if "reset" in ports else None
    again = runs & ~block.discrete_state(block.constant(0.0), lambda _: runs)
    if "reset" not in ports:
        return again
    u = block.hold_in_minor_steps(block.input(ports["reset"]))
    seen = block.feedback(u, lambda before: select(runs, u, before))
    return again | runs & reset_signal(block, seen, block.field_text("ExternalReset"))


@block("Tapped Delay Line", "Tapped Delay", needs=lambda block: range(block.is_on("includeCurrent")),
       sample="samptime", linked=True, NumDelays="4", vinit="0.0", samptime="-1", DelayOrder="Oldest",
       includeCurrent="off")  # fmt: skip
def tapped_delay(block: BlockContext) -> SignalOrBus:
    """Return a vector of the inputs of the last samples, oldest or newest first."""
    init, steps = block.parameter("vinit"), block.integer_field("NumDelays", 1, _MAX_STEPS)
    if init.size != 1:
        raise UnsupportedError("it has several initial values, which is not supported")
    taps = _taps(block, init, steps, None, None)
    # the samples before change at major steps only; the present one must not move between them
    if block.is_on("includeCurrent"):
        taps = [block.hold_in_minor_steps(block.input()), *taps]
    if any(tap.size != 1 for tap in taps):
        raise UnsupportedError("its input is a vector, which is not supported")
    newest = block.option("DelayOrder", "Oldest", "Newest") == "Newest"
    nodes = [tap.flat[0] for tap in (taps if newest else reversed(taps))]
    return block.signal(nodes, period_of(taps))


def _inputs(block: BlockContext) -> dict[str, int]:
    return {name: at for at, name in enumerate(_INPUTS[block.flat.type].split())}


@block(
    *_DELAYS,
    needs=lambda block: [at for name, at in _inputs(block).items() if name == "IC"],
    sample="tsamp",
    linked=True,
    vinit="0.0",
    tsamp="-1",
)
def unit_delay_variant(block: BlockContext) -> SignalOrBus:
    """Delay the input by one sample; hold it while disabled, and set it to the initial value by a reset."""
    ports = _inputs(block)
    init = block.input(ports["IC"]) if "IC" in ports else block.parameter("vinit")
    return block.discrete_state(init, lambda y: _next_content(block, ports, y, init))


@block(*_PREVIEWS, sample="tsamp", linked=True, vinit="0.0", tsamp="-1")
def unit_delay_with_preview(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the next and the present content of a unit delay."""
    ports, init, signals = _inputs(block), block.parameter("vinit"), list[Signal]()
    anew = block.input(ports["RV"]) if "RV" in ports else init
    # the first output is the content of the next sample, which the state then takes
    y = block.discrete_state(init, lambda _: signals[0])
    signals.append(_next_content(block, ports, y, anew))
    return signals[0], y


def _next_content(block: BlockContext, ports: dict[str, int], y: Signal, init: Signal) -> Signal:
    """Return the next content: the input while enabled, the initial value on reset."""
    new = block.hold_in_minor_steps(block.input(0))
    if "E" in ports:
        new = select(block.is_true(ports["E"]), new, y)
    return select(block.is_true(ports["R"]), init, new) if "R" in ports else new
