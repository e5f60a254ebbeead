"""The numbers of a CDFX value: V, VH, VF and the groups VG, in which x runs fastest."""

from dataclasses import dataclass, field
from math import isfinite, prod

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Notes, counted
from kennfeld.calfiles.xml_tree import PARTED, Element

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
    words = [word.strip() for word in found.words("V")] if found else []
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
                words = child.text.split(PARTED)
                # Python would read 1_000 as a thousand.
                numbers = None if "_" in child.text else _numbers(child.tag, words)
                if numbers is None:
                    self._wrong(child, words)
                else:
                    self.values.numbers += numbers

    def _wrong(self, child: Element, words: list[str]) -> None:
        """Name each word that is no number, with its line."""
        line = child.line
        for word in words:
            if "_" in word or _numbers(child.tag, [word]) is None:
                shown = word.strip()[:60]
                mend = "Write a decimal point." if _has_comma(shown) else ""
                at = line + word[: len(word) - len(word.lstrip())].count("\n")
                self.notes.error(at, self.name, f"{shown!r} is no finite number", mend)
            line += word.count("\n")
        self.wrong = True


def _size(shape: tuple[int, ...] | None) -> str:
    return counted(prod(shape or ()), "value")


def _numbers(tag: str, words: list[str]) -> list[float] | None:
    """The numbers of words; None where one of them is none, or not finite."""
    try:
        numbers = [float(int(word, 16)) for word in words] if tag == "VH" else list(map(float, words))
    except (ValueError, OverflowError):
        return None
    return numbers if all(map(isfinite, numbers)) else None


def _has_comma(word: str) -> bool:
    """Whether a word would be a number with a point for its comma."""
    try:
        return "," in word and isfinite(float(word.replace(",", ".")))
    except ValueError:
        return False
