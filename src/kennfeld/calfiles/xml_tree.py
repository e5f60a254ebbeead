"""Parses XML into a plain tree with line numbers; entities are refused, not expanded.

A tree of lxml takes six times the memory for a file of a million numbers, and three times as long to walk, because it
makes a Python object for each element.
"""

import re
from collections.abc import Iterator, Sequence
from xml.parsers import expat

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.format import FileFindings

SEPARATOR = "\x1f"  # of the texts of equal elements that were joined; no XML can hold it

_MAX_LEVELS = 100  # levels; calibration files have about twenty
_SEPARATORS = (b"|", b"~", b"^", b"`", b"\\", b"$", b"@")
_MAX_GAPS = 50
_PROSE = frozenset({"LONG-NAME", "UNIT-DISPLAY-NAME"})  # their text may hold marks such as <SUP>


@dataclass(slots=True)
class TreeElement:
    """One element: its tag without namespace, its text and its children."""

    tag: str
    line: int
    text: str = ""
    children: Sequence["TreeElement"] = ()

    def all(self, tag: str) -> Iterator["TreeElement"]:
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> "TreeElement | None":
        return next(self.all(tag), None)

    def walk(self, closed: Sequence[str] = ()) -> Iterator["TreeElement"]:
        """Yield the element and all within it, but nothing within elements of the tags `closed`."""
        waiting: list[TreeElement] = [self]
        while waiting:
            element = waiting.pop()
            yield element
            if element.tag not in closed:
                waiting += element.children

    def words(self, tag: str) -> list[str]:
        """Return the texts of all children of a tag, joined or not."""
        return [word for child in self.all(tag) for word in child.text.split(SEPARATOR)]

    def line_of(self, tag: str) -> str:
        """Return the text of the first child of a tag as one line; empty if there is none."""
        child = self.first(tag)
        text = "" if child is None else child.text
        return " ".join(text.split()) if "\n" in text else text


def parse_xml(raw: bytes, findings: FileFindings, joined: str = "") -> TreeElement | None:
    """Return the root of an XML document; None, with an error, if it is malformed or declares entities.

    External documents are never loaded: a document type is accepted, an entity (which could name a file of this
    machine, or grow without end) is refused where it is declared. Elements called `joined`, of which there may be
    millions, are read as one where they follow each other; `TreeElement.words` gives the text of each.
    """
    result, separator = _join_elements(raw, joined.encode("ascii")) if joined else (raw, "")
    builder = _TreeBuilder(findings, joined, separator)
    try:
        builder.parser.Parse(result, True)
    except _RefusedError:
        return None
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        remedy = "The file may be truncated or damaged: use a complete copy."
        findings.error(getattr(error, "lineno", 1), "", f"is not well-formed XML: {message}", remedy)
        return None
    return builder.root


def _join_elements(raw: bytes, tag: bytes) -> tuple[bytes, str]:
    """Return a document in which `<V>1</V><V>2</V>` is `<V>1|2</V>`, and the character that separates the texts there.

    Line breaks stay, so that every line keeps its number. A document is left as it is if it already uses all
    characters that could separate texts, or has literal text in which tags are none.
    """
    ends, begins = b"</" + tag + b">", b"<" + tag + b">"
    separator = next((mark for mark in _SEPARATORS if mark not in raw), None)
    # UTF-16, in which these tags are other bytes
    if separator is None or b"<![CDATA[" in raw or raw.count(b"\0", 0, 100):
        return raw, ""
    gap = re.compile(re.escape(ends) + rb"(\s*)" + re.escape(begins))
    result = raw
    # each kind of gap, such as a line break with its indentation, is replaced in the whole document at once
    for _ in range(_MAX_GAPS):
        match = gap.search(result)
        if match is None:
            return result, separator.decode("ascii")
        result = result.replace(match[0], separator + match[1])
    return raw, ""


class _RefusedError(Exception):
    """Stops the parser; the error is already reported."""


class _TreeBuilder:
    def __init__(self, findings: FileFindings, joined: str, separator: str) -> None:
        self.findings = findings
        self.joined = joined if separator else ""
        self.separator = separator
        self.root: TreeElement | None = None
        self.open: list[TreeElement] = []
        self.pieces: list[list[str]] = []  # the text of each open element
        self.parser = expat.ParserCreate()
        # a text in one piece, not in one for each line
        self.parser.buffer_text = True
        self.parser.buffer_size = 1 << 16
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._refuse_declaration
        self.parser.SkippedEntityHandler = self._refuse_use

    def _start(self, name: str, _: dict[str, str]) -> None:
        if ":" in name:
            name = name.rpartition(":")[2]
        element = TreeElement(name, self.parser.CurrentLineNumber)
        if not self.open:
            self.root = element
        elif isinstance(siblings := self.open[-1].children, list):
            siblings.append(element)
        else:
            self.open[-1].children = [element]
        if len(self.open) >= _MAX_LEVELS:
            self._refuse(f"has elements nested more than {_MAX_LEVELS} levels deep")
        self.open.append(element)
        self.pieces.append([])

    def _end(self, _: str) -> None:
        element = self.open.pop()
        element.text = "".join(self.pieces.pop())
        if element.tag == self.joined:
            element.text = element.text.replace(self.separator, SEPARATOR)
        if self.open and self.open[-1].tag in _PROSE:
            self._characters(element.text)

    def _characters(self, text: str) -> None:
        self.pieces[-1].append(text)

    def _refuse_declaration(self, name: str, *_: object) -> None:
        self._refuse(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _refuse_use(self, name: str, _: bool) -> None:
        self._refuse(f"uses the undeclared entity {name[:60]}", "Write the characters themselves.")

    def _refuse(self, message: str, remedy: str = "") -> None:
        self.findings.error(self.parser.CurrentLineNumber, "", message, remedy)
        raise _RefusedError
