"""Tunes of TunerStudio (.msq), the settings of MegaSquirt, Speeduino and rusEFI controllers.

XML with a `constant` or `pcVariable` for each setting: numbers parted by blanks, a row of a table for each y, or words
in quotes. The file does not say which constants are the breakpoints of a table; see `msq_axes`.
"""

import re
from bisect import bisect
from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace
from html import unescape
from math import isfinite
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Content, Notes, Source, counted
from kennfeld.calfiles.msq.axes import Pair, definition_beside, pairs_of, strings_of, usual_pairs
from kennfeld.calfiles.xml_tree import parsed
from kennfeld.parameters import Axis, Block, Parameter, ParameterSet, Scalar, Text, TextKind, parameter

__all__ = ["Constant", "Msq", "read_msq", "recognises_msq"]

_ROOT = re.compile(r"<(?:[\w.-]+:)?msq[\s/>]")
_PROLOG = 20_000  # characters before the root
_ATTRIBUTES = r"""((?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))*)"""
_PART = re.compile(
    rf"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<(page|constant|pcVariable|versionInfo){_ATTRIBUTES}\s*(/?)>([^<]*)", re.DOTALL
)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_COUNT = re.compile(r"[0-9]{1,6}")
_WORD_KINDS: tuple[TextKind, TextKind] = ("text", "enumeration")  # without and within quotes
_NUMBER = re.compile(r"[-+0-9.eE]+")


@dataclass(frozen=True)
class Constant:
    """One setting: what the file says about it, and where its content lies in the characters of the file."""

    name: str
    line: int
    begin: int
    content: str
    unit: str = ""
    digits: int | None = None
    sizes: tuple[int, int] | None = None  # rows and columns
    page: str = ""

    @property
    def words(self) -> list[str]:
        """The numbers as they are written; empty where the content is no list of numbers."""
        words = self.content.split()
        return words if all(map(_NUMBER.fullmatch, words)) else []


@dataclass(frozen=True, eq=False)
class Msq:
    """A tune as it was read: its characters, its constants, and what was made of them."""

    source: Source
    text: str
    constants: Mapping[str, Constant]
    things: Mapping[str, Parameter | Text]
    axes: Mapping[str, Axis]


def recognises_msq(text: str) -> bool:
    """Whether a text is XML whose root is that of a tune."""
    return text.lstrip("\ufeff \n\t").startswith("<") and _ROOT.search(text[:_PROLOG]) is not None


def read_msq(source: Source) -> Content:
    """The settings of a tune: numbers, tables with their axes, words; the page is told as the function.

    A table whose axes are unknown, or do not increase, is a value block, its axes too. Raises `InputError` with every
    finding; entities are refused.
    """
    notes = Notes(source.name)
    if parsed(source.raw, notes) is None:
        notes.settle()
    text = "".join(source.lines)
    reader = _Reader(notes)
    signature = reader.find(text)
    definition = definition_beside(source.path, signature, notes)
    reader.build(pairs_of(definition) if definition is not None else usual_pairs(), definition is not None)
    reader.free_texts(strings_of(definition or ""))
    remarks = notes.settle()
    members = [thing for thing in reader.things.values() if isinstance(thing, Parameter)]
    texts = [thing for thing in reader.things.values() if isinstance(thing, Text)]
    origin = Msq(source, text, reader.constants, reader.things, reader.axes)
    kind = f"MSQ tune of {signature}" if signature else "MSQ tune"
    return Content(kind, ParameterSet(members, texts, reader.axes.values(), origin=origin), remarks)


