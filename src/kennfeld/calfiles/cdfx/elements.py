"""Instances of a CDFX file, nested or in variants, and their values (V, VH, VF in groups VG, x running fastest)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import isfinite, prod
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.calfiles.xml_tree import PARTED, Element
from kennfeld.formatting import count_noun

_VARIANTS, _VARIANT = "SW-INSTANCE-PROPS-VARIANTS", "SW-INSTANCE-PROPS-VARIANT"

_VALUE_TAGS = ("SW-VALUE-CONT", "SW-AXIS-CONTS", "SW-CS-HISTORY", "SW-MODEL-LINK", "CATEGORY")

_NUMBERS = ("V", "VF", "VH")


@dataclass(frozen=True)
class Instance:
    """One label in one variant: what names it, and the elements that hold its values and axes."""

    name: str
    category: str
    description: str
    line: int
    value: Element | None  # SW-VALUE-CONT
    axes: tuple[Element, ...]  # SW-AXIS-CONT
    functions: tuple[str, ...] = ()
    display_name: str = ""
    variant: str = ""

    @property
    def labels(self) -> dict[str, Any]:
        """The attributes that parameters and texts keep."""
        named = {"display_name": self.display_name, "variant": self.variant}
        return {"description": self.description, "functions": self.functions, **named}

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return self.value.line_of("UNIT-DISPLAY-NAME") if self.value else ""


def instances(root: Element, findings: Findings) -> list[Instance]:
    """Return all labels with values, once per variant, in file order; report what is skipped."""
    results: list[Instance] = []
    for tree in _trees(root):
        for element in tree.all("SW-INSTANCE"):
            results += _flatten(element, "", findings)
    _report_histories(root, findings)
    return results


def _trees(element: Element) -> Iterator[Element]:
    """Return the SW-INSTANCE-TREEs, however many systems and specifications are around them."""
    for child in element.children:
        if child.tag == "SW-INSTANCE-TREE":
            yield child
        elif child.tag in ("SW-SYSTEMS", "SW-SYSTEM", "SW-INSTANCE-SPEC"):
            yield from _trees(child)


def _flatten(element: Element, outer: str, findings: Findings) -> Iterator[Instance]:
    """Return an instance and those within it; INCA may write the label a.b.c as c in b in a."""
    name = element.line_of("SHORT-NAME").strip()
    name = name if not outer or name.startswith("[") else f"{outer}.{name}"
    name = outer + name if outer and name.startswith("[") else name
    if not name:
        findings.error(element.line, "", "SW-INSTANCE has no SHORT-NAME", "Give it a name.")
        return
    inner = list(element.all("SW-INSTANCE"))
    for holder, variant in _holders(element, bool(inner), name, findings):
        value, axes = holder.first("SW-VALUE-CONT"), holder.first("SW-AXIS-CONTS")
        yield Instance(
            name,
            element.line_of("CATEGORY").strip().upper(),
            element.line_of("LONG-NAME"),
            holder.line if variant else element.line,
            value,
            tuple(axes.all("SW-AXIS-CONT")) if axes else (),
            tuple(filter(None, (reference.text.strip() for reference in element.all("SW-FEATURE-REF")))),
            element.line_of("DISPLAY-NAME").strip(),
            variant,
        )
    for child in inner:
        yield from _flatten(child, name, findings)


def _holders(element: Element, has_inner: bool, name: str, findings: Findings) -> Iterator[tuple[Element, str]]:
    """Yield the elements that contain values: the instance itself, or each variant with its name."""
    variants = element.first(_VARIANTS)
    results: dict[str, Element] = {}
    for holder in variants.all(_VARIANT) if variants else ():
        first = results.setdefault(_variant(holder), holder)
        if first is not holder:
            message = f"is a variant with the same criteria as in line {first.line}; skipped"
            findings.warning(holder.line, name, message)
    if results:
        yield from ((holder, variant) for variant, holder in results.items())
    elif element.first("SW-VALUE-CONT") is not None or not has_inner:
        yield element, ""


def _variant(holder: Element) -> str:
    """Return the criteria of a variant: `Engine=2,Gear=1`; a reference without a value stands alone."""
    return ",".join(word for child in holder.children if child.tag not in _VALUE_TAGS for word in _criteria(child))


def _criteria(element: Element) -> Iterator[str]:
    references = [child for child in element.children if child.tag.endswith("-REF")]
    values = [child.text.strip() for child in element.children if child.tag in ("VT", "V", "VF", "VH")]
    if len(references) == 1 and len(values) == 1:
        yield f"{references[0].text.strip()}={values[0]}"
        return
    if element.text.strip():
        yield " ".join(element.text.replace(PARTED, " ").split())
    for child in element.children:
        yield from _criteria(child)


def _report_histories(root: Element, findings: Findings) -> None:
    histories = 0
    waiting: list[Element] = [root]
    while waiting:
        element = waiting.pop()
        histories += element.tag == "SW-CS-HISTORY"
        if element.tag not in ("SW-VALUE-CONT", "SW-AXIS-CONTS"):
            waiting += element.children
    if histories:
        findings.warning(0, "", f"{histories} histor{'y' if histories == 1 else 'ies'} skipped")


@dataclass
class Values:
    """The content of a SW-VALUES-PHYS, flat, with the shape given by its groups; x is the last index."""

    line: int
    numbers: list[float] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    shape: tuple[int, ...] = ()

    def shaped(self, sizes: tuple[int, ...]) -> Float | None:
        """Return the numbers as an array of these sizes, x first; None if count or grouping differs."""
        if len(self.numbers) != prod(sizes) or (len(self.shape) > 1 and self.shape != sizes[::-1]):
            return None
        return np.array(self.numbers, dtype=np.float64).reshape(sizes[::-1]).T


def values_of(holder: Element | None, name: str, findings: Findings) -> Values | None:
    """Return the values within a SW-VALUE-CONT or SW-AXIS-CONT.

    None if there are none, and with an error for each invalid number.
    """
    found = None if holder is None else holder.first("SW-VALUES-PHYS")
    if found is None:
        return None
    values = Values(found.line)
    taken = _ValueWalker(name, findings, values)
    shape = taken.group(found)
    if shape is None or taken.wrong:
        return None
    values.shape = shape
    return values


def array_size(holder: Element) -> tuple[int, ...]:
    """Return the SW-ARRAYSIZE, x first; empty if it states nothing usable."""
    found = holder.first("SW-ARRAYSIZE")
    words = [word.strip() for word in found.words("V")] if found else []
    if not all(word.isascii() and word.isdigit() and len(word) < 10 for word in words):
        return ()
    return tuple(int(word) for word in words)


@dataclass
class _ValueWalker:
    """Walks the groups of one value; `group` returns the shape, or None if rows differ in length."""

    name: str
    findings: Findings
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
            message = (
                f"group {odd + 1} has {_describe_size(shapes[odd])}, but the first has {_describe_size(shapes[0])}"
            )
            self.findings.error(groups[odd].line, self.name, message)
            return None
        return (len(groups), *(shapes[0] or ()))

    def _take(self, element: Element) -> None:
        for child in element.children:
            if child.tag == "VT":
                self.values.texts.append(child.text)
            elif child.tag in _NUMBERS:
                words = child.text.split(PARTED)
                # Python would read 1_000 as a thousand.
                numbers = None if "_" in child.text else _parse_numbers(child.tag, words)
                if numbers is None:
                    self._wrong(child, words)
                else:
                    self.values.numbers += numbers

    def _wrong(self, child: Element, words: list[str]) -> None:
        """Report each invalid number with its line."""
        line = child.line
        for word in words:
            if "_" in word or _parse_numbers(child.tag, [word]) is None:
                shown = word.strip()[:60]
                remedy = "Write a decimal point." if _has_comma(shown) else ""
                at = line + word[: len(word) - len(word.lstrip())].count("\n")
                self.findings.error(at, self.name, f"must be a finite number, got {shown!r}", remedy)
            line += word.count("\n")
        self.wrong = True


def _describe_size(shape: tuple[int, ...] | None) -> str:
    return count_noun(prod(shape or ()), "value")


def _parse_numbers(tag: str, words: list[str]) -> list[float] | None:
    """Return the numbers of words; None if one of them is none, or not finite."""
    try:
        numbers = [float(int(word, 16)) for word in words] if tag == "VH" else list(map(float, words))
    except (ValueError, OverflowError):
        return None
    return numbers if all(map(isfinite, numbers)) else None


def _has_comma(word: str) -> bool:
    """Check whether a word would be a number with a decimal point instead of a comma."""
    try:
        return "," in word and isfinite(float(word.replace(",", ".")))
    except ValueError:
        return False
