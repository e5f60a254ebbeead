"""Integer types of signals, found by tracing connections back."""

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.importers.simulink.lowering.registry import output_type_of
from kennfeld.models.imperative.integer_types import IntegerType, integer_type_named

_CAST = re.compile(r"\b(u?int(?:8|16|32|64))\s*\(")
_MAX_TRACED_BLOCKS = 200
_LITERAL = re.compile(r"[-+.\deE\[\]\s,;]*")  # numbers that no variable gives a type
_FLOATING: Final = ("double", "single", "half")
_SAME: Final = ("Inherit: Same as first input", "Inherit: Same as input")
_ASSIGNED: Final = ("LOCAL_DATA", "OUTPUT_DATA")


def integer_type_of(source: SignalSource | None) -> IntegerType | None:
    """Return the integer type of a signal, None if the file does not specify it or it is not an integer.

    The signal is traced back through blocks that pass on the type of their input.
    """
    waiting, types, seen = [source], set[IntegerType | None](), set[FlatBlock]()
    while waiting:
        pending = waiting.pop()
        if pending is None or len(seen) > _MAX_TRACED_BLOCKS:
            return None
        # a loop through a delay leads back to a block whose type is being looked for
        if pending.flat in seen:
            continue
        seen.add(pending.flat)
        stated = specified_integer_type(pending.flat)
        passed = _type_inputs(pending.flat)
        if stated is None and passed:
            inputs = pending.flat.inputs
            waiting += [inputs[at] if at < len(inputs) else None for at in passed]
        else:
            types.add(stated)
    return _common_type(types)


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
        written = _specified_type(flat)
        if written in _FLOATING:
            continue
        if written or not output_type_of(flat).floating:
            return False
        # a variable of the workspace may be an integer, which the model file does not say
        if flat.type == "Constant" and not _LITERAL.fullmatch(flat.block.value("Value") or "1"):
            return False
        waiting += flat.inputs
    return True


def _specified_type(flat: FlatBlock) -> str:
    """Return the output type that a block specifies, "" if it is inherited."""
    words = ((flat.block.value(key) or "").strip() for key in ("OutDataTypeStr", "OutDataTypeMode", "DataType"))
    return next((word for word in words if word and word != "auto" and not word.startswith("Inherit")), "")


def _common_type(types: set[IntegerType | None]) -> IntegerType | None:
    """Return the common type; if rounding or overflow differ, round down and wrap."""
    if len(types) == 1:
        return types.pop()
    # blocks along the way may round differently; what the signal is kept in is the same
    plain = {(integer_type.bits, integer_type.signed) if integer_type is not None else None for integer_type in types}
    only = plain.pop() if len(plain) == 1 else None
    return IntegerType(*only) if only is not None else None


def _type_inputs(flat: FlatBlock) -> tuple[int, ...]:
    """Return the inputs whose type the output has."""
    if (flat.block.value("OutDataTypeStr") or "").strip() in _SAME:
        return (0,)
    return output_type_of(flat).inputs


def specified_integer_type(flat: FlatBlock) -> IntegerType | None:
    """Return the integer type that a block specifies for its output."""
    for key in ("OutDataTypeStr", "OutDataTypeMode", "DataType"):
        written = (flat.block.value(key) or "").strip()
        word = integer_type_named(written)
        if word is not None:
            saturates = (flat.block.value("SaturateOnIntegerOverflow") or "off") == "on"
            return replace(word, rounding=flat.block.value("RndMeth") or "Floor", saturates=saturates)
        if written and not written.startswith("Inherit"):
            return None
    # `int16(3)` as the value of a constant gives its type without any field
    cast = _CAST.match((flat.block.value("Value") or "").strip()) if flat.type == "Constant" else None
    return integer_type_named(cast[1]) if cast is not None else None


def find_integer_conversions(blocks: Iterable[FlatBlock]) -> tuple[str, ...]:
    """Return the paths of the blocks that convert numbers to integers, which is ignored: values stay physical."""
    return tuple(dict.fromkeys(flat.path for flat in blocks if _converts(flat)))


def _converts(flat: FlatBlock) -> bool:
    """Return True if a block converts to integers: by its output type, a cast in its code, or a chart variable."""
    if not output_type_of(flat).converts:
        return False
    if specified_integer_type(flat) is not None or _CAST.search(flat.block.script):
        return True
    chart = flat.block.chart if flat.type == "Chart" else None
    return chart is not None and any(integer_type_named(data.type) for data in chart.data if data.scope in _ASSIGNED)
