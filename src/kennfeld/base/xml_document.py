"""Parses XML of files that others wrote into a tree with lines and positions, within limits of size, depth and number.

External documents are never loaded. An entity, which could name a file of this machine or grow without end, is refused
where it is declared.
"""

from collections.abc import Iterator
from dataclasses import field
from typing import NamedTuple
from xml.parsers import expat

from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass


class XmlLimits(NamedTuple):
    """Limits of a document, and the remedies for those that exceed them or are damaged.

    Attributes:
        size: bytes.
        levels: levels of elements within each other.
        elements: elements of the document.
        children: elements within one element.
        reduced: the remedy for a document beyond a limit.
        complete: the remedy for one that is not well-formed.
        keeps_text: False if the text of elements is not needed.
    """

    size: int
    levels: int
    elements: int
    children: int
    reduced: str = ""
    complete: str = "The file may be truncated or damaged: use a complete copy."
    keeps_text: bool = True


@dataclass(slots=True, eq=False)
class XmlElement:
    """An element: its tag without namespace, attributes, children and text; `begin` is its offset in the bytes."""

    tag: str
    attributes: dict[str, str]
    line: int
    begin: int = 0
    children: list["XmlElement"] = field(default_factory=list)
    text: str = ""

    def get(self, name: str, default: str = "") -> str:
        """Return an attribute."""
        return self.attributes.get(name, default)

    def is_true(self, name: str) -> bool:
        """Return True if an attribute is `true` or `1`."""
        return self.attributes.get(name) in ("true", "1")

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
            # the end is taken next, which has to be the first child
            waiting += reversed(element.children)


def parse_xml(raw: bytes, name: str, limits: XmlLimits) -> XmlElement:
    """Return the root of a document.

    Args:
        raw: the document.
        name: name of its file in messages.
        limits: limits and remedies.

    Raises:
        InputError: it is not well-formed, exceeds a limit, or declares entities.

    >>> limits = XmlLimits(size=1000, levels=3, elements=10, children=10)
    >>> parse_xml(b'<data><set name="Data"/></data>', "a.xml", limits).first("set").get("name")
    'Data'
    """
    if len(raw) > limits.size:
        message = f"the file has {len(raw)} bytes; the maximum is {limits.size}"
        raise InputError.of(Location(name), message, limits.reduced)
    builder = _DocumentBuilder(name, limits)
    try:
        builder.parser.Parse(raw, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        location = Location(name, getattr(error, "lineno", 1))
        raise InputError.of(location, f"is not well-formed XML: {message}", limits.complete) from None
    assert builder.root is not None  # expat reports a document without elements
    return builder.root


class _DocumentBuilder:
    def __init__(self, name: str, limits: XmlLimits) -> None:
        self.name, self.limits = name, limits
        self.root: XmlElement | None = None
        self.open: list[XmlElement] = []
        self.pieces: list[list[str] | None] = []  # the text of each open element; joined once, because it may be long
        self.count = 0
        self.parser = expat.ParserCreate()
        # a text in one piece, not in one for each line
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters if limits.keeps_text else None
        self.parser.EntityDeclHandler = self._refuse_declaration
        self.parser.SkippedEntityHandler = self._refuse_use

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        parser, limits = self.parser, self.limits
        tag = name.rpartition(":")[2] if ":" in name else name
        element = XmlElement(tag, attributes, parser.CurrentLineNumber, parser.CurrentByteIndex)
        if self.open:
            parent = self.open[-1]
            parent.children.append(element)
            if len(parent.children) > limits.children:
                self._refuse(f"{parent.tag[:60]} has more than {limits.children} elements", limits.reduced)
        else:
            self.root = element
        self.open.append(element)
        self.pieces.append(None)
        self.count += 1
        if len(self.open) > limits.levels:
            self._refuse(f"has elements nested more than {limits.levels} levels deep", limits.reduced)
        if self.count > limits.elements:
            self._refuse(f"has more than {limits.elements} elements", limits.reduced)

    def _end(self, _: str) -> None:
        element, pieces = self.open.pop(), self.pieces.pop()
        if pieces is not None:
            element.text = "".join(pieces)

    def _characters(self, text: str) -> None:
        # the indentation between elements
        if text.isspace():
            return
        pieces = self.pieces[-1]
        if pieces is None:
            self.pieces[-1] = [text]
        else:
            pieces.append(text)

    def _refuse_declaration(self, name: str, *_: object) -> None:
        self._refuse(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _refuse_use(self, name: str, _: bool) -> None:
        self._refuse(f"uses the undeclared entity {name[:60]}", "Write the characters themselves.")

    def _refuse(self, message: str, remedy: str) -> None:
        raise InputError.of(Location(self.name, self.parser.CurrentLineNumber), message, remedy)
