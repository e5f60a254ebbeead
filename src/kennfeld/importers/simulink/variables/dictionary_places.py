"""Finds where the chunks of a data dictionary (`.sldd`) hold the numbers of each value, so that these can be replaced.

The values are those that `data_dictionary` reads, under the names that a model knows them by: `K` of a variable or an
object, `P.in.A` of the field of a struct. The text around them is never written again.
"""

import re
import sys
from collections.abc import Iterator, Mapping

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement, XmlLimits, parse_xml
from kennfeld.importers.simulink.reader.section_tree import MAX_DEPTH, MAX_SECTIONS
from kennfeld.matlab.values import INTEGERS

REAL = ("double", "single")
TRUTHS = ("logical", "boolean", "bool")

_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_NUMBERS = (*REAL, *TRUTHS, *INTEGERS)
# the sizes of the chunks have been checked when the dictionary was read
_LIMITS = XmlLimits(sys.maxsize, MAX_DEPTH, MAX_SECTIONS, MAX_SECTIONS)


@dataclass(frozen=True)
class NumberSpan:
    """The numbers of a property in a chunk of the archive.

    Attributes:
        chunk: the member of the archive.
        begin: offset of their text in its bytes.
        end: offset behind it.
        kind: the class that the property states.
        shape: the size that it states; they are stored by columns.
        words: the numbers as they are written.
        obstacle: why other numbers cannot be written there, empty if they can.
    """

    chunk: str
    begin: int
    end: int
    kind: str
    shape: tuple[int, ...]
    words: tuple[str, ...]
    obstacle: str = ""


@dataclass(frozen=True)
class ValuePlace:
    """The numbers of a value; None for a value without numbers, such as a text.

    `axes` are the breakpoints of a table object by direction: None, or the name of a Simulink.Breakpoint that holds
    them, if the object itself does not.
    """

    values: NumberSpan | None = None
    axes: tuple[NumberSpan | str | None, ...] = ()


def value_places(chunks: Mapping[str, bytes], file: str) -> dict[str, ValuePlace]:
    """Return the places of the values of a dictionary by name, over all of its chunks.

    Args:
        chunks: the members of the archive that hold entries, by name; of several entries of a name, the last one counts
            in the order of the chunks, as for the reader.
        file: name of the dictionary in messages.
    """
    places: dict[str, ValuePlace] = {}
    for chunk in sorted(chunks, key=lambda name: name.lstrip("/")):
        content = chunks[chunk]
        for entry in parse_xml(content, f"{file} {chunk}", _LIMITS).all("Object"):
            properties = _properties(entry)
            name = properties["Name"].text.strip() if "Name" in properties else ""
            if entry.get("Class") == "DD.ENTRY" and name and "Value" in properties:
                if name in places:
                    # an entry replaces all of an earlier one of its name, fields included
                    places = {key: place for key, place in places.items() if key.partition(".")[0] != name}
                places |= _Chunk(chunk, content).places(name, properties["Value"])
    return places


def _properties(element: XmlElement) -> dict[str, XmlElement]:
    return {part.get("Name"): part for part in element.all("P")}


@dataclass(frozen=True)
class _Chunk:
    name: str
    content: bytes

    def places(self, name: str, section: XmlElement) -> Iterator[tuple[str, ValuePlace]]:
        """Yield the values within a section with their names, first the section's own."""
        if section.get("Class") in _NUMBERS:
            yield name, ValuePlace(self._span(section))
            return
        inner = _single_object(section)
        parts = _properties(inner)
        kind = inner.get("Class") or section.get("Class")
        if kind in ("", "struct"):
            yield name, ValuePlace()
            for field, part in parts.items():
                yield from self.places(f"{name}.{field}", part)
        elif "Table" in parts:
            axes = parts.get("Breakpoints")
            yield name, ValuePlace(self._inner_span(parts["Table"]), () if axes is None else self._axes(axes))
        elif "Value" in parts:
            # the value of a Simulink.Parameter may be a struct
            yield from self.places(name, parts["Value"])
        else:
            yield name, ValuePlace(self._inner_span(parts["Breakpoints"]) if "Breakpoints" in parts else None)

    def _inner_span(self, section: XmlElement) -> NumberSpan | None:
        """Return the numbers of a property, or of the `Value` of its object; None if it has none of its own."""
        if section.get("Class") in _NUMBERS:
            return self._span(section)
        value = _properties(_single_object(section)).get("Value")
        return self._span(value) if value is not None and value.get("Class") in _NUMBERS else None

    def _axes(self, section: XmlElement) -> tuple[NumberSpan | str | None, ...]:
        elements = [*section.all("Element")] or [section]
        return tuple(element.text.strip() or None if element.get("Class") in ("char", "string")
                     else self._inner_span(element) for element in elements)  # fmt: skip

    def _span(self, section: XmlElement) -> NumberSpan | None:
        tag = _TAG.match(self.content, section.begin)
        if tag is None:
            return None
        end = tag.end() if tag[0].endswith(b"/>") else self.content.index(b"<", tag.end())
        words = tuple(self.content[tag.end() : end].decode("ascii", "replace").split())
        # without a size: a number or a row
        size = section.get("Dimension") or f"1*{len(words)}"
        shape = tuple(int(count) if count.isdecimal() else -1 for count in size.split("*"))
        kind = section.get("Class")
        return NumberSpan(self.name, tag.end(), end, kind, shape, words, _obstacle(section, words, shape))


def _single_object(section: XmlElement) -> XmlElement:
    """Return the only object of a property: an element of it, or the property itself; for several, a placeholder."""
    elements = [*section.all("Element")]
    if not elements:
        return section
    return elements[0] if len(elements) == 1 else XmlElement("Element", {"Class": "several"}, section.line)


def _obstacle(section: XmlElement, words: tuple[str, ...], shape: tuple[int, ...]) -> str:
    if section.get("Encoding"):
        return "is stored as bytes"
    if section.is_true("IsComplex") or any("i" in word.lower().replace("inf", "") for word in words):
        return "is complex"
    count = 1
    for size in shape:
        count *= size
    return "" if count == len(words) and not section.children else "cannot be read"
