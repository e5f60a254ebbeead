"""Takes Google-style docstrings apart: description, arguments, results, exceptions, examples."""

import inspect
import re
from dataclasses import dataclass, field

__all__ = ["Docstring", "parse"]

_SECTION = re.compile(r"(Args|Attributes|Returns|Yields|Raises):$")
_ENTRY = re.compile(r"(\*{0,2}[\w.]+): (.*)")


@dataclass
class Docstring:
    """The parts of a docstring; texts are paragraphs without line breaks."""

    description: list[str] = field(default_factory=list)
    entries: dict[str, dict[str, str]] = field(default_factory=dict)  # of Args, Attributes and Raises, by name
    returns: str = ""
    examples: list[str] = field(default_factory=list)  # lines

    @property
    def summary(self) -> str:
        """The first paragraph."""
        return self.description[0] if self.description else ""


def parse(text: str) -> Docstring:
    r"""Return the parts of a docstring.

    >>> parts = parse("Add.\n\nArgs:\n    x: a number,\n        >= 0.\n\n>>> add(1)\n1")
    >>> parts.summary, parts.entries, parts.examples
    ('Add.', {'Args': {'x': 'a number, >= 0.'}}, ['>>> add(1)', '1'])
    """
    parts = Docstring()
    for block in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = block.split("\n")
        if lines[0].startswith(">>> "):
            parts.examples += [*([""] if parts.examples else []), *map(_shown, lines)]
        elif _SECTION.fullmatch(lines[0]):
            _add_section(parts, lines[0].removesuffix(":"), lines[1:])
        else:
            parts.description.append(" ".join(line.strip() for line in lines))
    return parts


def _shown(line: str) -> str:
    """Return a line of an example without directives of doctest."""
    return re.sub(r"\s*# doctest: .*", "", line)


def _add_section(parts: Docstring, name: str, lines: list[str]) -> None:
    if name in ("Returns", "Yields"):
        parts.returns = " ".join(line.strip() for line in lines)
        return
    entries = parts.entries.setdefault(name, {})
    last = ""
    for line in lines:
        entry = _ENTRY.fullmatch(line.strip()) if not line.startswith("     ") else None
        if entry:
            last = entry[1]
            entries[last] = entry[2]
        elif last:
            entries[last] += f" {line.strip()}"
