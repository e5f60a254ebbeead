"""Instances of a CDFX file, nested or in variants, and their values (V, VH, VF in groups VG, x running fastest)."""

from collections.abc import Iterator
from dataclasses import field
from math import isfinite, nan, prod
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import parse_float
from kennfeld.calfiles.format import FileFindings
from kennfeld.calfiles.xml_tree import SEPARATOR, TreeElement
from kennfeld.domain.parameters import LABELS

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
    value: TreeElement | None  # SW-VALUE-CONT
    axes: tuple[TreeElement, ...]  # SW-AXIS-CONT
    functions: tuple[str, ...] = ()
    display_name: str = ""
    variant: str = ""

    @property
    def labels(self) -> dict[str, Any]:
        """The attributes that parameters and texts keep, with the unit of the values."""
        return {label: getattr(self, label) for label in LABELS} | {"unit": self.unit}

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return self.value.line_of("UNIT-DISPLAY-NAME") if self.value else ""


def instances(root: TreeElement, findings: FileFindings) -> list[Instance]:
    """Return all labels with values, once per variant, in file order; report what is skipped."""
    results: list[Instance] = []
    for tree in _trees(root):
        for element in tree.all("SW-INSTANCE"):
            results += _flatten(element, "", findings)
    # those of values and axes are no histories of labels
    histories = sum(element.tag == "SW-CS-HISTORY" for element in root.walk(("SW-VALUE-CONT", "SW-AXIS-CONTS")))
    if histories:
        findings.warning(0, "", f"{histories} histor{'y' if histories == 1 else 'ies'} skipped")
    return results


def _trees(element: TreeElement) -> Iterator[TreeElement]:
    """Return the SW-INSTANCE-TREEs, however many systems and specifications are around them."""
    for child in element.children:
        if child.tag == "SW-INSTANCE-TREE":
            yield child
        elif child.tag in ("SW-SYSTEMS", "SW-SYSTEM", "SW-INSTANCE-SPEC"):
            yield from _trees(child)


def _flatten(element: TreeElement, outer: str, findings: FileFindings) -> Iterator[Instance]:
    """Return an instance and those within it; INCA may write the label a.b.c as c in b in a."""
    name = element.line_of("SHORT-NAME").strip()
    if outer:
        name = outer + name if name.startswith("[") else f"{outer}.{name}"
    if not name:
        findings.error(element.line, "", "SW-INSTANCE has no SHORT-NAME", "Give it a name.")
        return
    inner = list(element.all("SW-INSTANCE"))
    for variant, holder in _holders(element, bool(inner), name, findings):
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


def _holders(
    element: TreeElement, has_inner: bool, name: str, findings: FileFindings
) -> Iterator[tuple[str, TreeElement]]:
    """Yield the elements that contain values, each with its variant: the instance itself, or one per variant."""
    variants = element.first(_VARIANTS)
    results: dict[str, TreeElement] = {}
    for holder in variants.all(_VARIANT) if variants else ():
        # Engine=2,Gear=1; a reference without a value stands alone
        parts = [child for child in holder.children if child.tag not in _VALUE_TAGS]
        criteria = ",".join(word for child in parts for word in _criteria(child))
        first = results.setdefault(criteria, holder)
        if first is not holder:
            message = f"is a variant with the same criteria as in line {first.line}; skipped"
            findings.warning(holder.line, name, message)
    # without values of its own, an instance only groups others
    if not results and (element.first("SW-VALUE-CONT") is not None or not has_inner):
        results[""] = element
    yield from results.items()


def _criteria(element: TreeElement) -> Iterator[str]:
    references = [child for child in element.children if child.tag.endswith("-REF")]
    values = [child.text.strip() for child in element.children if child.tag in ("VT", "V", "VF", "VH")]
    if len(references) == 1 and len(values) == 1:
        yield f"{references[0].text.strip()}={values[0]}"
        return
    if element.text.strip():
        yield " ".join(element.text.replace(SEPARATOR, " ").split())
    for child in element.children:
        yield from _criteria(child)


