"""What all Simulink files share below their syntax: sections that hold keys, texts and further sections."""

from collections.abc import Iterator
from dataclasses import dataclass, field

__all__ = ["DEEPEST", "MOST_SECTIONS", "Section"]

DEEPEST = 200  # sections within sections; a subsystem takes two of them, and models have about ten subsystems in a row
MOST_SECTIONS = 1_000_000  # in one part of a file; a model of 10 000 blocks has some 30 000


@dataclass(slots=True)
class Section:
    """One section: an XML element, or braces and what they hold.

    `keys` are what it says of itself: attributes, `<P Name="key">value</P>`, or lines `key value`; `links` are keys
    whose value is kept in another part of the file, by that part's name. A `$` before a key is left out.
    """

    kind: str
    line: int
    keys: dict[str, str] = field(default_factory=dict)
    parts: list["Section"] = field(default_factory=list)
    links: dict[str, str] = field(default_factory=dict)
    text: str = ""

    def all(self, *kinds: str) -> Iterator["Section"]:
        """The sections directly within that are of one of the kinds."""
        return (part for part in self.parts if part.kind in kinds)

    def first(self, *kinds: str) -> "Section | None":
        """The first section directly within that is of one of the kinds."""
        return next(self.all(*kinds), None)

    def get(self, key: str, default: str = "") -> str:
        """What the section says under a key, be it a key or a section that holds text."""
        if key in self.keys:
            return self.keys[key]
        part = self.first(key)
        return part.text if part is not None else default

    def every(self) -> Iterator["Section"]:
        """This section and all within it, an outer one before its content."""
        waiting = [self]
        while waiting:
            section = waiting.pop()
            yield section
            waiting.extend(reversed(section.parts))

    def classed(self, name: str) -> Iterator["Section"]:
        """The sections within, at any depth, that hold an object of a class."""
        return (section for section in self.every() if name in (section.keys.get("ClassName"), section.kind))
