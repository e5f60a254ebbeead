"""XML parts of Simulink files as sections.

External documents are never loaded; an entity (which could name a file of this machine, or grow without end) is
refused where it is declared.
"""

from xml.parsers import expat

from kennfeld.models.simulink.files.section import DEEPEST, MOST_SECTIONS, Section
from kennfeld.models.simulink.files.trouble import RefusedError, Trouble

__all__ = ["xml_section"]

_DAMAGED = "The file may be cut off or damaged: take a complete copy."


def xml_section(raw: bytes, part: str, trouble: Trouble, fold: bool = True) -> Section | None:
    """The root of an XML part as a section; None with an error noted where it is broken or refused.

    `fold` makes `<P Name="key">value</P>` a key of the section around it; without it, it stays a section.
    """
    builder = _Builder(part, trouble, fold)
    try:
        builder.parser.Parse(raw.lstrip(), True)
    except RefusedError:
        return None
    except (expat.ExpatError, ValueError, LookupError) as error:
        what = expat.errors.messages.get(getattr(error, "code", 0), str(error))
        place = f"{part} line {getattr(error, 'lineno', 1)}"
        trouble.error(place, f"is no well-formed XML: {what}", _DAMAGED)
        return None
    return builder.root


class _Builder:
    def __init__(self, part: str, trouble: Trouble, fold: bool) -> None:
        self.part = part
        self.fold = fold
        self.trouble = trouble
        self.root: Section | None = None
        self.open: list[Section] = []
        self.key: str | None = None
        self.pieces: list[str] = []
        self.count = 0
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self.pieces.append
        self.parser.EntityDeclHandler = self._entity
        self.parser.SkippedEntityHandler = self._skipped

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.fold and name == "P" and "Name" in attributes and self.open and self.key is None:
            self._key(attributes)
            return
        self.pieces.clear()
        section = Section(name.rpartition(":")[2], self.parser.CurrentLineNumber, attributes)
        if self.open:
            self.open[-1].parts.append(section)
        elif self.root is None:
            self.root = section
        self.open.append(section)
        if len(self.open) > DEEPEST:
            raise self._refused(f"has elements more than {DEEPEST} levels deep")
        if self.count > MOST_SECTIONS:
            raise self._refused(f"has more than {MOST_SECTIONS} elements")

    def _key(self, attributes: dict[str, str]) -> None:
        self.pieces.clear()
        key = attributes["Name"]
        if "Ref" in attributes:
            self.open[-1].links[key] = attributes["Ref"]
        self.key = key

    def _end(self, name: str) -> None:
        if self.key is not None and name == "P":
            section = self.open[-1]
            if self.key not in section.links:
                section.keys[self.key] = "".join(self.pieces)
            self.key = None
            self.pieces.clear()
            return
        section = self.open.pop()
        if self.pieces and not section.parts:
            section.text = "".join(self.pieces)
        self.pieces.clear()

    def _entity(self, name: str, *_: object) -> None:
        raise self._refused(f"declares the entity {name[:60]}", "Remove the declarations within <!DOCTYPE ...>.")

    def _skipped(self, name: str, _: bool) -> None:
        raise self._refused(f"uses the entity {name[:60]}, which it does not declare", "Write the characters.")

    def _refused(self, what: str, mend: str = "") -> RefusedError:
        return self.trouble.refuse(f"{self.part} line {self.parser.CurrentLineNumber}", what, mend)
