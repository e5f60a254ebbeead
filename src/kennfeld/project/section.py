"""Tables of a project file with their locations. Problems are collected, not raised."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, replace
from typing import Any

from kennfeld.base.errors import Findings, Fix, Location
from kennfeld.base.formatting import most_similar, nearest
from kennfeld.base.lazy_dataclass import dataclass

KeyPath = tuple[str | int, ...]  # keys of TOML; entries of a list count from 1


@dataclass(frozen=True)
class KeyLocation(Location):
    """Location in a project file; the location of a part has the line of the part.

    >>> section = KeyLocation("kennfeld.toml", 3, "[model]", lines={"[model] step": 5})
    >>> print(section.within("step"))
    kennfeld.toml line 5 [model] step
    """

    lines: dict[str, int] = field(default_factory=dict, compare=False, repr=False)  # by path

    def within(self, path: str) -> "KeyLocation":
        """Return the location of a part; without a line of its own, it has that of the whole."""
        inner = f"{self.path} {path}".strip()
        return replace(self, path=inner, line=self.lines.get(inner, self.line))


class Section:
    """One table of the file, and the findings about it.

    >>> findings = Findings()
    >>> section = Section({"weight": "high"}, KeyLocation("kennfeld.toml", path="[model]"), findings)
    >>> section.report("weight", "must be a number, got 'high'")
    >>> print(*findings)
    kennfeld.toml [model] weight: must be a number, got 'high'
    """

    def __init__(
        self,
        values: Mapping[str, Any],
        location: KeyLocation,
        findings: Findings,
        keys: KeyPath = (),
        line_of: Callable[[KeyPath], int] = lambda keys: 0,
    ) -> None:
        self.values, self.location, self.findings = values, location, findings
        self.keys, self.line_of = keys, line_of
        for name in values:
            # messages name a section in either notation
            for path in (name, f"[{name}]", f"[[{name}]]") if self.is_root else (name,):
                self._locate(path, name)

    @property
    def is_root(self) -> bool:
        """True if this is the file, whose tables are its sections."""
        return not self.keys

    def with_values(self, values: Mapping[str, Any]) -> "Section":
        """Return the same table with other values."""
        return Section(values, self.location, self.findings, self.keys, self.line_of)

    def report(self, path: str, message: str, remedy: str = "", fixes: Iterable[Fix] = ()) -> None:
        """Add an error about a part, or about the whole section if the path is empty."""
        self.findings.error(self.location.within(path), message, remedy, fixes=fixes)

    @contextmanager
    def removable(self, *keys: str | int) -> Iterator[None]:
        """Offer to remove a part as the fix of what is reported meanwhile, unless it has a fix of its own."""
        begin = len(self.findings)
        yield
        self.findings.offer(Fix.remove((*self.keys, *keys)), begin)

    def inner(self, values: Mapping[str, Any], path: str, *keys: str | int) -> "Section":
        """Return a table within this one, which messages call `path`."""
        location = self._locate(path, *keys)
        return Section(values, location, self.findings, (*self.keys, *keys), self.line_of)

    def _locate(self, path: str, *keys: str | int) -> KeyLocation:
        """Return the location of a part and remember its line."""
        location = self.location.within(path)
        own = (*self.keys, *keys)
        line = self.line_of(own)
        self.location.lines[location.path] = line
        return replace(location, line=line, keys=own)

    def report_unknown(self, known: Collection[str]) -> None:
        """Report keys that are not `known`."""
        for name, value in self.values.items():
            if name in known:
                continue
            keys, similar = (*self.keys, name), most_similar(name, known)
            fixes = [Fix.rename(keys, similar, value)] if similar and similar not in self.values else []
            fixes.append(Fix.remove(keys))
            if self.is_root and isinstance(value, dict | list):
                self.report(f"[{name}]", "unknown section", nearest(name, known), fixes)
            else:
                remedy = nearest(name, known) or ("" if self.is_root else f"Valid keys: {', '.join(known)}.")
                self.report(name, "unknown key", remedy, fixes)


def show(value: Any) -> str:
    """Return a value for a message, cut if it is long."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def list_words(words: Iterable[str]) -> str:
    """Return quoted words with "or" between them."""
    return " or ".join(f'"{word}"' for word in words)


def as_number(value: Any) -> float | None:
    """Return a number, infinity or NaN as a float, None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def as_finite(value: Any) -> float | None:
    """Return a number as a float, None if it is not a finite number."""
    number = as_number(value)
    return number if number is not None and math.isfinite(number) else None