@dataclass
class _Reader:
    notes: Notes
    constants: dict[str, Constant] = field(default_factory=dict)
    arrays: dict[str, Float] = field(default_factory=dict)  # a row for each y, as in the file
    things: dict[str, Parameter | Text] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)

    def find(self, text: str) -> str:
        """Keep all constants of a file; gives the signature of the firmware."""
        ends = [at for at, character in enumerate(text) if character == "\n"]
        page = signature = ""
        for part in _PART.finditer(text):
            attributes = {name: unescape(one or other) for name, one, other in _ATTRIBUTE.findall(part[2] or "")}
            if part[1] == "page":
                page = attributes.get("number", "")
            elif part[1] == "versionInfo":
                signature = attributes.get("signature", "")
            elif part[1]:
                line = bisect(ends, part.start()) + 1
                self._keep(attributes, Constant(attributes.get("name", ""), line, part.start(4), part[4], page=page))
        return signature

    def _keep(self, attributes: Mapping[str, str], found: Constant) -> None:
        counts = [attributes.get(key, "") for key in ("rows", "cols")]
        sizes = (int(counts[0]), int(counts[1])) if all(map(_COUNT.fullmatch, counts)) else None
        if sizes is None and _COUNT.fullmatch(counts[0]):
            sizes = (int(counts[0]), 1)
        digits = attributes.get("digits", "")
        written = int(digits) if _COUNT.fullmatch(digits) and int(digits) < 20 else None
        made = replace(found, unit=attributes.get("units", "").strip(), digits=written, sizes=sizes)
        if not found.name:
            self.notes.error(found.line, "", "a constant has no name", "Take a complete copy of the file.")
        elif found.name in self.constants:
            what = f"is there a second time, after line {self.constants[found.name].line}; left aside"
            self.notes.remark(found.line, found.name, what)
        else:
            self.constants[found.name] = made
            self._value(made)

    def _value(self, constant: Constant) -> None:
        content = constant.content.strip()
        if content.startswith('"') and constant.sizes is not None:
            self.notes.remark(constant.line, constant.name, "is a list of words, which is no parameter; left aside")
        elif constant.words:
            array = self._array(constant)
            if array is not None:
                self.arrays[constant.name] = array
        elif constant.sizes is not None:
            word = next((word for word in content.split() if not _NUMBER.fullmatch(word)), "")
            what = f"{word[:40]!r} is no number" if word else "has no numbers"
            self.notes.error(constant.line, constant.name, what)
        else:
            quoted = len(content) > 1 and content[0] == content[-1] == '"'
            text, kind = unescape(content[1:-1] if quoted else content), _WORD_KINDS[quoted]
            unit, functions = constant.unit, _pages(constant)
            self.things[constant.name] = Text(constant.name, text, functions=functions, unit=unit, kind=kind)

    def _array(self, constant: Constant) -> Float | None:
        numbers = []
        for word in constant.words:
            try:
                numbers.append(float(word))
            except ValueError:
                numbers.append(np.nan)
            if not isfinite(numbers[-1]):
                self.notes.error(constant.line, constant.name, f"{word[:40]!r} is no finite number")
                return None
        rows, columns = constant.sizes or (1, len(numbers))
        if rows * columns != len(numbers):
            what = f"has {counted(len(numbers), 'value')}, its rows and columns ask for {rows} x {columns}"
            self.notes.error(constant.line, constant.name, what)
            return None
        return np.array(numbers).reshape(rows, columns)

    def build(self, pairs: list[Pair], told: bool) -> None:
        """Make parameters of the constants, tables of those that a pair gives axes."""
        different = {(pair.values, pair.axes): pair for pair in reversed(pairs)}
        tables = {pair.values: pair for pair in different.values() if self._fits(pair, told)}
        used = {name for pair in tables.values() for name in pair.axes} - tables.keys()
        for name in self.constants:
            if name in self.arrays and name not in used:
                self.things[name] = self._thing(name, tables.get(name))
        self.things = {name: self.things[name] for name in self.constants if name in self.things}

    def free_texts(self, names: Set[str]) -> None:
        """Tell constants of free text from those whose text is one of several words."""
        for name in names & self.things.keys():
            thing = self.things[name]
            if isinstance(thing, Text):
                self.things[name] = replace(thing, kind="text")

    def _fits(self, pair: Pair, told: bool) -> bool:
        """Whether a pair gives a table its axes."""
        values = self.arrays.get(pair.values)
        points = [self.arrays.get(name) for name in pair.axes]
        if values is None or any(one is None for one in points) or pair.values in pair.axes:
            return False
        sizes = tuple(one.size for one in points if one is not None)
        if sizes != (values.shape[::-1] if len(sizes) > 1 else (values.size,)):
            if told:
                found = " x ".join(map(str, values.shape[::-1]))
                what = f"has {found} values, its axes {' x '.join(map(str, sizes))}; it is read as a value block"
                self.notes.remark(self.constants[pair.values].line, pair.values, what)
            return False
        fallen = [name for name in pair.axes if not self._increases(name, pair.values)]
        return not fallen

    def _increases(self, name: str, user: str) -> bool:
        points = self.arrays[name].ravel()
        if np.all(points[1:] > points[:-1]):
            return True
        what = f"is read as a value block: its breakpoints {name} do not increase"
        self.notes.remark(self.constants[user].line, user, what)
        return False

    def _thing(self, name: str, pair: Pair | None) -> Parameter:
        constant, array = self.constants[name], self.arrays[name]
        labels: dict[str, Any] = {"unit": constant.unit, "functions": _pages(constant)}
        if pair is not None:
            axes = [self._axis(one, given) for one, given in zip(pair.axes, pair.inputs, strict=False)]
            return parameter(name, array.T if len(axes) > 1 else array.ravel(), axes, description=pair.title, **labels)
        if constant.sizes is None and array.size == 1:
            return Scalar(name, array[0, 0], **labels)
        return Block(name, array.ravel() if 1 in array.shape else array.T, **labels)

    def _axis(self, name: str, quantity: str) -> Axis:
        """The breakpoints in a constant: one axis for all tables that use it."""
        points = self.arrays[name].ravel()
        return self.axes.setdefault(name, Axis(points, quantity, self.constants[name].unit, name))


def _pages(constant: Constant) -> tuple[str, ...]:
    return (f"page {constant.page}",) if constant.page else ()
