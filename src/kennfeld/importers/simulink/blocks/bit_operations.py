"""Bit operations on integers, negative ones in two's complement.

Graphs compute in doubles, in which integers up to 2^53 are exact. The bits are those of the number that the integer
type of a signal stores; if the file does not specify the type, those of the value rounded down. Derivatives are 0.
"""

import re
from collections.abc import Iterator

from kennfeld.importers.simulink.lowering import LIKE_INPUT, BlockContext, OutputType, UnsupportedError, block
from kennfeld.importers.simulink.lowering.integer_signals import integer_type_of, is_floating
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    Signal,
    SignalOrBus,
    apply,
    as_vector,
    broadcast,
    period_of,
    select,
)
from kennfeld.models.imperative import integer_types
from kennfeld.models.imperative.integer_types import IntegerType

_MAX_EXACT_INTEGER = 2**53  # doubles represent all integers up to here
_MAX_SIGNAL_BITS = 32  # if both operands are signals
_MAX_POINT_SHIFT = 2000  # places, beyond which any double is 0 or infinite
_MIN_SIGN_BIT = 2**7  # sign bit of the shortest integer type
_HEXADECIMAL = re.compile(r"\s*'([0-9A-Fa-f]{1,13})'\s*")  # a mask may be a text of hexadecimal digits
_TYPE_REMEDY = "Specify an integer output type such as uint16 on the block that feeds this input, or bind this block."


@block("Bitwise Operator", output=OutputType((0,)), linked=True, logicop="AND", UseBitMask="on", NumInputPorts="1",
       BitMask="bin2dec('11011001')", BitMaskRealWorld="Stored Integer")  # fmt: skip
def bitwise_operator(block: BlockContext) -> SignalOrBus:
    """Apply a bitwise operation to the inputs, to the elements of a single input, or to the input and a mask.

    The result and the mask have the type of the first input: the mask 217 as int8 is -39.
    """
    kind = block.option("logicop", "AND", "OR", "NAND", "NOR", "XOR", "NOT")
    if not block.input_count:
        raise UnsupportedError("it has no input")
    types = [integer_type_of(block.source(at)) for at in range(block.input_count)]
    word = next(filter(None, types), None)  # of the first input that specifies one
    if kind in ("NOT", "NAND", "NOR"):
        word = _require_integer_type(word)
    inputs = [stored_integer(block, at, word) for at in range(block.input_count)]
    if kind == "NOT":
        return _complement(block, inputs[0], word)
    op = {"NAND": "AND", "NOR": "OR"}.get(kind, kind)
    if block.is_on("UseBitMask"):
        result = _with_mask(block, op, inputs[0], _masks(block, word))
    else:
        result = _fold(block, op, inputs if len(inputs) > 1 else inputs[0].elements)
    return result if kind == op else _complement(block, result, word)


def stored_integer(block: BlockContext, index: int, otherwise: IntegerType | None = None) -> Signal:
    """Compute the integer stored for an input, rounded and wrapped or saturated by the block that specifies its type.

    If no block specifies a type, it is `otherwise`.
    """
    x, word = block.input(index), integer_type_of(block.source(index)) or otherwise
    return apply("floor", x) if word is None else fit_to_type(block, x, word)


def fit_to_type(block: BlockContext, x: Signal, word: IntegerType) -> Signal:
    """Round a signal, and wrap or saturate it, to an integer type."""
    return block.signal(integer_types.fit_to_type(block.builder, x.nodes, word), x.period)


def _require_integer_type(word: IntegerType | None) -> IntegerType:
    """Return the integer type of an input; complements and shifts depend on it."""
    if word is None:
        message = "its result depends on the integer type of its input, which the file does not specify"
        raise UnsupportedError(message, _TYPE_REMEDY)
    if word.bits > _MAX_SIGNAL_BITS:
        raise UnsupportedError(f"its input has {word.bits} bits, but doubles are exact only up to 53 bits")
    return word


def _masks(block: BlockContext, word: IntegerType | None) -> list[int]:
    if digits := _HEXADECIMAL.fullmatch(block.field_text("BitMask")):
        masks = [int(digits[1], 16)]
    else:
        masks = [_whole(float(mask)) for mask in block.numeric_array("BitMask").ravel(order="F")]
    if word is not None:
        return [word.wrapped(number) for number in masks]
    if any(not 0 <= number < _MIN_SIGN_BIT for number in masks):
        block.warn(
            "uses its mask as written because the file does not specify the integer type of its input: if that "
            "type is signed or has fewer bits than the mask, the result wraps in Simulink. Specify an integer output "
            "type on the block that feeds it"
        )
    return masks


