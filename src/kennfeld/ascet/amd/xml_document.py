"""Parses the XML of `.amd` files into a tree with lines and positions; entities are refused, not expanded.

The position of an element is kept so that a number in one of its attributes can be replaced in the text.
"""

from collections.abc import Iterator
from dataclasses import field
from typing import Final
from xml.parsers import expat

from kennfeld.errors import InputError, Location
from kennfeld.lazy_dataclass import dataclass

MAX_BYTES: Final = 64_000_000  # of a file
_MAX_LEVELS: Final = 200  # hierarchies of diagrams take three each
_MAX_ELEMENTS: Final = 2_000_000
_DAMAGED: Final = "The file may be truncated or damaged: use a complete copy."


@dataclass(slots=True, eq=False)
class XmlElement:
    """An element: its tag without namespace, attributes, children and text; `begin` is its offset in the bytes."""

    tag: str
    attributes: dict[str, str]
    line: int
    begin: int
    children: list["XmlElement"] = field(default_factory=list)
    text: str = ""

    def get(self, name: str, default: str = "") -> str:
        """Return an attribute."""
        return self.attributes.get(name, default)

    def is_true(self, name: str) -> bool:
        """Return True if an attribute is `true`."""
        return self.attributes.get(name) == "true"

    def all(self, *tags: str) -> Iterator["XmlElement"]:
        """Yield the children of these tags."""
        return (child for child in self.children if child.tag in tags)

    def first(self, *tags: str) -> "XmlElement | None":
        """Return the first child of one of these tags."""
        return next(self.all(*tags), None)

    def at(self, *path: str) -> "XmlElement | None":
        """Return the element at a path of tags."""
        element: XmlElement | None = self
        for tag in path:
            element = None if element is None else element.first(tag)
        return element

    def walk(self) -> Iterator["XmlElement"]:
        """Yield this element and all within it in the order of the file."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting += reversed(element.children)


def parse_amd(raw: bytes, name: str) -> XmlElement:
    """Return the root of an `.amd` file.

    Args:
        raw: the file.
        name: its name in messages.

    Raises:
        InputError: it is not well-formed, too large, or declares entities.

    >>> parse_amd(b'<ComponentData><DataSet name="Data"/></ComponentData>', "a.data.amd").first("DataSet").get("name")
    'Data'
    """
    if len(raw) > MAX_BYTES:
        raise InputError.of(Location(name), f"the file has {len(raw)} bytes; the maximum is {MAX_BYTES}")
    builder = _AmdTreeBuilder(name)
    try:
        builder.parser.Parse(raw, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        line = getattr(error, "lineno", 1)
        raise InputError.of(Location(name, line), f"is not well-formed XML: {message}", _DAMAGED) from None
    assert builder.root is not None
    return builder.root


class _AmdTreeBuilder:
    def __init__(self, name: str) -> None:
        self.name = name
        self.root: XmlElement | None = None
        self.open: list[XmlElement] = []
        self.count = 0
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._refuse_declaration
        self.parser.SkippedEntityHandler = self._refuse_use

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        parser = self.parser
        tag = name.rpartition(":")[2]
        element = XmlElement(tag, attributes, parser.CurrentLineNumber, parser.CurrentByteIndex)
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)
        self.count += 1
        if len(self.open) > _MAX_LEVELS:
            self._refuse(f"has elements nested more than {_MAX_LEVELS} levels deep")
        if self.count > _MAX_ELEMENTS:
            self._refuse(f"has more than {_MAX_ELEMENTS} elements")

    def _end(self, _: str) -> None:
        self.open.pop()

    def _characters(self, text: str) -> None:
        if not text.isspace():
            self.open[-1].text += text

    def _refuse_declaration(self, name: str, *_: object) -> None:
        self._refuse(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _refuse_use(self, name: str, _: bool) -> None:
        self._refuse(f"uses the undeclared entity {name[:60]}", "Write the characters themselves.")

    def _refuse(self, message: str, remedy: str = "") -> None:
        raise InputError.of(Location(self.name, self.parser.CurrentLineNumber), message, remedy)
