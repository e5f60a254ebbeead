"""XML as a plain tree that knows its lines; what a calibration file has no need of is refused, not expanded."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from kennfeld.calfiles.format import Notes

__all__ = ["Element", "parsed"]

_DEEPEST = 100  # levels; calibration files have about twenty
_PROSE = frozenset({"LONG-NAME", "UNIT-DISPLAY-NAME"})  # their text may hold marks such as <SUP>


@dataclass(slots=True)
class Element:
    """One element: its name without namespace, the text in it, and what it holds."""

    tag: str
    line: int
    text: str = ""
    children: list["Element"] = field(default_factory=list)

    def all(self, tag: str) -> Iterator["Element"]:
        """The children of a name."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> "Element | None":
        """The first child of a name."""
        return next(self.all(tag), None)

    def line_of(self, tag: str) -> str:
        """The text of the first child of a name as one line; empty where there is none."""
        found = self.first(tag)
        if found is None:
            return ""
        return " ".join(found.text.split()) if "\n" in found.text else found.text


def parsed(raw: bytes, notes: Notes) -> Element | None:
    """The root of an XML document; None with an error noted where it is broken or declares entities.

    External documents are never loaded: a document type is accepted, an entity (which could name a file of this
    machine, or grow without end) is refused where it is declared.
    """
    builder = _Builder(notes)
    try:
        builder.parser.Parse(raw, True)
    except _RefusedError:
        return None
    except (expat.ExpatError, ValueError, LookupError) as error:
        what = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        mend = "The file may be cut off or damaged: take a complete copy."
        notes.error(getattr(error, "lineno", 1), "", f"is no well-formed XML: {what}", mend)
        return None
    return builder.root


class _RefusedError(Exception):
    """Ends the parser; what is wrong is noted already."""


class _Builder:
    def __init__(self, notes: Notes) -> None:
        self.notes = notes
        self.root: Element | None = None
        self.open: list[Element] = []
        self.pieces: list[list[str]] = []
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._entity
        self.parser.SkippedEntityHandler = self._skipped

    def _start(self, name: str, _: dict[str, str]) -> None:
        element = Element(name.rpartition(":")[2], self.parser.CurrentLineNumber)
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        if len(self.open) >= _DEEPEST:
            self._refuse(f"has elements more than {_DEEPEST} levels deep")
        self.open.append(element)
        self.pieces.append([])

    def _end(self, _: str) -> None:
        element = self.open.pop()
        element.text = "".join(self.pieces.pop())
        if self.open and self.open[-1].tag in _PROSE:
            self.pieces[-1].append(element.text)

    def _characters(self, text: str) -> None:
        self.pieces[-1].append(text)

    def _entity(self, name: str, *_: object) -> None:
        self._refuse(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _skipped(self, name: str, _: bool) -> None:
        self._refuse(f"uses the entity {name[:60]}, which it does not declare", "Write the characters themselves.")

    def _refuse(self, what: str, mend: str = "") -> None:
        self.notes.error(self.parser.CurrentLineNumber, "", what, mend)
        raise _RefusedError
