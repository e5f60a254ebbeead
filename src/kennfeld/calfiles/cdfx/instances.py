"""The instances of a CDFX file: one a label, whether they stand side by side, in each other, or in variants."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from kennfeld.calfiles.format import Notes
from kennfeld.calfiles.xml_tree import PARTED, Element

__all__ = ["Instance", "instances"]

_VARIANTS, _VARIANT = "SW-INSTANCE-PROPS-VARIANTS", "SW-INSTANCE-PROPS-VARIANT"


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
        """What every parameter and text keeps of it."""
        named = {"display_name": self.display_name, "variant": self.variant}
        return {"description": self.description, "functions": self.functions, **named}

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return self.value.line_of("UNIT-DISPLAY-NAME") if self.value else ""


def instances(root: Element, notes: Notes) -> list[Instance]:
    """All labels that hold something, once a variant, in the order of the file; says what is left aside."""
    found: list[Instance] = []
    for tree in _trees(root):
        for element in tree.all("SW-INSTANCE"):
            found += _flat(element, "", notes)
    _tell_left_aside(root, notes)
    return found


def _trees(element: Element) -> Iterator[Element]:
    """The SW-INSTANCE-TREEs, however many systems and specifications are around them."""
    for child in element.children:
        if child.tag == "SW-INSTANCE-TREE":
            yield child
        elif child.tag in ("SW-SYSTEMS", "SW-SYSTEM", "SW-INSTANCE-SPEC"):
            yield from _trees(child)


def _flat(element: Element, outer: str, notes: Notes) -> Iterator[Instance]:
    """An instance and those within it; INCA may write the label a.b.c as c in b in a."""
    name = element.line_of("SHORT-NAME").strip()
    name = name if not outer or name.startswith("[") else f"{outer}.{name}"
    name = outer + name if outer and name.startswith("[") else name
    if not name:
        notes.error(element.line, "", "SW-INSTANCE has no SHORT-NAME", "Give it a name.")
        return
    inner = list(element.all("SW-INSTANCE"))
    for holder, variant in _holders(element, bool(inner), name, notes):
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
        yield from _flat(child, name, notes)


def _holders(element: Element, has_inner: bool, name: str, notes: Notes) -> Iterator[tuple[Element, str]]:
    """What holds values: the instance itself, or each of its variants with its name."""
    variants = element.first(_VARIANTS)
    found: dict[str, Element] = {}
    for holder in variants.all(_VARIANT) if variants else ():
        first = found.setdefault(_variant(holder), holder)
        if first is not holder:
            what = f"is another variant with the criteria of that in line {first.line}; left aside"
            notes.remark(holder.line, name, what)
    if found:
        yield from ((holder, variant) for variant, holder in found.items())
    elif element.first("SW-VALUE-CONT") is not None or not has_inner:
        yield element, ""


def _variant(holder: Element) -> str:
    """The criteria of a variant: `Engine=2,Gear=1`; a reference without a value stands alone."""
    return ",".join(word for child in holder.children if child.tag not in _HELD for word in _criteria(child))


_HELD = ("SW-VALUE-CONT", "SW-AXIS-CONTS", "SW-CS-HISTORY", "SW-MODEL-LINK", "CATEGORY")


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


def _tell_left_aside(root: Element, notes: Notes) -> None:
    histories = 0
    waiting: list[Element] = [root]
    while waiting:
        element = waiting.pop()
        histories += element.tag == "SW-CS-HISTORY"
        if element.tag not in ("SW-VALUE-CONT", "SW-AXIS-CONTS"):
            waiting += element.children
    if histories:
        notes.remark(0, "", f"{histories} histor{'y' if histories == 1 else 'ies'} left aside")
