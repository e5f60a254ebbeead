"""States of buses: a delay of a bus delays each of its signals."""

from collections.abc import Callable
from typing import TypeAlias

from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError
from kennfeld.importers.simulink.lowering.pass_state import BusNames
from kennfeld.importers.simulink.signals import Bus, ExternalBus, Signal, SignalOrBus

# from the initial value of a signal, and the signal as it arrives once everything is lowered
Delay: TypeAlias = Callable[[Signal, Callable[[], Signal]], Signal]


def delay_members(block: BlockContext, init: SignalOrBus, delay: Delay) -> SignalOrBus:
    """Delay the first input, or each signal of a bus there.

    Args:
        block: the block, whose input may depend on its output.
        init: the initial value; that of a bus is a struct, or a number for all its signals.
        delay: delays one signal.
    """
    guesses = block.compiler.shapes.guesses
    names = guesses.buses.get(block.flat.first) or (_names_of(init) if isinstance(init, Bus) else None)
    # a delay in a loop is read before its input is lowered: what arrives tells the next pass which signals there are
    block.compiler.memories.agenda.add(block.flat.last, lambda: _note_names(block))
    if names is None:
        assert isinstance(init, Signal)
        return delay(init, block.input)
    return _delay_each(block, names, init, delay, ())


def _note_names(block: BlockContext) -> None:
    source = block.source()
    if source is None or not block.compiler.is_lowered(source):
        return
    wired = block.input_or_bus(0)
    if isinstance(wired, Bus) and not isinstance(wired, ExternalBus):
        block.compiler.shapes.guesses.bus(block.flat.first, _names_of(wired))


def _names_of(wired: Bus) -> BusNames:
    return tuple((name, _names_of(part) if isinstance(part, Bus) else ()) for name, part in wired.members.items())


def _delay_each(
    block: BlockContext, names: BusNames, init: SignalOrBus, delay: Delay, path: tuple[str, ...]
) -> SignalOrBus:
    """Return the delayed signal at a path, or the bus of those below it."""
    if not names:
        if isinstance(init, Bus):
            raise UnsupportedError(f"its initial value has a struct for the signal {'.'.join(path)}")
        return delay(init, lambda: _signal_at(block, path))
    known = dict(names)
    lacking = [name for name in init.members if name not in known] if isinstance(init, Bus) else []
    if lacking:
        raise UnsupportedError(_lacks((*path, lacking[0])))
    members = {}
    for name, below in names:
        # a struct may leave signals out, which then begin at 0; a number is the start of all
        start = init.members.get(name, block.constant(0.0)) if isinstance(init, Bus) else init
        members[name] = _delay_each(block, below, start, delay, (*path, name))
    return Bus(members)


def _signal_at(block: BlockContext, path: tuple[str, ...]) -> Signal:
    """Return a signal of the bus that arrives."""
    wired = block.input_or_bus(0)
    for name in path:
        member = wired.member(name) if isinstance(wired, Bus) else None
        if member is None:
            raise UnsupportedError(_lacks(path))
        wired = member
    signal = wired.signal if isinstance(wired, ExternalBus) else wired
    if isinstance(signal, Bus):
        raise UnsupportedError(f"its initial value has a number for the bus {'.'.join(path)}")
    return signal


def _lacks(path: tuple[str, ...]) -> str:
    return f"its initial value has the signal {'.'.join(path)}, which its input lacks"
