"""Which integer type a signal has, as far as the file says so: some results depend on the length of a word."""

import re
from typing import NamedTuple

from kennfeld.models.simulink.flattening.atoms import Atom, Source

__all__ = ["Word", "word_of"]

_INTEGER = re.compile(r"(u?)int(8|16|32|64)\Z")
_FIXED = re.compile(r"fixdt\(\s*([01])\s*,\s*(\d{1,3})\s*(?:,\s*0\s*)?\)\Z")
_CAST = re.compile(r"(u?int(?:8|16|32|64))\s*\(")
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


class Word(NamedTuple):
    """An integer type: how many bits, and whether one of them is a sign."""

    bits: int
    signed: bool


def word_of(source: Source | None) -> Word | None:
    """The integer type of a signal; None where the file does not say it, or says that it is no integer.

    It is looked for back along the wires, as far as blocks pass on the type of their input.
    """
    waiting, found, seen = [source], set[Word | None](), set[Atom]()
    while waiting:
        one = waiting.pop()
        if one is None or len(seen) > _LONGEST_WAY:
            return None
        if one.atom in seen:
            continue
        seen.add(one.atom)
        stated = _stated(one.atom)
        if stated is None and one.atom.kind in _LIKE_INPUT:
            inputs = one.atom.inputs
            waiting += [inputs[at] if at < len(inputs) else None for at in _LIKE_INPUT[one.atom.kind]]
        else:
            found.add(stated)
    return found.pop() if len(found) == 1 else None


def _stated(atom: Atom) -> Word | None:
    """The integer type that a block states for its output."""
    for key in ("OutDataTypeStr", "OutDataTypeMode", "DataType"):
        written = (atom.block.value(key) or "").strip()
        word = _word(written)
        if word is not None or (written and not written.startswith("Inherit")):
            return word
    cast = _CAST.match((atom.block.value("Value") or "").strip()) if atom.kind == "Constant" else None
    return _word(cast[1]) if cast is not None else None


def _word(written: str) -> Word | None:
    if found := _INTEGER.match(written):
        return Word(int(found[2]), found[1] == "")
    fixed = _FIXED.match(written)
    return Word(int(fixed[2]), fixed[1] == "1") if fixed else None
