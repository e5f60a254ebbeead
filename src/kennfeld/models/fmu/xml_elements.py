"""XML of a model description as elements with attributes and line numbers; entities are refused, not expanded."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple
from xml.parsers import expat

from kennfeld.errors import InputError, Location

MOST_ELEMENTS = 1_000_000  # of a description; it has several for each variable
MOST_CHILDREN = 200_000  # of an element, such as variables
_MOST_LEVELS = 50


class DescriptionElement(NamedTuple):
    """An element: its tag without namespace, its attributes and its children."""

    tag: str
    line: int
    attributes: Mapping[str, str]
    children: list["DescriptionElement"]

    def all(self, *path: str) -> Iterator["DescriptionElement"]:
        """Yield the elements at a path of tags."""
        for child in self.children:
            if child.tag == path[0]:
                yield from child.all(*path[1:]) if path[1:] else (child,)

    def first(self, *path: str) -> "DescriptionElement | None":
        """Return the first element at a path of tags."""
        return next(self.all(*path), None)


def parse_elements(raw: bytes, file: str) -> DescriptionElement:
    """Return the root of an XML document.

    Raises:
        InputError: the document is malformed, declares entities, or has too many elements.
    """
    builder = _Builder(file)
    try:
        builder.parser.Parse(raw, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        location = Location(file, getattr(error, "lineno", 1))
        raise InputError.of(location, f"not well-formed XML: {message}", "Export the FMU again.") from None
    assert builder.root is not None  # expat reports a document without elements
    return builder.root


class _Builder:
    def __init__(self, file: str) -> None:
        self.file = file
        self.root: DescriptionElement | None = None
        self.open: list[DescriptionElement] = []
        self.count = 0
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.EntityDeclHandler = self._refuse_entity

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        element = DescriptionElement(name.rpartition(":")[2], self.parser.CurrentLineNumber, attributes, [])
        self.count += 1
        if self.count > MOST_ELEMENTS:
            self._refuse(f"more than {MOST_ELEMENTS} elements", "Export the FMU with fewer variables.")
        if len(self.open) >= _MOST_LEVELS:
            self._refuse(f"elements nested more than {_MOST_LEVELS} levels deep", "Export the FMU again.")
        if self.open:
            self.open[-1].children.append(element)
            if len(self.open[-1].children) > MOST_CHILDREN:
                message = f"{self.open[-1].tag} has more than {MOST_CHILDREN} elements"
                self._refuse(message, "Export the FMU without its local variables.")
        else:
            self.root = element
        self.open.append(element)

    def _end(self, _: str) -> None:
        self.open.pop()

    def _refuse_entity(self, name: str, *_: object) -> None:
        self._refuse(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _refuse(self, message: str, remedy: str) -> None:
        raise InputError.of(Location(self.file, self.parser.CurrentLineNumber), message, remedy)
