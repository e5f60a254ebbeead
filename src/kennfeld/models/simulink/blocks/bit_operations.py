"""Which integer type a signal has, as far as the file says so: some results depend on the length of a word.

Operations on the bits of whole numbers, negative ones as their complement to two.

A graph computes in doubles, where whole numbers up to 2^53 are exact. The bits are those of the number that the integer
type of a signal holds; where the file does not say that type, those of the whole number below a value. Their derivative
is 0.
"""

from collections.abc import Iterator

import numpy as np

from kennfeld.models.imperative import integer_types
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.simulink.flattening.integer_signals import integer_type_of
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus, fastest_sample_time

__all__ = ["fitted", "stored"]

_MOST = 2**53  # doubles know all whole numbers up to here
_PAIRED = 32  # bits of numbers that are both signals
_LEAST_SIGN = 2**7  # the bit of a sign in the shortest word
_STATE = "Let the block that makes its input state an integer type, such as uint16, or bind it."


@block("Bitwise Operator", linked=True, logicop="AND", UseBitMask="on", NumInputPorts="1",
       BitMask="bin2dec('11011001')", BitMaskRealWorld="Stored Integer")  # fmt: skip
def bitwise_operator(site: BlockContext) -> SignalOrBus:
    """A logical operation on the bits of the inputs, of the elements of a single one, or of the input and a mask.

    The result has the type of the first input, and so has the mask: 217 in a word of 8 bits with a sign is -39.
    """
    kind = site.chosen("logicop", "AND", "OR", "NAND", "NOR", "XOR", "NOT")
    if not site.count:
        raise UnsupportedError("it has no input")
    word = _shared(site, needed=kind in ("NOT", "NAND", "NOR"))
    inputs = [stored(site, at, word) for at in range(site.count)]
    if kind == "NOT":
        return _complement(site, inputs[0], word)
    op = {"NAND": "AND", "NOR": "OR"}.get(kind, kind)
    if site.on("UseBitMask"):
        made = _with_mask(site, op, inputs[0], _masks(site, word))
    else:
        made = _folded(site, op, inputs if len(inputs) > 1 else inputs[0].elements)
    return made if kind == op else _complement(site, made, word)


def _shared(site: BlockContext, needed: bool) -> IntegerType | None:
    """The integer type that all inputs have to have, by the first of them that states one."""
    words = (integer_type_of(site.source(at)) for at in range(site.count))
    word = next((one for one in words if one is not None), None)
    return _checked(word) if needed else word


def stored(site: BlockContext, index: int, otherwise: IntegerType | None = None) -> Signal:
    """The whole number that is stored for an input, as the block that states its type rounds, wraps or limits it.

    Where none states it, the type is `otherwise`.
    """
    x, word = site.input(index), integer_type_of(site.source(index)) or otherwise
    return site.call("floor", x) if word is None else fitted(site, x, word)


def fitted(site: BlockContext, x: Signal, word: IntegerType) -> Signal:
    """A number as one of an integer type."""
    return Signal(integer_types.fitted(site.builder, x.nodes, word), x.period)


def _checked(word: IntegerType | None) -> IntegerType:
    """The integer type of an input; a complement and what a shift pushes out depend on it."""
    if word is None:
        raise UnsupportedError(
            "its result depends on the integer type of its input, which the file does not say", _STATE
        )
    if word.bits > _PAIRED:
        raise UnsupportedError(f"its input has {word.bits} bits, and doubles are exact up to 53")
    return word


def _masks(site: BlockContext, word: IntegerType | None) -> list[int]:
    """The masks as numbers of the integer type of the input."""
    masks = [_whole(float(one)) for one in site.numbers("BitMask").ravel(order="F")]
    if word is not None:
        return [word.wrapped(one) for one in masks]
    if any(not 0 <= one < _LEAST_SIGN for one in masks):
        site.remark(
            "takes its mask as it is written, since the file does not say the integer type of its input: where that "
            "type has fewer bits than the mask, or a sign, the result wraps in Simulink. Let the block before it state "
            "an integer type"
        )
    return masks


