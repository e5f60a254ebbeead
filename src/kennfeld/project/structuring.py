"""A typed walk over the tables of a project file; every complaint is kept, none is raised."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding
from kennfeld.formatting import nearest

__all__ = ["Section", "array", "finite", "numeric"]

NEXT = "is not available in this version"


class Section:
    """One table of the file: typed access to its keys, and the findings about them.

    Whoever reads a section calls `end` last, which reports the keys that nobody asked for.

    >>> found = []
    >>> section = Section({"weight": "high", "colour": 1}, "kennfeld.toml [model]", found)
    >>> section.number("weight", 1.0)
    1.0
    >>> section.end()
    >>> [str(finding) for finding in found]  # doctest: +NORMALIZE_WHITESPACE
    ["kennfeld.toml [model] weight: 'high' is no number",
     'kennfeld.toml [model] colour: is no key that a project file knows. Known here: weight.']
    """

    def __init__(self, values: Mapping[str, Any], place: str, findings: list[Finding]) -> None:
        self.values = values
        self.place = place
        self.findings = findings
        self._asked: dict[str, None] = {}

    def report(self, key: str, message: str, remedy: str = "") -> None:
        """Keep a finding about a key, or about the whole section where the key is empty."""
        self.findings.append(Finding(f"{self.place} {key}".strip(), message, remedy))

    def has(self, key: str) -> bool:
        """Whether the key is there."""
        self._asked[key] = None
        return key in self.values

    def get(self, key: str) -> Any:
        """The value as TOML gives it, None where the key is missing."""
        self._asked[key] = None
        return self.values.get(key)

    def text(self, key: str, default: str = "") -> str:
        """A text that is not empty."""
        value = self.get(key)
        if value is None:
            return default
        if not isinstance(value, str):
            self.report(key, f"{_shown(value)} is no text", f'Write {key} = "..." in quotes.')
            return default
        if not value.strip() and default != value:
            self.report(key, "the text is empty", "Fill it in, or remove the key.")
            return default
        return value

    def free_text(self, key: str) -> str | None:
        """A text that may be empty, None where the key is missing."""
        value = self.get(key)
        if value is None or isinstance(value, str):
            return value
        self.report(key, f"{_shown(value)} is no text", f'Write {key} = "..." in quotes.')
        return None

    def number(self, key: str, default: float, least: float = -math.inf, *, above: bool = False) -> float:
        """A finite number from `least` on, or above it."""
        value = self.get(key)
        if value is None:
            return default
        number = finite(value)
        if number is None:
            self.report(key, f"{_shown(value)} is no number")
        elif number < least or (above and number == least):
            limit = f"above {least:g}" if above else f"from {least:g} on"
            self.report(key, f"{number:g} must be a number {limit}")
        else:
            return number
        return default

    def whole(self, key: str, default: int, least: int, most: int = 2**53 - 1) -> int:
        """A whole number from `least` to `most`."""
        value = self.get(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**53:
            self.report(key, f"{_shown(value)} must be a whole number from {least} on")
            return default
        if value > most:
            self.report(key, f"must be <= {most}, got {value}")
            return most
        return value

    def flag(self, key: str) -> bool | None:
        """True or false, None where the key is missing."""
        value = self.get(key)
        if value is None or isinstance(value, bool):
            return value
        self.report(key, f"{_shown(value)} is neither true nor false", "Write true or false, without quotes.")
        return None

    def choice(self, key: str, default: str, known: Collection[str], later: Collection[str] = ()) -> str:
        """One of a few words; those of `later` versions are named as such."""
        value = self.text(key, default)
        if value in known:
            return value
        if value in later:
            self.report(key, f"{value!r} {NEXT}", f"Write {_listed(known)}.")
        elif value != default:
            remedy = nearest(value, known) or f"Write {_listed(known)}."
            self.report(key, f"{value!r} is unknown", remedy)
        return default

    def texts(self, key: str) -> tuple[str, ...]:
        """A text or a list of texts."""
        value = self.get(key)
        given = [value] if isinstance(value, str) else value
        if given is None:
            return ()
        if not isinstance(given, list) or not all(isinstance(item, str) and item.strip() for item in given):
            self.report(key, f"{_shown(value)} is no text and no list of texts", f'Write {key} = ["...", "..."].')
            return ()
        return tuple(dict.fromkeys(given))

    def section(self, key: str, missing: str = "") -> "Section | None":
        """The table `[key]`; `missing` is the mend where it has to be there."""
        value = self.get(key)
        if value is None:
            if missing:
                self.report(f"[{key}]", "the section is missing", missing)
            return None
        if not isinstance(value, dict):
            message = f"[[{key}]]" if isinstance(value, list) else _shown(value)
            self.report(f"[{key}]", f"{message} must be one section", f"Write [{key}] with single brackets.")
            return None
        return Section(value, f"{self.place} [{key}]", self.findings)

    def sections(self, key: str) -> "list[Section]":
        """The tables `[[key]]`, counted from 1 in places."""
        value = self.get(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.report(f"[[{key}]]", f"{_shown(value)} must be a section", f"Write [[{key}]] with double brackets.")
            return []
        return [Section(item, f"{self.place} [[{key}]] {i}", self.findings) for i, item in enumerate(value, 1)]

    def named(self, key: str) -> "dict[str, Section]":
        """The tables `[key.NAME]` by name."""
        outer = self.section(key)
        made = {}
        for name, value in outer.values.items() if outer else ():
            if isinstance(value, dict):
                made[name] = Section(value, f"{self.place} [{key}.{name}]", self.findings)
            else:
                remedy = f"Write a section [{key}.{name}]."
                self.findings.append(Finding(f"{self.place} [{key}] {name}", f"{_shown(value)} is no section", remedy))
        return made

    def inner(self, key: str) -> "Section | None":
        """An inline table `key = { ... }` that is there."""
        value = self.get(key)
        if isinstance(value, dict):
            return Section(value, f"{self.place} {key}", self.findings)
        self.report(key, f"{_shown(value)} is no table", f"Write {key} = {{ ... }}.")
        return None

    def text_table(self, key: str) -> dict[str, str]:
        """A table of texts by name."""
        inner = self.section(key)
        return {name: text for name in inner.values if (text := inner.text(name))} if inner else {}

    def later(self, *keys: str) -> None:
        """Keys that the format has and this version does not."""
        for key in keys:
            if self.has(key):
                self.report(key, f"{key} {NEXT}", "Remove it.")

    def end(self) -> None:
        """Report the keys that nobody asked for."""
        for key in self.values:
            if key not in self._asked:
                remedy = nearest(key, self._asked) or f"Known here: {', '.join(self._asked)}."
                self.report(key, "is no key that a project file knows", remedy)


def finite(value: Any) -> float | None:
    """The number as a float, None where it is none or not finite."""
    number = numeric(value)
    return number if number is not None and math.isfinite(number) else None


def numeric(value: Any) -> float | None:
    """The number as a float, None where it is none; infinity and NaN are numbers here."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def array(value: Any) -> Float | str:
    """A number or nested lists of numbers as an array; a text that says what is wrong with it.

    "inf" and "-inf" may be written as text.

    >>> array([[1, 2], [3, "inf"]])
    array([[ 1.,  2.],
           [ 3., inf]])
    >>> array([[1, 2], [3]])
    'its rows differ in length: 2 and 1'
    """
    if isinstance(value, str) and value.strip().casefold() in ("inf", "+inf", "-inf"):
        return np.array(float(value))
    if not isinstance(value, list):
        number = numeric(value)
        return f"{_shown(value)} is no number" if number is None else np.array(number)
    if not value:
        return "a list is empty"
    parts: list[Float] = []
    for item in value:
        part = array(item)
        if isinstance(part, str):
            return part
        parts.append(part)
    return _stacked(parts)


def _stacked(parts: Sequence[Float]) -> Float | str:
    shapes = list(dict.fromkeys(part.shape for part in parts))
    if len(shapes) == 1:
        return np.stack(parts)
    if len({len(shape) for shape in shapes}) > 1:
        return "it mixes numbers and lists"
    return f"its rows differ in length: {shapes[0][0]} and {shapes[1][0]}"


def _listed(words: Collection[str]) -> str:
    return " or ".join(f'"{word}"' for word in words)


def _shown(value: Any) -> str:
    """A value as a message quotes it."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