def _complement(block: BlockContext, x: Signal, word: IntegerType | None) -> Signal:
    assert word is not None
    # NOT x = -1 - x in two's complement, 2^bits - 1 - x without a sign
    top = -1.0 if word.signed else 2.0**word.bits - 1
    return top - x


def _with_mask(block: BlockContext, op: str, x: Signal, masks: list[int]) -> Signal:
    """Apply an operation to each element and its mask; a single mask applies to all elements."""
    if len(masks) not in (1, x.size) and x.size != 1:
        raise UnsupportedError(f"it has {len(masks)} masks for {x.size} input elements")
    elements = x.elements * (len(masks) if x.size == 1 else 1)
    masks = masks * (len(elements) if len(masks) == 1 else 1)
    nodes = [_apply_mask(block, op, signal, mask).flat[0] for signal, mask in zip(elements, masks, strict=True)]
    return block.signal(nodes, x.period, x.shape if len(nodes) == x.size else (len(nodes),))


def _whole(value: float) -> int:
    if not (value.is_integer() and abs(value) < _MAX_EXACT_INTEGER):
        raise UnsupportedError(f"its mask must be an integer below 2^53 in magnitude, got {value:g}")
    return int(value)


def _apply_mask(block: BlockContext, op: str, x: Signal, mask: int) -> Signal:
    """Apply a mask through `x AND m`: x OR m = x + m - (x AND m), x XOR m = x + m - 2 (x AND m)."""
    # a negative mask through its complement: x AND m = x - (x AND NOT m)
    both = _and(block, x, mask) if mask >= 0 else x - _and(block, x, -mask - 1)
    return _from_and(op, x, block.constant(float(mask)), both)


def _from_and(op: str, a: Signal, b: Signal, both: Signal) -> Signal:
    if op == "AND":
        return both
    return a + b - (both if op == "OR" else 2.0 * both)


def _and(block: BlockContext, x: Signal, mask: int) -> Signal:
    """Return x AND mask for a mask >= 0, summed over the runs of ones in the mask."""
    result = block.constant(0.0)
    for first, count in _runs(mask):
        result = result + _field(x, first, count)
    return block.signal(result.nodes, x.period)


