"""Integer and fixed-point types of signals, found by tracing connections back."""

import re
from collections.abc import Callable, Iterator
from typing import Final, TypeVar

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.importers.simulink.lowering.registry import output_type_of
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.variables.data_types import FixedPointType, PlainType, has_type_of_input, stated_type
from kennfeld.models.imperative.integer_types import IntegerType, integer_type_named

T = TypeVar("T")

INTEGER_CAST = re.compile(r"\b(u?int(?:8|16|32|64))\s*\(")
_MAX_TRACED_BLOCKS = 200
_LITERAL = re.compile(r"[-+.\deE\[\]\s,;]*")  # numbers that no variable gives a type
_FLOATING: Final = ("double", "single", "half")
_ROUNDINGS: Final = ("Ceiling", "Convergent", "Floor", "Nearest", "Round", "Simplest", "Zero")


def integer_type_of(source: SignalSource | None) -> IntegerType | None:
    """Return the integer type of a signal, None if the file does not specify it or it is not an integer.

    The signal is traced back through blocks that pass on the type of their input.
    """
    return _common_type(set(_traced_types(source, specified_integer_type)))


def fixed_point_type_of(source: SignalSource | None) -> FixedPointType | None:
    """Return the integer or fixed-point type of a signal, traced back in the same way."""
    types = set(_traced_types(source, _stated_fixed_point))
    return types.pop() if len(types) == 1 else None


def _traced_types(source: SignalSource | None, stated: Callable[[FlatBlock], T | None]) -> Iterator[T | None]:
    """Yield the types that the blocks behind a signal state, None for one that states none."""
    waiting, seen = [source], set[FlatBlock]()
    while waiting:
        pending = waiting.pop()
        if pending is None or len(seen) > _MAX_TRACED_BLOCKS:
            # an unknown type among them leaves all of them open
            yield None
            return
        if pending.flat in seen:
            continue
        seen.add(pending.flat)
        # a specified type ends the search, even at a block that would pass on that of its input
        kind, passed = stated(pending.flat), _type_inputs(pending.flat)
        if kind is None and passed:
            inputs = pending.flat.inputs
            waiting += [inputs[at] if at < len(inputs) else None for at in passed]
        else:
            yield kind


def is_floating(source: SignalSource | None) -> bool:
    """Return True if a signal is known to be a floating-point number: computed from such numbers only.

    A root inport that specifies no type is of type double, and so are literals.
    """
    waiting, seen = [source], set[FlatBlock]()
    while waiting:
        pending = waiting.pop()
        if pending is None or len(seen) > _MAX_TRACED_BLOCKS:
            return False
        flat = pending.flat
        if flat in seen:
            continue
        seen.add(flat)
        kind = flat.output_type
        if isinstance(kind, PlainType) and kind.name in _FLOATING:
            continue
        if kind is not None or stated_type(flat.block) or not output_type_of(flat).floating:
            return False
        # a variable of the workspace may be an integer, which the model file does not say
        if flat.type == "Constant" and not _LITERAL.fullmatch(flat.block.value("Value") or "1"):
            return False
        waiting += flat.inputs
    return True


def _common_type(types: set[IntegerType | None]) -> IntegerType | None:
    """Return the common type; if rounding or overflow differ, round down and wrap."""
    if len(types) == 1:
        return types.pop()
    # paths that differ in how they convert still store the same bits
    plain = {(integer_type.bits, integer_type.signed) if integer_type is not None else None for integer_type in types}
    only = plain.pop() if len(plain) == 1 else None
    return IntegerType(*only) if only is not None else None


def _type_inputs(flat: FlatBlock) -> tuple[int, ...]:
    """Return the inputs whose type the output has."""
    if has_type_of_input(flat.block):
        return (0,)
    return output_type_of(flat).inputs


def specified_integer_type(flat: FlatBlock) -> IntegerType | None:
    """Return the integer type that a block specifies for its output."""
    kind = flat.output_type
    if isinstance(kind, FixedPointType):
        return IntegerType(kind.bits, kind.signed, _rounding(flat), is_saturating(flat)) if kind.is_integer else None
    # `int16(3)` as the value of a constant gives its type without any field
    cast = INTEGER_CAST.match((flat.block.value("Value") or "").strip()) if flat.type == "Constant" else None
    return integer_type_named(cast[1]) if cast is not None and kind is None else None


def _stated_fixed_point(flat: FlatBlock) -> FixedPointType | None:
    kind = flat.output_type
    return kind if isinstance(kind, FixedPointType) else None


def is_saturating(flat: FlatBlock) -> bool:
    """Return True if values beyond the type of a block are saturated, not wrapped."""
    return flat.block.is_set_to("SaturateOnIntegerOverflow", "on")


def _rounding(flat: FlatBlock) -> str:
    written = flat.block.value("RndMeth") or "Floor"
    return match_word(written, _ROUNDINGS) or written
