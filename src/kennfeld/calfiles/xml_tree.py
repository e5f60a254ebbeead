"""XML as a plain tree that knows its lines; what a calibration file has no need of is refused, not expanded."""

import gc
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from xml.parsers import expat

from kennfeld.calfiles.format import Findings

__all__ = ["PARTED", "Element", "collection_paused", "parsed"]

PARTED = "\x1f"  # parts the texts of equal elements that were joined; no XML can hold it

_DEEPEST = 100  # levels; calibration files have about twenty
_SEPARATORS = (b"|", b"~", b"^", b"`", b"\\", b"$", b"@")
_MOST_GAPS = 50
_PROSE = frozenset({"LONG-NAME", "UNIT-DISPLAY-NAME"})  # their text may hold marks such as <SUP>


@dataclass(slots=True)
class Element:
    """One element: its name without namespace, the text in it, and what it holds."""

    tag: str
    line: int
    text: str = ""
    children: Sequence["Element"] = ()

    def all(self, tag: str) -> Iterator["Element"]:
        """The children of a name."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> "Element | None":
        """The first child of a name."""
        return next(self.all(tag), None)

    def words(self, tag: str) -> list[str]:
        """The texts of all children of a name, joined or not."""
        return [word for child in self.all(tag) for word in child.text.split(PARTED)]

    def line_of(self, tag: str) -> str:
        """The text of the first child of a name as one line; empty where there is none."""
        found = self.first(tag)
        if found is None:
            return ""
        return " ".join(found.text.split()) if "\n" in found.text else found.text


def parsed(raw: bytes, notes: Findings, joined: str = "") -> Element | None:
    """The root of an XML document; None with an error noted where it is broken or declares entities.

    External documents are never loaded: a document type is accepted, an entity (which could name a file of this
    machine, or grow without end) is refused where it is declared. Elements called `joined`, of which there may be
    millions, are read as one where they follow each other; `Element.words` gives the text of each.
    """
    made, separator = _joined(raw, joined.encode("ascii")) if joined else (raw, "")
    builder = _TreeBuilder(notes, joined, separator)
    try:
        builder.parser.Parse(made, True)
    except _RefusedError:
        return None
    except (expat.ExpatError, ValueError, LookupError) as error:
        message = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        remedy = "The file may be cut off or damaged: take a complete copy."
        notes.error(getattr(error, "lineno", 1), "", f"is no well-formed XML: {message}", remedy)
        return None
    return builder.root


@contextmanager
def collection_paused() -> Iterator[None]:
    """While a large tree grows, which has no cycles, Python does not search it for unused objects again and again."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _joined(raw: bytes, tag: bytes) -> tuple[bytes, str]:
    """A document in which `<V>1</V><V>2</V>` is `<V>1|2</V>`, and the character that parts the texts there.

    Line breaks stay, so that every line keeps its number. A document is left as it is where it already uses all
    characters that could part texts, or has literal text in which tags are none.
    """
    ends, begins = b"</" + tag + b">", b"<" + tag + b">"
    separator = next((one for one in _SEPARATORS if one not in raw), None)
    if separator is None or b"<![CDATA[" in raw or raw.count(b"\0", 0, 100):
        return raw, ""
    gap = re.compile(re.escape(ends) + rb"(\s*)" + re.escape(begins))
    made = raw
    for _ in range(_MOST_GAPS):
        found = gap.search(made)
        if found is None:
            return made, separator.decode("ascii")
        made = made.replace(found[0], separator + found[1])
    return raw, ""


class _RefusedError(Exception):
    """Ends the parser; what is wrong is noted already."""


class _TreeBuilder:
    def __init__(self, notes: Findings, joined: str, separator: str) -> None:
        self.notes = notes
        self.joined = joined if separator else ""
        self.separator = separator
        self.root: Element | None = None
        self.open: list[Element] = []
        self.pieces: list[str | list[str]] = []  # the text of each open element, in one piece or several
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.buffer_size = 1 << 16
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._entity
        self.parser.SkippedEntityHandler = self._skipped

    def _start(self, name: str, _: dict[str, str]) -> None:
        if ":" in name:
            name = name.rpartition(":")[2]
        element = Element(name, self.parser.CurrentLineNumber)
        if not self.open:
            self.root = element
        elif isinstance(siblings := self.open[-1].children, list):
            siblings.append(element)
        else:
            self.open[-1].children = [element]
        if len(self.open) >= _DEEPEST:
            self._refuse(f"has elements more than {_DEEPEST} levels deep")
        self.open.append(element)
        self.pieces.append("")

    def _end(self, _: str) -> None:
        element, pieces = self.open.pop(), self.pieces.pop()
        if pieces:
            element.text = pieces if isinstance(pieces, str) else "".join(pieces)
        if element.tag == self.joined:
            element.text = element.text.replace(self.separator, PARTED)
        if self.open and self.open[-1].tag in _PROSE:
            self._characters(element.text)

    def _characters(self, text: str) -> None:
        before = self.pieces[-1]
        if not before:
            self.pieces[-1] = text
        elif isinstance(before, str):
            self.pieces[-1] = [before, text]
        else:
            before.append(text)

    def _entity(self, name: str, *_: object) -> None:
        self._refuse(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _skipped(self, name: str, _: bool) -> None:
        self._refuse(f"uses the entity {name[:60]}, which it does not declare", "Write the characters themselves.")

    def _refuse(self, message: str, remedy: str = "") -> None:
        self.notes.error(self.parser.CurrentLineNumber, "", message, remedy)
        raise _RefusedError
