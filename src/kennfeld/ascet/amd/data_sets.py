"""The values of a component, from its `.data.amd` file, with the positions of their numbers.

One data set, `classConfig`, holds the elements that are shared; the others hold those of each instance, of which one is
the default. A map has a row of values for each breakpoint of y.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement

_VALUES: Final = ("Numeric", "Logic", "Enumeration")
_MAX_VALUES: Final = 1_000_000  # of an element


@dataclass(frozen=True)
class DataValue:
    """A value as written: `kind` is Numeric, Logic or Enumeration; `begin` is the offset of its element."""

    kind: str
    text: str
    line: int
    begin: int

    @property
    def number(self) -> float:
        """The number; 1 and 0 for true and false, NaN if it is not a number."""
        if self.kind == "Logic":
            return {"true": 1.0, "false": 0.0}.get(self.text, math.nan)
        try:
            # float() accepts 1_000
            return math.nan if "_" in self.text else float(self.text)
        except ValueError:
            return math.nan


@dataclass(frozen=True)
class DataEntry:
    """The values of an element.

    Attributes:
        form: `scalar`, `Array`, `OneD`, `TwoD`, `complex`, or another tag.
        axes: breakpoints of x and y.
        values: the values, those of a map row by x.
        reference: name of the data set of an instance of a class, and `reference_id` its identifier.
        problem: why the values cannot be used; empty if they can.
    """

    element: str
    variant: str
    line: int
    form: str
    axes: tuple[tuple[DataValue, ...], ...] = ()
    values: tuple[DataValue, ...] = ()
    reference: str = ""
    reference_id: str = ""
    problem: str = ""


@dataclass(frozen=True)
class DataSet:
    """A data set; `is_shared` for the one of shared elements."""

    name: str
    identifier: str
    is_default: bool
    is_shared: bool
    entries: tuple[DataEntry, ...]


def read_data_sets(root: XmlElement) -> tuple[DataSet, ...]:
    """Read the data sets of a `.data.amd` file, without damaged entries."""
    return tuple(
        DataSet(
            item.get("name"),
            item.get("OID"),
            item.is_true("default"),
            item.is_true("classConfig"),
            tuple(_entries(item)),
        )
        for item in root.all("DataSet")
    )


def _entries(data_set: XmlElement) -> Iterator[DataEntry]:
    for entry in data_set.all("DataEntry"):
        for variant in entry.all("DataVariant"):
            yield _entry(entry.get("elementName"), variant)


def _entry(name: str, variant: XmlElement) -> DataEntry:
    content = next(iter(variant.children), None)
    which = variant.get("name", "default")
    if content is None:
        return DataEntry(name, which, variant.line, "", problem="has no values")
    if content.tag == "ComplexType":
        reference = content.get("dataName"), content.get("dataOID")
        return DataEntry(name, which, variant.line, "complex", (), (), *reference)
    if content.tag == "ScalarType":
        return _checked(DataEntry(name, which, variant.line, "scalar", (), tuple(_leaves(content))), 1)
    inner = next(iter(content.children), None)
    if inner is None:
        return DataEntry(name, which, variant.line, "", problem="has no values")
    return _dimensional(name, which, inner)


def _dimensional(name: str, variant: str, content: XmlElement) -> DataEntry:
    if content.tag == "Array":
        values = tuple(_leaves(content))
        return _checked(DataEntry(name, variant, content.line, "Array", (), values), len(values))
    if content.tag not in ("OneD", "TwoD"):
        message = f"values of the form {content.tag} are not supported"
        return DataEntry(name, variant, content.line, content.tag, problem=message)
    tags = ("XAxis", "YAxis")[: 1 if content.tag == "OneD" else 2]
    axes = tuple(tuple(_leaves(content.first(tag))) for tag in tags)
    values = tuple(_leaves(content.first("Values")))
    count = math.prod(map(len, axes))
    if content.tag == "TwoD" and len(values) == count:
        # the file has a row for each y, a map of ESDL one for each x
        width, height = map(len, axes)
        values = tuple(values[y * width + x] for x in range(width) for y in range(height))
    entry = DataEntry(name, variant, content.line, content.tag, axes, values, problem=_unsupported(content))
    return entry if entry.problem else _checked(entry, count)


def _unsupported(content: XmlElement) -> str:
    """Return which kind of table is not supported; empty if it is."""
    if (kind := content.get("type", "normal")) != "normal":
        return f"tables of the type {kind} are not supported"
    if (kind := content.get("interpolation", "Linear")) != "Linear":
        return f"tables with the interpolation {kind} are not supported"
    if (kind := content.get("extrapolation", "Constant")) != "Constant":
        return f"tables with the extrapolation {kind} are not supported"
    return ""


def _leaves(content: XmlElement | None) -> Iterator[DataValue]:
    if content is not None:
        for item in content.walk():
            if item.tag in _VALUES:
                yield DataValue(item.tag, item.get("value"), item.line, item.begin)


def _checked(entry: DataEntry, count: int) -> DataEntry:
    """Return an entry with what is wrong about its numbers."""
    problem = ""
    if len(entry.values) != count or count == 0 or count > _MAX_VALUES:
        problem = f"has {len(entry.values)} values, expected {count or 'at least 1'}"
    for value in (*(point for axis in entry.axes for point in axis), *entry.values):
        if value.kind != "Enumeration" and not math.isfinite(value.number):
            problem = f"{value.text[:40]!r} in line {value.line} is not a number"
    for axis in entry.axes:
        points = [point.number for point in axis]
        pairs = list(pairwise(points))
        if not (all(a < b for a, b in pairs) or all(a > b for a, b in pairs)):
            problem = problem or "its breakpoints neither increase nor decrease"
    if not problem:
        return entry
    return DataEntry(entry.element, entry.variant, entry.line, entry.form, entry.axes, entry.values, problem=problem)


def chosen_entries(sets: tuple[DataSet, ...]) -> dict[str, DataEntry]:
    """Return the entry of each element: that of the shared set, or of the default set."""
    result: dict[str, DataEntry] = {}
    for data_set in sets:
        if data_set.is_shared or data_set.is_default:
            for entry in data_set.entries:
                # of several variants, the default one
                if entry.element not in result or entry.variant == "default":
                    result[entry.element] = entry
    return result