@dataclass(frozen=True)
class Values:
    """The content of a SW-VALUES-PHYS, flat, with the shape given by its groups; x is the last index."""

    numbers: list[float]
    texts: list[str]
    shape: tuple[int, ...]

    def shaped(self, sizes: tuple[int, ...]) -> Float | None:
        """Return the numbers as Float[x, y, ...] of these sizes; None if count or grouping differs."""
        # a flat list fits every shape of its size
        if len(self.numbers) != prod(sizes) or (len(self.shape) > 1 and self.shape != sizes[::-1]):
            return None
        # x runs fastest
        return np.array(self.numbers, dtype=np.float64).reshape(sizes[::-1]).T


def values_of(holder: TreeElement | None, name: str, findings: FileFindings) -> Values | None:
    """Return the values within a SW-VALUE-CONT or SW-AXIS-CONT.

    None if there are none, and with an error for each invalid number.
    """
    element = None if holder is None else holder.first("SW-VALUES-PHYS")
    if element is None:
        return None
    walker = _ValueWalker(name, findings)
    shape = walker.group(element)
    return None if shape is None or walker.has_errors else Values(walker.numbers, walker.texts, shape)


def array_size(holder: TreeElement) -> tuple[int, ...]:
    """Return the SW-ARRAYSIZE, x first; empty if it states nothing usable."""
    sizes = holder.first("SW-ARRAYSIZE")
    words = [word.strip() for word in sizes.words("V")] if sizes else []
    if not all(word.isascii() and word.isdigit() and len(word) < 10 for word in words):
        return ()
    return tuple(int(word) for word in words)


@dataclass
class _ValueWalker:
    """Walks the groups of one value; `group` returns the shape, or None if rows differ in length."""

    name: str
    findings: FileFindings
    numbers: list[float] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    has_errors: bool = False

    def group(self, element: TreeElement) -> tuple[int, ...] | None:
        groups = list(element.all("VG"))
        if not groups:
            before = len(self.numbers) + len(self.texts)
            self._take(element)
            return (len(self.numbers) + len(self.texts) - before,)
        shapes = [self.group(group) for group in groups]
        if None in shapes:
            return None
        odd = next((i for i, shape in enumerate(shapes) if shape != shapes[0]), None)
        if odd is not None:
            size, first = (count_noun(prod(shapes[at] or ()), "value") for at in (odd, 0))
            message = f"group {odd + 1} has {size}, but the first has {first}"
            self.findings.error(groups[odd].line, self.name, message)
            return None
        return (len(groups), *(shapes[0] or ()))

    def _take(self, element: TreeElement) -> None:
        for child in element.children:
            if child.tag == "VT":
                self.texts.append(child.text)
            elif child.tag in _NUMBERS:
                words = child.text.split(SEPARATOR)
                numbers = [_parse_number(child.tag, word) for word in words]
                if all(map(isfinite, numbers)):
                    self.numbers += numbers
                else:
                    self._report_wrong_numbers(child, words, numbers)

    def _report_wrong_numbers(self, child: TreeElement, words: list[str], numbers: list[float]) -> None:
        line = child.line
        for word, number in zip(words, numbers, strict=True):
            if not isfinite(number):
                text = word.strip()[:60]
                has_comma = "," in text and isfinite(parse_float(text.replace(",", ".")))
                remedy = "Write a decimal point." if has_comma else ""
                # of the element's lines, the one that the word is in
                at = line + word[: len(word) - len(word.lstrip())].count("\n")
                self.findings.error(at, self.name, f"must be a finite number, got {text!r}", remedy)
            line += word.count("\n")
        self.has_errors = True


def _parse_number(tag: str, word: str) -> float:
    if tag != "VH":
        return parse_float(word)
    try:
        return nan if "_" in word else float(int(word, 16))
    except (ValueError, OverflowError):
        return nan
