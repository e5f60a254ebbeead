"""The instances of a CDFX file: one a label, whether they stand side by side, in each other, or in variants."""

from collections.abc import Iterator
from dataclasses import dataclass

from kennfeld.calfiles.format import Notes, counted
from kennfeld.calfiles.xml_tree import Element

__all__ = ["Instance", "instances"]

_VARIANTS, _VARIANT = "SW-INSTANCE-PROPS-VARIANTS", "SW-INSTANCE-PROPS-VARIANT"
_LEFT_ASIDE = {"SW-FEATURE-REF": "function", "SW-CS-HISTORY": "history"}


@dataclass(frozen=True)
class Instance:
    """One label: what names it, and the elements that hold its values and axes."""

    name: str
    category: str
    description: str
    line: int
    value: Element | None  # SW-VALUE-CONT
    axes: tuple[Element, ...]  # SW-AXIS-CONT

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return self.value.line_of("UNIT-DISPLAY-NAME") if self.value else ""


def instances(root: Element, notes: Notes) -> list[Instance]:
    """All labels that hold something, in the order of the file; says what of them is left aside."""
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
    holder = _holder(element, name, notes)
    value, axes = holder.first("SW-VALUE-CONT"), holder.first("SW-AXIS-CONTS")
    if value is not None or not inner:
        category = element.line_of("CATEGORY").strip().upper()
        conts = tuple(axes.all("SW-AXIS-CONT")) if axes else ()
        yield Instance(name, category, element.line_of("LONG-NAME"), element.line, value, conts)
    for child in inner:
        yield from _flat(child, name, notes)


def _holder(element: Element, name: str, notes: Notes) -> Element:
    """What holds the values: the instance itself, or its first variant."""
    variants = element.first(_VARIANTS)
    found = list(variants.all(_VARIANT)) if variants else []
    for other in found[1:]:
        what = f"is another variant{_called(other)} of the label in line {element.line}; left aside"
        notes.remark(other.line, name, what)
    return found[0] if found else element


def _called(variant: Element) -> str:
    words = [text for child in variant.children if child.tag not in _HELD for text in _texts(child)]
    return f" ({' '.join(words)[:60]})" if words else ""


_HELD = ("SW-VALUE-CONT", "SW-AXIS-CONTS", "SW-CS-HISTORY", "SW-MODEL-LINK")


def _texts(element: Element) -> Iterator[str]:
    if element.text.strip():
        yield element.text.strip()
    for child in element.children:
        yield from _texts(child)


def _tell_left_aside(root: Element, notes: Notes) -> None:
    kept: dict[str, list[str]] = {tag: [] for tag in _LEFT_ASIDE}
    waiting = [root]
    while waiting:
        element = waiting.pop()
        if element.tag in kept:
            kept[element.tag].append(element.text.strip())
        if element.tag not in ("SW-VALUE-CONT", "SW-AXIS-CONTS"):
            waiting += element.children
    functions = len(set(kept["SW-FEATURE-REF"]))
    histories = len(kept["SW-CS-HISTORY"])
    told = [counted(functions, "name") + " of functions"] if functions else []
    told += ["1 history" if histories == 1 else f"{histories} histories"] if histories else []
    if told:
        notes.remark(0, "", f"{' and '.join(told)} left aside")