def _complement(site: BlockContext, x: Signal, word: IntegerType | None) -> Signal:
    assert word is not None
    top = -1.0 if word.signed else 2.0**word.bits - 1
    return site.call("sub", site.constant(top), x)


def _with_mask(site: BlockContext, op: str, x: Signal, masks: list[int]) -> Signal:
    """An operation of each element with its mask; a single one counts for all."""
    if len(masks) not in (1, x.size) and x.size != 1:
        raise UnsupportedError(f"it has {len(masks)} masks for {x.size} elements")
    elements = x.elements * (len(masks) if x.size == 1 else 1)
    masks = masks * (len(elements) if len(masks) == 1 else 1)
    made = [_masked(site, op, one, mask).flat[0] for one, mask in zip(elements, masks, strict=True)]
    shape = x.shape if len(made) == x.size else (len(made),)
    return Signal(np.array(made, dtype=np.int64).reshape(shape, order="F"), x.period)


def _whole(value: float) -> int:
    if not (value.is_integer() and abs(value) < _MOST):
        raise UnsupportedError(f"its mask {value:g} is not a whole number below 2^53")
    return int(value)


def _masked(site: BlockContext, op: str, x: Signal, mask: int) -> Signal:
    """`x AND m`, from which the others follow: x OR m = x + m - (x AND m), x XOR m = x + m - 2 (x AND m)."""
    both = _and(site, x, mask) if mask >= 0 else site.call("sub", x, _and(site, x, -mask - 1))
    return _from_and(site, op, x, site.constant(float(mask)), both)


def _from_and(site: BlockContext, op: str, a: Signal, b: Signal, both: Signal) -> Signal:
    if op == "AND":
        return both
    taken = both if op == "OR" else site.call("mul", site.constant(2.0), both)
    return site.call("sub", site.call("add", a, b), taken)


def _and(site: BlockContext, x: Signal, mask: int) -> Signal:
    """The bits of x at the ones of a mask that is not negative, one run of ones after the other."""
    made = site.constant(0.0)
    for first, count in _runs(mask):
        made = site.call("add", made, _field(site, x, first, count))
    return Signal(made.nodes, x.period)


def _runs(mask: int) -> Iterator[tuple[int, int]]:
    """The runs of ones in a mask: where each begins, and how long it is.

    >>> list(_runs(0b11011))
    [(0, 2), (3, 2)]
    """
    at = 0
    while mask >> at:
        count = 0
        while mask >> (at + count) & 1:
            count += 1
        if count:
            yield at, count
        at += max(count, 1)


def _field(site: BlockContext, x: Signal, first: int, count: int) -> Signal:
    """Some bits of x in their places: 2^first mod(floor(x / 2^first), 2^count)."""
    low, width = site.constant(2.0**first), site.constant(2.0**count)
    return site.call("mul", low, site.call("mod", site.call("floor", site.call("div", x, low)), width))


def _folded(site: BlockContext, op: str, parts: list[Signal]) -> Signal:
    made = parts[0]
    for part in parts[1:]:
        a, b = site.spread(made, part)
        nodes = [_paired(site, op, x, y).flat[0] for x, y in zip(a.elements, b.elements, strict=True)]
        period = fastest_sample_time([a.period, b.period])
        made = Signal(np.array(nodes, dtype=np.int64).reshape(a.shape, order="F"), period)
    return made


def _paired(site: BlockContext, op: str, a: Signal, b: Signal) -> Signal:
    """An operation on two signals, bit by bit; on one and a constant by its mask. NaN beyond 32 bits and a sign."""
    for one, other in ((a, b), (b, a)):
        value = site.builder.value(one.flat[0])
        if value is not None:
            return _masked(site, op, other, _whole(value))
    zero, both = site.constant(0.0), site.constant(0.0)
    for at in range(_PAIRED):
        bit = site.call("mul", _field(site, a, at, 1), _field(site, b, at, 1))
        both = site.call("add", both, site.call("div", bit, site.constant(2.0**at)))
    signs = site.call("and", site.call("lt", a, zero), site.call("lt", b, zero))
    both = site.call("sub", both, site.call("mul", site.constant(2.0**_PAIRED), signs))
    fits = site.call("and", _fits(site, a), _fits(site, b))
    return site.select(fits, _from_and(site, op, a, b, both), site.constant(float("nan")))


