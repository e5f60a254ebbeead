"""Integer types of signals, found by following the wires back."""

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from kennfeld.models.imperative.integer_types import IntegerType, word_named
from kennfeld.models.simulink.flattening.flat_model import FlatBlock, SignalSource

__all__ = ["converting", "integer_type_of", "stated_word"]

_CAST = re.compile(r"\b(u?int(?:8|16|32|64))\s*\(")
_LONGEST_WAY = 200
# block types whose output is of the type of these inputs unless the file states another one
_LIKE_INPUT = {
    "ArithShift": (0,),
    "Bit Clear": (0,),
    "Bit Set": (0,),
    "Bitwise Operator": (0,),
    "Delay": (0,),
    "Held": (0,),
    "Memory": (0,),
    "Outport": (0,),
    "RateTransition": (0,),
    "Selector": (0,),
    "SignalConversion": (0,),
    "SignalSpecification": (0,),
    "Switch": (0, 2),
    "UnitDelay": (0,),
    "ZeroOrderHold": (0,),
}
_SAME: Final = ("Inherit: Same as first input", "Inherit: Same as input")
# block types that state the type of a signal without making it: their values are whole already, or those of another
_ONLY_STATING: Final = frozenset({*_LIKE_INPUT, "Constant", "Inport", "DataStoreMemory", "DataStoreRead", "Merge"})
_ASSIGNED: Final = ("LOCAL_DATA", "OUTPUT_DATA")


def integer_type_of(source: SignalSource | None) -> IntegerType | None:
    """The integer type of a signal; None where the file does not say it, or says that it is no integer.

    It is looked for back along the wires, as far as blocks pass on the type of their input.
    """
    waiting, found, seen = [source], set[IntegerType | None](), set[FlatBlock]()
    while waiting:
        one = waiting.pop()
        if one is None or len(seen) > _LONGEST_WAY:
            return None
        if one.atom in seen:
            continue
        seen.add(one.atom)
        stated = stated_word(one.atom)
        passed = _passing(one.atom)
        if stated is None and passed:
            inputs = one.atom.inputs
            waiting += [inputs[at] if at < len(inputs) else None for at in passed]
        else:
            found.add(stated)
    return _common(found)


def _common(found: set[IntegerType | None]) -> IntegerType | None:
    """The type that all of them are; blocks that make it in different ways are taken as rounding down and wrapping."""
    if len(found) == 1:
        return found.pop()
    plain = {(one.bits, one.signed) if one is not None else None for one in found}
    only = plain.pop() if len(plain) == 1 else None
    return IntegerType(*only) if only is not None else None


def _passing(atom: FlatBlock) -> tuple[int, ...]:
    """The inputs whose type the output has."""
    if (atom.block.value("OutDataTypeStr") or "").strip() in _SAME:
        return (0,)
    return _LIKE_INPUT.get(atom.kind, ())


def stated_word(atom: FlatBlock) -> IntegerType | None:
    """The integer type that a block states for its output."""
    for key in ("OutDataTypeStr", "OutDataTypeMode", "DataType"):
        written = (atom.block.value(key) or "").strip()
        word = word_named(written)
        if word is not None:
            saturates = (atom.block.value("SaturateOnIntegerOverflow") or "off") == "on"
            return replace(word, rounding=atom.block.value("RndMeth") or "Floor", saturates=saturates)
        if written and not written.startswith("Inherit"):
            return None
    cast = _CAST.match((atom.block.value("Value") or "").strip()) if atom.kind == "Constant" else None
    return word_named(cast[1]) if cast is not None else None


def converting(atoms: Iterable[FlatBlock]) -> tuple[str, ...]:
    """The paths of the blocks that make integers of other numbers, which is left aside: values stay physical."""
    return tuple(dict.fromkeys(one.path for one in atoms if _converts(one)))


def _converts(atom: FlatBlock) -> bool:
    """Whether a block makes integers: as it states, in its code by a cast, or in a variable of a chart."""
    if atom.kind in _ONLY_STATING:
        return False
    if stated_word(atom) is not None or _CAST.search(atom.block.script):
        return True
    chart = atom.block.chart if atom.kind == "Chart" else None
    return chart is not None and any(word_named(data.type) for data in chart.data if data.scope in _ASSIGNED)
