"""Typed access to the tables of a project file. Problems are collected, not raised."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding
from kennfeld.formatting import nearest


class Section:
    """One table of the file: typed access to its keys, and the findings about them.

    A reader of a section calls `end` last, which reports the keys that have not been read.

    >>> found = []
    >>> section = Section({"weight": "high", "colour": 1}, "kennfeld.toml [model]", found)
    >>> section.number("weight", 1.0)
    1.0
    >>> section.end()
    >>> [str(finding) for finding in found]  # doctest: +NORMALIZE_WHITESPACE
    ["kennfeld.toml [model] weight: must be a number, got 'high'",
     'kennfeld.toml [model] colour: unknown key. Valid keys: weight.']
    """

    def __init__(self, values: Mapping[str, Any], place: str, findings: list[Finding]) -> None:
        self.values = values
        self.place = place
        self.findings = findings
        self._read: dict[str, None] = {}

    def report(self, key: str, message: str, remedy: str = "") -> None:
        """Add a finding about a key, or about the whole section if the key is empty."""
        self.findings.append(Finding(f"{self.place} {key}".strip(), message, remedy))

    def has(self, key: str) -> bool:
        """Return if the key is present."""
        self._read[key] = None
        return key in self.values

    def get(self, key: str) -> Any:
        """Return the value as TOML gives it, None if the key is missing."""
        self._read[key] = None
        return self.values.get(key)

    def text(self, key: str, default: str = "") -> str:
        """Return a text that is not empty."""
        value = self.get(key)
        if value is None:
            return default
        if not isinstance(value, str):
            self.report(key, f"must be a text, got {_shown(value)}", f'Write {key} = "..." in quotes.')
            return default
        if not value.strip() and default != value:
            self.report(key, "must not be empty", "Fill it in, or remove the key.")
            return default
        return value

    def free_text(self, key: str) -> str | None:
        """Return a text that may be empty, None if the key is missing."""
        value = self.get(key)
        if value is None or isinstance(value, str):
            return value
        self.report(key, f"must be a text, got {_shown(value)}", f'Write {key} = "..." in quotes.')
        return None

    def number(self, key: str, default: float, least: float = -math.inf, *, above: bool = False) -> float:
        """Return a finite number that is >= `least`, or > `least` if `above`."""
        value = self.get(key)
        if value is None:
            return default
        number = as_finite(value)
        if number is None:
            self.report(key, f"must be a number, got {_shown(value)}")
        elif number < least or (above and number == least):
            self.report(key, f"must be {'>' if above else '>='} {least:g}, got {number:g}")
        else:
            return number
        return default

    def whole(self, key: str, default: int, least: int, most: int = 2**53 - 1) -> int:
        """Return an integer from `least` to `most`."""
        value = self.get(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**53:
            self.report(key, f"must be an integer >= {least}, got {_shown(value)}")
            return default
        if value > most:
            self.report(key, f"must be <= {most}, got {value}")
            return most
        return value

    def flag(self, key: str) -> bool | None:
        """Return true or false, None if the key is missing."""
        value = self.get(key)
        if value is None or isinstance(value, bool):
            return value
        self.report(key, f"must be true or false, got {_shown(value)}", "Write it without quotes.")
        return None

    def choice(self, key: str, default: str, known: Collection[str]) -> str:
        """Return one of the `known` words."""
        value = self.text(key, default)
        if value in known:
            return value
        if value != default:
            remedy = nearest(value, known) or f"Write {_listed(known)}."
            self.report(key, f"unknown value {value!r}", remedy)
        return default

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a text or a list of texts as a tuple."""
        value = self.get(key)
        items = [value] if isinstance(value, str) else value
        if items is None:
            return ()
        if not isinstance(items, list) or not all(isinstance(item, str) and item.strip() for item in items):
            self.report(
                key, f"must be a text or a list of texts, got {_shown(value)}", f'Write {key} = ["...", "..."].'
            )
            return ()
        return tuple(dict.fromkeys(items))

    def section(self, key: str, missing: str = "") -> "Section | None":
        """Return the table `[key]`; `missing` is the remedy if a missing table is an error."""
        value = self.get(key)
        if value is None:
            if missing:
                self.report(f"[{key}]", "the section is missing", missing)
            return None
        if not isinstance(value, dict):
            message = f"[[{key}]]" if isinstance(value, list) else _shown(value)
            self.report(f"[{key}]", f"must be one section, got {message}", f"Write [{key}] with single brackets.")
            return None
        return Section(value, f"{self.place} [{key}]", self.findings)

    def sections(self, key: str) -> "list[Section]":
        """Return the tables `[[key]]`, numbered from 1."""
        value = self.get(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.report(
                f"[[{key}]]", f"must be a section, got {_shown(value)}", f"Write [[{key}]] with double brackets."
            )
            return []
        return [Section(item, f"{self.place} [[{key}]] {i}", self.findings) for i, item in enumerate(value, 1)]

    def named(self, key: str) -> "dict[str, Section]":
        """Return the tables `[key.NAME]` by name."""
        outer = self.section(key)
        sections = {}
        for name, value in outer.values.items() if outer else ():
            if isinstance(value, dict):
                sections[name] = Section(value, f"{self.place} [{key}.{name}]", self.findings)
            else:
                message, remedy = f"must be a section, got {_shown(value)}", f"Write a section [{key}.{name}]."
                self.findings.append(Finding(f"{self.place} [{key}] {name}", message, remedy))
        return sections

    def inner(self, key: str) -> "Section | None":
        """Return an inline table `key = { ... }`."""
        value = self.get(key)
        if isinstance(value, dict):
            return Section(value, f"{self.place} {key}", self.findings)
        self.report(key, f"must be a table, got {_shown(value)}", f"Write {key} = {{ ... }}.")
        return None

    def text_table(self, key: str) -> dict[str, str]:
        """Return a table of texts by name."""
        inner = self.section(key)
        return {name: text for name in inner.values if (text := inner.text(name))} if inner else {}

    def end(self) -> None:
        """Report the keys that have not been read."""
        for key in self.values:
            if key not in self._read:
                remedy = nearest(key, self._read) or f"Valid keys: {', '.join(self._read)}."
                self.report(key, "unknown key", remedy)


def as_finite(value: Any) -> float | None:
    """Return a number as a float, None if it is not a finite number."""
    number = as_number(value)
    return number if number is not None and math.isfinite(number) else None


def as_number(value: Any) -> float | None:
    """Return a number, infinity or NaN as a float, None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def as_array(value: Any) -> Float | str:
    """Return a number or nested lists of numbers as an array, or a message if they are not.

    The texts "inf" and "-inf" are numbers.

    >>> as_array([[1, 2], [3, "inf"]])
    array([[ 1.,  2.],
           [ 3., inf]])
    >>> as_array([[1, 2], [3]])
    'rows must have equal length, got 2 and 1'
    """
    if isinstance(value, str) and value.strip().casefold() in ("inf", "+inf", "-inf"):
        return np.array(float(value))
    if not isinstance(value, list):
        number = as_number(value)
        return f"must be a number, got {_shown(value)}" if number is None else np.array(number)
    if not value:
        return "lists must not be empty"
    parts: list[Float] = []
    for item in value:
        part = as_array(item)
        if isinstance(part, str):
            return part
        parts.append(part)
    return _stacked(parts)


def _stacked(parts: Sequence[Float]) -> Float | str:
    shapes = list(dict.fromkeys(part.shape for part in parts))
    if len(shapes) == 1:
        return np.stack(parts)
    if len({len(shape) for shape in shapes}) > 1:
        return "must not mix numbers and lists"
    return f"rows must have equal length, got {shapes[0][0]} and {shapes[1][0]}"


def _listed(words: Collection[str]) -> str:
    return " or ".join(f'"{word}"' for word in words)


def _shown(value: Any) -> str:
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