def _runs(mask: int) -> Iterator[tuple[int, int]]:
    """Yield the runs of ones in a mask as (first bit, length).

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


def _field(x: Signal, first: int, count: int) -> Signal:
    """Return a bit field of x in place: 2^first mod(floor(x / 2^first), 2^count)."""
    return 2.0**first * (apply("floor", x / 2.0**first) % 2.0**count)


def _fold(block: BlockContext, op: str, parts: list[Signal]) -> Signal:
    result = parts[0]
    for part in parts[1:]:
        a, b = broadcast(result, part)
        nodes = [_combine_pair(block, op, x, y).flat[0] for x, y in zip(a.elements, b.elements, strict=True)]
        result = block.signal(nodes, period_of((a, b)), a.shape)
    return result


def _combine_pair(block: BlockContext, op: str, a: Signal, b: Signal) -> Signal:
    """Apply an operation to two signals bit by bit, or to one and a constant mask; NaN beyond int32 and uint32."""
    # a constant is a mask, whose runs of ones take fewer nodes and no limit of 32 bits
    for signal, other in ((a, b), (b, a)):
        value = block.builder.value(signal.flat[0])
        if value is not None:
            return _apply_mask(block, op, other, _whole(value))
    both, edge = block.constant(0.0), 2.0**_MAX_SIGNAL_BITS
    for at in range(_MAX_SIGNAL_BITS):
        # the product of two bits is their AND; both fields carry the weight 2^at
        both = both + _field(a, at, 1) * _field(b, at, 1) / 2.0**at
    # two negative numbers also share the endless ones above bit 31, worth -2^32
    both = both - edge * ((a < 0.0) & (b < 0.0))
    fits = (a >= -edge) & (a < edge) & ((b >= -edge) & (b < edge))
    return select(fits, _from_and(op, a, b, both), float("nan"))


@block("Bit Set", output=OutputType((0,)), linked=True, iBit="0")
def bit_set(block: BlockContext) -> SignalOrBus:
    """Set one bit of the input."""
    x, bit, weight = _bit(block)
    # adds the weight if the bit is 0
    return x + weight * (1.0 - _field(x, bit, 1) / 2.0**bit)


@block("Bit Clear", output=OutputType((0,)), linked=True, iBit="0")
def bit_clear(block: BlockContext) -> SignalOrBus:
    """Clear one bit of the input."""
    x, bit, weight = _bit(block)
    return x - weight * (_field(x, bit, 1) / 2.0**bit)


def _bit(block: BlockContext) -> tuple[Signal, int, float]:
    """Return the input, the bit number, and the weight of the bit, negative for a sign bit."""
    bit, word = block.integer_field("iBit", 0, 52), integer_type_of(block.source())
    if word is not None and bit >= word.bits:
        raise UnsupportedError(f"bit {bit} is outside its {word.bits}-bit input")
    if word is None and bit >= _MIN_SIGN_BIT.bit_length() - 1:
        block.warn(
            f"uses bit {bit} as 2^{bit} because the file does not specify the integer type of its input: as a "
            "sign bit it would be negative. Specify an integer output type on the block that feeds it"
        )
    is_sign = word is not None and word.signed and bit == word.bits - 1
    return stored_integer(block, 0), bit, -(2.0**bit) if is_sign else 2.0**bit


@block("Shift Arithmetic", linked=True)
def old_shift(block: BlockContext) -> SignalOrBus:
    """Shift as `shift` does, in files before R2009b: a positive number shifts right, a negative one left."""
    by, point = _dialog_shift(block, "nBitShiftRight"), _point_shift(block, "nBinPtShiftRight")
    if is_floating(block.source()):
        return _scale(block, point - by)
    _refuse_point_shift(point)
    word = _require_integer_type(integer_type_of(block.source()))
    return _shift_bits(block, stored_integer(block, 0), by, "Bidirectional", word)


@block("ArithShift", output=LIKE_INPUT, BitShiftNumberSource="Dialog", BitShiftDirection="Bidirectional",
       BitShiftNumber="0", BinPtShiftNumber="0", DiagnosticForOORShift="None")  # fmt: skip
def shift(block: BlockContext) -> SignalOrBus:
    """Shift the input: floor(u / 2^n) to the right; to the left the bits of u 2^n that fit the word."""
    direction = block.option("BitShiftDirection", "Left", "Right", "Bidirectional")
    point = _point_shift(block, "BinPtShiftNumber")
    in_dialog = block.option("BitShiftNumberSource", "Dialog", "Input port") == "Dialog"
    if is_floating(block.source()):
        by = _dialog_shift(block, "BitShiftNumber") if in_dialog else _shift_input(block)
        # rounded down last, as generated code does: ldexp(u, (int32_T)floor(0.0 - s))
        return _scale(block, point + apply("floor", by if direction == "Left" else -by))
    by = _dialog_shift(block, "BitShiftNumber") if in_dialog else stored_integer(block, 1)
    if not in_dialog and integer_type_of(block.source(1)) is None:
        block.warn("rounds its number of bits down, which must be an integer; a fraction may shift by another number")
    _refuse_point_shift(point)
    word = _require_integer_type(integer_type_of(block.source()))
    return _shift_bits(block, stored_integer(block, 0), by, direction, word)


def _dialog_shift(block: BlockContext, name: str) -> Signal:
    """Return a number of bits as constants: no parameter, as one between integers has no meaning."""
    numbers = block.numeric_array(name)
    for number in numbers.ravel():
        if not float(number).is_integer():
            raise UnsupportedError(f"its {name} must be an integer, got {number:g}")
    return block.signal(as_vector(block.compiler.expressions.freeze(numbers)), CONSTANT)


def _shift_input(block: BlockContext) -> Signal:
    """Return the number of bits at the second input: as stored if it has an integer type, else as computed."""
    return stored_integer(block, 1) if integer_type_of(block.source(1)) is not None else block.input(1)


def _point_shift(block: BlockContext, name: str) -> float:
    """Return by how many places the binary point moves to the right."""
    return float(block.integer_field(name, -_MAX_POINT_SHIFT, _MAX_POINT_SHIFT))


def _scale(block: BlockContext, left: Signal) -> Signal:
    """Shift a floating-point number: u 2^n for n bits to the left, or if its binary point moves n to the right."""
    return block.input() * 2.0**left


def _refuse_point_shift(point: float) -> None:
    if point:
        raise UnsupportedError("it shifts the binary point, but data types are ignored")


def _shift_bits(block: BlockContext, x: Signal, by: Signal, direction: str, word: IntegerType) -> Signal:
    right = apply("floor", x / 2.0**by)
    if direction == "Right":
        return right
    shifted = x * 2.0 ** (by if direction == "Left" else -by)
    # bits beyond the word are lost on the left, those below 2^0 on the right by rounding down
    pushed = block.signal(integer_types.wrap_to_type(block.builder, shifted.nodes, word), shifted.period)
    return pushed if direction == "Left" else select(by < 0.0, pushed, right)
