"""Delays by a number of samples: constant or variable, with enable and reset ports, tapped, or by one sample."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.models.simulink.blocks.continuous import external_reset, reset_signal
from kennfeld.models.simulink.lowering.block_context import BlockContext, Then
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import Signal, SignalOrBus, fastest_sample_time

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


@dataclass(frozen=True)
class _Ports:
    """Port numbers of the inputs of a delay in addition to the signal; None if a port does not exist."""

    length: int | None
    enable: int | None
    reset: int | None
    init: int | None


def _ports(block: BlockContext) -> _Ports:
    has = (
        block.option("DelayLengthSource", "Dialog", "Input port") == "Input port",
        block.is_on("ShowEnablePort"),
        external_reset(block) != "none",
        block.field_text("InitialConditionSource") != "Dialog",
    )
    numbers = [1 + sum(has[:at]) if there else None for at, there in enumerate(has)]
    return _Ports(*numbers)


def _delay_needs(block: BlockContext) -> Iterable[int]:
    ports = _ports(block)
    others = [at for at in (ports.length, ports.enable, ports.reset, ports.init) if at is not None]
    through = block.field_text("DelayLength").strip() == "0" if ports.length is None else _shortest(block) == 0
    return [0, *others] if through else others


def _shortest(block: BlockContext) -> int:
    return 1 if block.is_on("PreventDirectFeedthrough") else 0


@block("Delay", needs=_delay_needs, DelayLength="2", DelayLengthSource="Dialog", DelayLengthUpperLimit="100",
       InitialCondition="0.0", InitialConditionSource="Dialog", ExternalReset="None", ShowEnablePort="off",
       PreventDirectFeedthrough="off", SampleTime="-1")  # fmt: skip
def delay(block: BlockContext) -> SignalOrBus:
    """Return the input of a number of samples ago."""
    ports = _ports(block)
    init = block.parameter("InitialCondition") if ports.init is None else block.input(ports.init)
    if ports.length is None:
        steps = block.integer_field("DelayLength", 0, 100_000)
        if ports.enable is None and ports.reset is None:
            return _delayed(block, init, steps)
        return _controlled_delay(block, ports, init, steps, None)
    steps = block.integer_field("DelayLengthUpperLimit", 1, _MAX_STEPS)
    if init.size != 1 and steps != 1:
        raise UnsupportedError("it has several initial values but a variable delay length")
    return _controlled_delay(block, ports, init, steps, block.apply("floor", block.input(ports.length)))


@block(
    "Integer Delay", "IntegerDelay", needs=no_feedthrough,
    sample="samptime", NumDelays="4", vinit="0.0", samptime="-1", InitialCondition="0.0",
)  # fmt: skip
def integer_delay(block: BlockContext) -> SignalOrBus:
    """Return the input of a number of samples ago (block of older releases)."""
    key = "vinit" if block.flat.block.value("InitialCondition") is None else "InitialCondition"
    return _delayed(block, block.parameter(key), block.integer_field("NumDelays", 0, 100_000))


def _delayed(block: BlockContext, init: Signal, steps: int) -> Signal:
    if steps == 0:
        return block.input()
    if init.size == 1 and block.compiler.gates.is_written_every_step(block.flat):
        return block.discrete_state(init, lambda _: block.input(), steps)
    return _taps(block, init, steps, None, None)[-1]


def _initial_content(init: Signal, steps: int) -> list[Signal]:
    """Return the initial contents, latest first; of several initial values, the first is output first."""
    if init.size == 1 or steps == 1:
        return [init] * steps
    if init.size != steps:
        raise UnsupportedError(f"it has {init.size} initial values for a delay of {steps} steps")
    return init.elements[::-1]


def _taps(block: BlockContext, init: Signal, steps: int, runs: Signal | None, anew: Signal | None) -> list[Signal]:
    """Return the inputs of the last samples, latest first; they shift while `runs` holds and are reset by `anew`."""
    if steps > _MAX_STEPS:
        raise UnsupportedError(
            f"it needs a separate state for each of its {steps} steps; at most {_MAX_STEPS} are supported"
        )
    taps: list[Signal] = []

    def following(at: int) -> Then:
        def then(_: Signal) -> Signal:
            new = block.input(0) if at == 0 else taps[at - 1]
            return new if runs is None else block.select(runs, new, taps[at])

        return then

    for at, first in enumerate(_initial_content(init, steps)):
        signal = block.discrete_state(first, following(at))
        taps.append(signal if anew is None else block.select(anew, first, signal))
    return taps


def _controlled_delay(block: BlockContext, ports: _Ports, init: Signal, steps: int, length: Signal | None) -> Signal:
    if ports.enable is not None and ports.reset is not None:
        raise UnsupportedError("it has both an enable port and a reset port, which is not supported")
    runs = anew = None
    if ports.reset is not None:
        anew = reset_signal(block, block.input(ports.reset), external_reset(block))
    if ports.enable is not None:
        runs = block.apply("ne", block.hold_in_minor_steps(block.input(ports.enable)), block.constant(0.0))
        ran = block.discrete_state(block.constant(0.0), lambda _: runs)
        anew = block.apply("and", runs, block.apply("not", ran))
    taps = _taps(block, init, steps, runs, anew)
    y = taps[-1] if length is None else _select_tap(block, taps, length)
    return y if runs is None else _hold_output(block, runs, y)


def _select_tap(block: BlockContext, taps: Sequence[Signal], length: Signal) -> Signal:
    """Select the tap of a length, clipped to the available taps."""
    y = taps[-1]
    for steps in range(len(taps) - 1, _shortest(block) - 1, -1):
        value = block.input(0) if steps == 0 else taps[steps - 1]
        y = block.select(block.apply("lt", length, block.constant(steps + 1.0)), value, y)
    return y


def _hold_output(block: BlockContext, runs: Signal, y: Signal) -> Signal:
    """Hold the output of a block while it is disabled; 0 before it first runs."""
    signals: list[Signal] = []
    before = block.discrete_state(block.constant(0.0), lambda _: signals[0])
    signals.append(block.select(runs, y, before))
    return signals[0]


def _tapped_needs(block: BlockContext) -> Iterable[int]:
    return (0,) if block.is_on("includeCurrent") else ()


@block("Tapped Delay Line", "Tapped Delay", needs=_tapped_needs, sample="samptime", linked=True, NumDelays="4",
       vinit="0.0", samptime="-1", DelayOrder="Oldest", includeCurrent="off")  # fmt: skip
def tapped_delay(block: BlockContext) -> SignalOrBus:
    """Return a vector of the inputs of the last samples, oldest or newest first."""
    init, steps = block.parameter("vinit"), block.integer_field("NumDelays", 1, _MAX_STEPS)
    if init.size != 1:
        raise UnsupportedError("it has several initial values, which is not supported")
    taps = _taps(block, init, steps, None, None)
    if block.is_on("includeCurrent"):
        taps = [block.hold_in_minor_steps(block.input()), *taps]
    if any(tap.size != 1 for tap in taps):
        raise UnsupportedError("its input is a vector, which is not supported")
    newest = block.option("DelayOrder", "Oldest", "Newest") == "Newest"
    nodes = [tap.flat[0] for tap in (taps if newest else reversed(taps))]
    return Signal(np.array(nodes, dtype=np.int64), fastest_sample_time([tap.period for tap in taps]))


def _inputs(block: BlockContext) -> dict[str, int]:
    return {name: at for at, name in enumerate(_INPUTS[block.flat.type].split())}


def _initial_needs(block: BlockContext) -> Iterable[int]:
    return [at for name, at in _inputs(block).items() if name == "IC"]


@block(*_DELAYS, needs=_initial_needs, sample="tsamp", linked=True, vinit="0.0", tsamp="-1")
def unit_delay_variant(block: BlockContext) -> SignalOrBus:
    """Return the input of the previous sample, held while disabled and set to the initial value by a reset."""
    ports = _inputs(block)
    init = block.input(ports["IC"]) if "IC" in ports else block.parameter("vinit")
    return block.discrete_state(init, lambda y: _next_content(block, ports, y, init))


@block(*_PREVIEWS, sample="tsamp", linked=True, vinit="0.0", tsamp="-1")
def unit_delay_with_preview(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the next and the present content of a unit delay."""
    ports, init, signals = _inputs(block), block.parameter("vinit"), list[Signal]()
    anew = block.input(ports["RV"]) if "RV" in ports else init
    y = block.discrete_state(init, lambda _: signals[0])
    signals.append(_next_content(block, ports, y, anew))
    return signals[0], y


def _next_content(block: BlockContext, ports: dict[str, int], y: Signal, init: Signal) -> Signal:
    """Return the next content: the input while enabled, the initial value on reset."""
    zero, new = block.constant(0.0), block.hold_in_minor_steps(block.input(0))
    if "E" in ports:
        new = block.select(block.apply("ne", block.hold_in_minor_steps(block.input(ports["E"])), zero), new, y)
    if "R" in ports:
        new = block.select(block.apply("ne", block.hold_in_minor_steps(block.input(ports["R"])), zero), init, new)
    return new
