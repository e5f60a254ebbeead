"""Subsystems that run several times in a step: what counts their passes, and what comes out of them."""

import numpy as np

from kennfeld.models.simulink.blocktypes.conditional import restart
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import Bus, Signal, Wired, fastest, scalar
from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.files.tree import Block, joined, split
from kennfeld.models.simulink.flattening.atoms import Source
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block, nothing
from kennfeld.models.simulink.weaving.site import Site, resized

_LARGEST = 1000.0  # passes


@block("ForIterator", IterationLimit="5", IterationSource="internal", IndexMode="One-based", ResetStates="held")
def for_iterator(site: Site) -> Wired:
    """The number of the pass."""
    _in_passes(site, bool(site.atom.passes))
    if site.text("IterationSource") == "external":
        _count(site, _fixed(site))
    return site.constant(site.atom.passes[-1] - (site.text("IndexMode") == "Zero-based"))


def _fixed(site: Site) -> float:
    """The fixed value at the input that says how many passes there are."""
    signal = site.input()
    value = site.loom.value(signal.flat[0]) if signal.size == 1 else None
    source = site.source()
    if value is None and source is not None and source.atom.kind == "Constant":
        try:
            numbers = site.weaver.expressions.numbers(source.atom.block.value("Value") or "1", source.atom.scope)
        except NoValueError as error:
            raise UnsupportedError(
                f"the number of its passes has no value: {error}", undefined=error.undefined
            ) from None
        value = float(numbers.item()) if numbers.size == 1 else None
    if value is None:
        mend = "Feed it from a Constant, or count the passes in the block itself."
        raise UnsupportedError("the number of its passes is not fixed", mend)
    return value


def _count(site: Site, found: float) -> None:
    """Note how many passes a subsystem has; where it was built with others, it is built once more."""
    if not (found.is_integer() and 1 <= found <= _LARGEST):
        raise UnsupportedError(f"it asks for {found:g} passes in a step; 1 to {_LARGEST:g} are possible")
    site.weaver.counted(joined(*split(site.atom.path)[:-1]), int(found))


def _in_passes(site: Site, inside: bool) -> None:
    if not inside:
        raise UnsupportedError("its subsystem runs several times in a step", "Import the system around it.")


@block("WhileIterator", needs=nothing)
def while_iterator(site: Site) -> Wired:
    """The number of the pass."""
    _in_passes(site, bool(site.atom.passes))
    return site.constant(float(site.atom.passes[-1]))


@block("Pass")
def iteration(site: Site) -> tuple[Wired, ...]:
    """Whether a pass takes place, and whether the memories in it begin anew."""
    active = site.constant(1.0)
    for signal in site.inputs:
        active = site.call("and", active, site.call("ne", site.weaver.timing.at_major(signal), site.constant(0.0)))
    before = site.atom.earlier
    said = site.weaver.value(Source(before, 0)) if before is not None else None
    outer = site.weaver.gates.active(site.atom)
    if site.atom.passes[-1] > 1 and isinstance(said, Signal):
        active = site.call("and", said, active)
    elif outer is not None:
        active = site.call("and", scalar(outer), active)
    return active, restart(site, active)


@block("Iterated", InitialOutput="[]")
def iterated(site: Site) -> Wired:
    """What the last pass gives that takes place; the output of the step before where none does."""
    if site.count == 1:
        return site.wired(0)
    passes = [site.input(at) for at in range(1, site.count, 2)]
    return _last(site, [site.wired(at) for at in range(0, site.count, 2)], passes)


def _last(site: Site, outputs: list[Wired], passes: list[Signal]) -> Wired:
    if isinstance(outputs[0], Bus):
        members = {name: [_member(one, name) for one in outputs] for name in outputs[0].members}
        return Bus({name: _last(site, several, passes) for name, several in members.items()})
    signals = [one for one in outputs if isinstance(one, Signal)]
    made: list[Signal] = []
    y = signals[0]
    if site.loom.value(passes[0].flat[0]) != 1:
        init = site.initial_output() or site.constant(0.0)
        init = Signal(resized(init.nodes, y.shape))
        y = site.select(passes[0], y, site.weaver.memories.always_later(site, init, lambda: made[0]))
    for active, signal in zip(passes[1:], signals[1:], strict=True):
        y = site.select(active, signal, y)
    made.append(y)
    return y


def _member(wired: Wired, name: str) -> Wired:
    assert isinstance(wired, Bus)
    return wired.members[name]


# for each


@block("ForEach", needs=nothing, IndexMode="Zero-based")
def for_each(site: Site) -> Wired:
    """The number of the element."""
    _in_passes(site, site.atom.element > 0)
    return site.constant(site.atom.element - (site.text("IndexMode") == "Zero-based"))


@block("Part")
def part(site: Site) -> Wired:
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


def _each(site: Site) -> tuple[Block, int]:
    """The block that says how a port is parted or put together, and the number of the port."""
    each = site.atom.special.get("each")
    if each is None:
        raise UnsupportedError("it is no port of a For Each subsystem")
    return each, port_number(site.atom.block)


def _setting(each: Block, name: str, number: int, otherwise: int = 1) -> int:
    listed = each.listed(name)
    text = listed[number - 1].strip() if number <= len(listed) else ""
    if text and not text.isdecimal():
        raise UnsupportedError(f"{name} is {text[:40]}, not a whole number")
    return int(text) if text else otherwise


@block("Joined")
def together(site: Site) -> Wired:
    """The outputs of all elements along a dimension."""
    each, number = _each(site)
    if "off" in each.listed("OutputConcatenation")[number - 1 : number]:
        raise UnsupportedError("its elements are not put together, which is not supported")
    dimension = _setting(each, "OutputConcatenationDimension", number)
    parts = site.inputs
    if len({one.shape for one in parts}) > 1 or dimension not in (1, 2):
        raise UnsupportedError(f"its elements cannot be put together along dimension {dimension}")
    arrays = [one.nodes.reshape(-1, 1) if dimension == 2 and one.nodes.ndim == 1 else one.nodes for one in parts]
    return Signal(np.concatenate(arrays, axis=dimension - 1), fastest([one.period for one in parts]))
