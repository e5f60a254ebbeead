"""Delays by a number of hits: fixed or given by an input, held and reset by further inputs, tapped, of one hit."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.models.simulink.blocks.continuous import reset_signal, resetting
from kennfeld.models.simulink.lowering.block_context import BlockContext, Then
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import Signal, SignalOrBus, fastest_sample_time

_MOST_STEPS = 2000  # of a delay whose every step is a memory of its own

# delays of one hit, with inputs in the order of these names: u, E enables, R resets, IC and RV are values to begin with
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
    """The inputs of a delay beside the signal, None where there is none."""

    length: int | None
    enable: int | None
    reset: int | None
    init: int | None


def _ports(site: BlockContext) -> _Ports:
    has = (
        site.chosen("DelayLengthSource", "Dialog", "Input port") == "Input port",
        site.on("ShowEnablePort"),
        resetting(site) != "none",
        site.text("InitialConditionSource") != "Dialog",
    )
    numbers = [1 + sum(has[:at]) if there else None for at, there in enumerate(has)]
    return _Ports(*numbers)


def _delay_needs(site: BlockContext) -> Iterable[int]:
    ports = _ports(site)
    others = [at for at in (ports.length, ports.enable, ports.reset, ports.init) if at is not None]
    through = site.text("DelayLength").strip() == "0" if ports.length is None else _shortest(site) == 0
    return [0, *others] if through else others


def _shortest(site: BlockContext) -> int:
    return 1 if site.on("PreventDirectFeedthrough") else 0


@block("Delay", needs=_delay_needs, DelayLength="2", DelayLengthSource="Dialog", DelayLengthUpperLimit="100",
       InitialCondition="0.0", InitialConditionSource="Dialog", ExternalReset="None", ShowEnablePort="off",
       PreventDirectFeedthrough="off", SampleTime="-1")  # fmt: skip
def delay(site: BlockContext) -> SignalOrBus:
    """The input of some hits before."""
    ports = _ports(site)
    init = site.parameter("InitialCondition") if ports.init is None else site.input(ports.init)
    if ports.length is None:
        steps = site.whole("DelayLength", 0, 100_000)
        if ports.enable is None and ports.reset is None:
            return _delayed(site, init, steps)
        return _controlled(site, ports, init, steps, None)
    steps = site.whole("DelayLengthUpperLimit", 1, _MOST_STEPS)
    if init.size != 1 and steps != 1:
        raise UnsupportedError("it has several initial values for a length that changes")
    return _controlled(site, ports, init, steps, site.call("floor", site.input(ports.length)))


@block(
    "Integer Delay", "IntegerDelay", needs=no_feedthrough,
    sample="samptime", NumDelays="4", vinit="0.0", samptime="-1", InitialCondition="0.0",
)  # fmt: skip
def integer_delay(site: BlockContext) -> SignalOrBus:
    """The input of some hits before, as older files have it."""
    key = "vinit" if site.atom.block.value("InitialCondition") is None else "InitialCondition"
    return _delayed(site, site.parameter(key), site.whole("NumDelays", 0, 100_000))


def _delayed(site: BlockContext, init: Signal, steps: int) -> Signal:
    if steps == 0:
        return site.input()
    if init.size == 1 and site.compiler.gates.every_step(site.atom):
        return site.remember(init, lambda _: site.input(), steps)
    return _taps(site, init, steps, None, None)[-1]


def _first(init: Signal, steps: int) -> list[Signal]:
    """What the steps hold at first, the youngest first; of several values the first comes out first."""
    if init.size == 1 or steps == 1:
        return [init] * steps
    if init.size != steps:
        raise UnsupportedError(f"it has {init.size} initial values for a delay of {steps} steps")
    return init.elements[::-1]


def _taps(site: BlockContext, init: Signal, steps: int, runs: Signal | None, anew: Signal | None) -> list[Signal]:
    """The inputs of the last hits, the youngest first. They move on where `runs` holds, and begin `anew` before."""
    if steps > _MOST_STEPS:
        raise UnsupportedError(f"a delay of {steps} steps that are memories of their own; {_MOST_STEPS} is the most")
    taps: list[Signal] = []

    def following(at: int) -> Then:
        def then(_: Signal) -> Signal:
            new = site.input(0) if at == 0 else taps[at - 1]
            return new if runs is None else site.select(runs, new, taps[at])

        return then

    for at, first in enumerate(_first(init, steps)):
        held = site.remember(first, following(at))
        taps.append(held if anew is None else site.select(anew, first, held))
    return taps


def _controlled(site: BlockContext, ports: _Ports, init: Signal, steps: int, length: Signal | None) -> Signal:
    """A delay with inputs that say whether it runs, when it begins anew, and how long it is."""
    if ports.enable is not None and ports.reset is not None:
        raise UnsupportedError("it has both an enable and a reset port")
    runs = anew = None
    if ports.reset is not None:
        anew = reset_signal(site, site.input(ports.reset), resetting(site))
    if ports.enable is not None:
        runs = site.call("ne", site.discrete(site.input(ports.enable)), site.constant(0.0))
        ran = site.remember(site.constant(0.0), lambda _: runs)
        anew = site.call("and", runs, site.call("not", ran))
    taps = _taps(site, init, steps, runs, anew)
    y = taps[-1] if length is None else _chosen(site, taps, length)
    return y if runs is None else _held(site, runs, y)


def _chosen(site: BlockContext, taps: Sequence[Signal], length: Signal) -> Signal:
    """The tap that a length asks for, within those there are."""
    y = taps[-1]
    for steps in range(len(taps) - 1, _shortest(site) - 1, -1):
        value = site.input(0) if steps == 0 else taps[steps - 1]
        y = site.select(site.call("lt", length, site.constant(steps + 1.0)), value, y)
    return y


def _held(site: BlockContext, runs: Signal, y: Signal) -> Signal:
    """The output of a block that keeps it while it does not run; 0 before it has."""
    made: list[Signal] = []
    before = site.remember(site.constant(0.0), lambda _: made[0])
    made.append(site.select(runs, y, before))
    return made[0]


def _tapped_needs(site: BlockContext) -> Iterable[int]:
    return (0,) if site.on("includeCurrent") else ()


@block("Tapped Delay Line", "Tapped Delay", needs=_tapped_needs, sample="samptime", linked=True, NumDelays="4",
       vinit="0.0", samptime="-1", DelayOrder="Oldest", includeCurrent="off")  # fmt: skip
def tapped_delay(site: BlockContext) -> SignalOrBus:
    """The inputs of the last hits in a vector, the oldest or the newest first."""
    init, steps = site.parameter("vinit"), site.whole("NumDelays", 1, _MOST_STEPS)
    if init.size != 1:
        raise UnsupportedError("it has several initial values")
    taps = _taps(site, init, steps, None, None)
    if site.on("includeCurrent"):
        taps = [site.discrete(site.input()), *taps]
    if any(tap.size != 1 for tap in taps):
        raise UnsupportedError("its input is a vector")
    newest = site.chosen("DelayOrder", "Oldest", "Newest") == "Newest"
    nodes = [tap.flat[0] for tap in (taps if newest else reversed(taps))]
    return Signal(np.array(nodes, dtype=np.int64), fastest_sample_time([tap.period for tap in taps]))


def _inputs(site: BlockContext) -> dict[str, int]:
    return {name: at for at, name in enumerate(_INPUTS[site.atom.kind].split())}


def _initial_needs(site: BlockContext) -> Iterable[int]:
    return [at for name, at in _inputs(site).items() if name == "IC"]


@block(*_DELAYS, needs=_initial_needs, sample="tsamp", linked=True, vinit="0.0", tsamp="-1")
def unit_delay_variant(site: BlockContext) -> SignalOrBus:
    """The input of the hit before; kept while it is not enabled, the initial value after a reset."""
    ports = _inputs(site)
    init = site.input(ports["IC"]) if "IC" in ports else site.parameter("vinit")
    return site.remember(init, lambda y: _guarded(site, ports, y, init))


@block(*_PREVIEWS, sample="tsamp", linked=True, vinit="0.0", tsamp="-1")
def unit_delay_with_preview(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """What a delay of one hit will hold, and what it holds."""
    ports, init, made = _inputs(site), site.parameter("vinit"), list[Signal]()
    anew = site.input(ports["RV"]) if "RV" in ports else init
    y = site.remember(init, lambda _: made[0])
    made.append(_guarded(site, ports, y, anew))
    return made[0], y


def _guarded(site: BlockContext, ports: dict[str, int], y: Signal, init: Signal) -> Signal:
    """The next content: the input while it is enabled, the initial value on a reset."""
    zero, new = site.constant(0.0), site.discrete(site.input(0))
    if "E" in ports:
        new = site.select(site.call("ne", site.discrete(site.input(ports["E"])), zero), new, y)
    if "R" in ports:
        new = site.select(site.call("ne", site.discrete(site.input(ports["R"])), zero), init, new)
    return new
