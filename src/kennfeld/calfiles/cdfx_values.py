"""The numbers of a CDFX value: V, VH, VF and the groups VG, in which x runs fastest."""

from dataclasses import dataclass, field
from math import isfinite, prod

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Notes, counted
from kennfeld.calfiles.xml_tree import Element

__all__ = ["Values", "array_size", "values_of"]

_NUMBERS = ("V", "VF", "VH")


@dataclass
class Values:
    """What a SW-VALUES-PHYS holds, flat, with the shape its groups give it; x is the last index of that shape."""

    line: int
    numbers: list[float] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    shape: tuple[int, ...] = ()

    def shaped(self, sizes: tuple[int, ...]) -> Float | None:
        """The numbers as an array of these sizes, x first; None where they are not that many or grouped otherwise."""
        if len(self.numbers) != prod(sizes) or (len(self.shape) > 1 and self.shape != sizes[::-1]):
            return None
        return np.array(self.numbers, dtype=np.float64).reshape(sizes[::-1]).T


def values_of(holder: Element | None, name: str, notes: Notes) -> Values | None:
    """The values within a SW-VALUE-CONT or SW-AXIS-CONT.

    None where there are none, and with an error noted for each text that is no number.
    """
    found = None if holder is None else holder.first("SW-VALUES-PHYS")
    if found is None:
        return None
    values = Values(found.line)
    taken = _Taken(name, notes, values)
    shape = taken.group(found)
    if shape is None or taken.wrong:
        return None
    values.shape = shape
    return values


def array_size(holder: Element) -> tuple[int, ...]:
    """What SW-ARRAYSIZE states, x first, without the ones that INCA appends; empty where it states nothing usable."""
    found = holder.first("SW-ARRAYSIZE")
    words = [child.text.strip() for child in found.all("V")] if found else []
    if not all(word.isascii() and word.isdigit() and len(word) < 10 for word in words):
        return ()
    return tuple(int(word) for word in words)


@dataclass
class _Taken:
    """Walks the groups of one value; `group` gives the shape, or None where rows are not equally long."""

    name: str
    notes: Notes
    values: Values
    wrong: bool = False

    def group(self, element: Element) -> tuple[int, ...] | None:
        groups = list(element.all("VG"))
        if not groups:
            before = len(self.values.numbers) + len(self.values.texts)
            self._take(element)
            return (len(self.values.numbers) + len(self.values.texts) - before,)
        shapes = [self.group(group) for group in groups]
        if None in shapes:
            return None
        odd = next((i for i, shape in enumerate(shapes) if shape != shapes[0]), None)
        if odd is not None:
            what = f"group {odd + 1} has {_size(shapes[odd])}, the first has {_size(shapes[0])}"
            self.notes.error(groups[odd].line, self.name, what)
            return None
        return (len(groups), *(shapes[0] or ()))

    def _take(self, element: Element) -> None:
        for child in element.children:
            if child.tag == "VT":
                self.values.texts.append(child.text)
            elif child.tag in _NUMBERS:
                number = _number(child)
                if number is None:
                    word = child.text.strip()[:60]
                    mend = "Write a decimal point." if _has_comma(word) else ""
                    self.notes.error(child.line, self.name, f"{word!r} is no finite number", mend)
                    self.wrong = True
                else:
                    self.values.numbers.append(number)


def _size(shape: tuple[int, ...] | None) -> str:
    return counted(prod(shape or ()), "value")


def _number(element: Element) -> float | None:
    word = element.text.strip()
    try:
        if element.tag == "VH" and "_" not in word:
            return float(int(word, 16))
        number = float(word)
    except (ValueError, OverflowError):
        return None
    return number if isfinite(number) and "_" not in word else None


def _has_comma(word: str) -> bool:
    """Whether a word would be a number with a point for its comma."""
    try:
        return "," in word and isfinite(float(word.replace(",", ".")))
    except ValueError:
        return False