def _fits(site: BlockContext, x: Signal) -> Signal:
    edge = 2.0**_PAIRED
    return site.call("and", site.call("ge", x, site.constant(-edge)), site.call("lt", x, site.constant(edge)))


@block("Bit Set", linked=True, iBit="0")
def bit_set(site: BlockContext) -> SignalOrBus:
    """The input with one of its bits set."""
    x, bit, weight = _bit(site)
    clear = site.call("sub", site.constant(1.0), _one_bit(site, x, bit))
    return site.call("add", x, site.call("mul", site.constant(weight), clear))


@block("Bit Clear", linked=True, iBit="0")
def bit_clear(site: BlockContext) -> SignalOrBus:
    """The input with one of its bits cleared."""
    x, bit, weight = _bit(site)
    return site.call("sub", x, site.call("mul", site.constant(weight), _one_bit(site, x, bit)))


def _one_bit(site: BlockContext, x: Signal, at: int) -> Signal:
    """1 where a bit of x is set, else 0."""
    return site.call("div", _field(site, x, at, 1), site.constant(2.0**at))


def _bit(site: BlockContext) -> tuple[Signal, int, float]:
    """The input, the place of the bit, and what it counts: the highest of a word with a sign counts negative."""
    bit, word = site.whole("iBit", 0, 52), integer_type_of(site.source())
    if word is not None and bit >= word.bits:
        raise UnsupportedError(f"bit {bit} is beyond its input of {word.bits} bits")
    if word is None and bit >= _LEAST_SIGN.bit_length() - 1:
        site.remark(
            f"takes bit {bit} as 2^{bit}, since the file does not say the integer type of its input: as a sign it "
            "would count negative. Let the block before it state an integer type"
        )
    is_sign = word is not None and word.signed and bit == word.bits - 1
    return stored(site, 0), bit, -(2.0**bit) if is_sign else 2.0**bit


@block("Shift Arithmetic", linked=True)
def old_shift(site: BlockContext) -> SignalOrBus:
    """As `shift`, in files before R2009b: to the right by a number of bits, to the left by a negative one."""
    if site.number("nBinPtShiftRight"):
        raise UnsupportedError("it shifts the binary point, and number types are left aside")
    by = site.parameter("nBitShiftRight")
    return _shifted(site, stored(site, 0), by, "Bidirectional", _checked(integer_type_of(site.source())))


@block("ArithShift", BitShiftNumberSource="Dialog", BitShiftDirection="Bidirectional",
       BitShiftNumber="0", BinPtShiftNumber="0", DiagnosticForOORShift="None")  # fmt: skip
def shift(site: BlockContext) -> SignalOrBus:
    """The input shifted by some bits: to the right by floor(u / 2^n), to the left by what of u 2^n fits a word."""
    if site.number("BinPtShiftNumber"):
        raise UnsupportedError("it shifts the binary point, and number types are left aside")
    way = site.chosen("BitShiftDirection", "Left", "Right", "Bidirectional")
    word = _checked(integer_type_of(site.source()))
    x = stored(site, 0)
    if site.chosen("BitShiftNumberSource", "Dialog", "Input port") == "Dialog":
        return _shifted(site, x, site.parameter("BitShiftNumber"), way, word)
    return _shifted(site, x, stored(site, 1), way, word)


def _shifted(site: BlockContext, x: Signal, by: Signal, way: str, word: IntegerType) -> Signal:
    right = site.call("floor", site.call("div", x, site.call("pow", site.constant(2.0), by)))
    if way == "Right":
        return right
    left = by if way == "Left" else site.call("neg", by)
    shifted = site.call("mul", x, site.call("pow", site.constant(2.0), left))
    pushed = Signal(integer_types.wrapped(site.builder, shifted.nodes, word), shifted.period)
    return pushed if way == "Left" else site.select(site.call("lt", by, site.constant(0.0)), pushed, right)
