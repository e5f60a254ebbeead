"""Reads the parameters of ASCET 5 and 6 components, and where their numbers are in the files.

A parameter is named as its element; with its component if several components have one of that name. Values of data sets
other than the default one are variants.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from kennfeld.ascet.amd.components import ComponentElement
from kennfeld.ascet.amd.data_sets import DataEntry, DataValue, read_data_sets
from kennfeld.ascet.amd.files import (
    DATA,
    IMPLEMENTATION,
    MAIN,
    AmdFiles,
    component_stem,
    file_name,
    open_archive,
    open_folder,
)
from kennfeld.ascet.amd.library import ComponentLibrary, qualified_name
from kennfeld.ascet.amd.ranges import PhysicalRange, read_ranges
from kennfeld.ascet.amd.xml_document import parse_amd
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import in_rising_order, turn
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, Key, ReadResult, build_set
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Scalar, parameter
from kennfeld.domain.texts import Text

_ZIP: Final = b"PK\x03\x04"
_DEFAULT: Final = "default"


@dataclass(frozen=True)
class AmdValue:
    """The numbers of a parameter: those of each axis, and the values, with their positions in the file at `path`.

    `labels` are those of its enumeration with their numbers. An axis of the item falls if it does in the file.
    """

    path: str
    item: Item
    entry: DataEntry
    labels: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class AmdOrigin:
    """The file as read, the files in it that have values, by path, and their parameters by name and variant.

    `prefixes` may stand before a name in a set, and are left out; `owner` is the component that names may lack.
    """

    source: CalibrationSource
    contents: Mapping[str, bytes]
    items: Mapping[Key, AmdValue]
    prefixes: tuple[str, ...] = ()
    owner: str = ""

    def value(self, name: str, variant: str = "") -> AmdValue | None:
        """Return a parameter by its name, which may have those of its component and folders before it."""
        shorter = [name[len(prefix) :] for prefix in self.prefixes if name.startswith(prefix)]
        longer = [f"{self.owner}.{name}", f"{self.owner.rpartition('.')[2]}.{name}"] if self.owner else []
        names = (name, *shorter, *longer)
        return next((self.items[known, variant] for known in names if (known, variant) in self.items), None)


@dataclass(frozen=True)
class AmdReference:
    """A file whose values are read when they are written into a copy of it; `owner` is the component of a model."""

    path: Path
    owner: str = ""

    def origin(self) -> AmdOrigin:
        """Return the file as read; raises `InputError` if it cannot be read."""
        with convert_errors(self.path, "cannot be read"):
            source = CalibrationSource(self.path.name, self.path.read_bytes(), self.path)
        origin = read_amd(source).parameters.origin
        assert isinstance(origin, AmdOrigin)
        return replace(origin, owner=self.owner)


def read_amd(source: CalibrationSource) -> ReadResult:
    """Return the parameters of an archive or of a `.data.amd` file; raises `InputError` if it cannot be read."""
    findings = FileFindings(source.name)
    if source.raw.startswith(_ZIP):
        files = open_archive(source.raw, source.name)
        paths = [path for path in files.paths if path.endswith(DATA)]
    else:
        files, paths = _single(source)
    reader = _AmdReader(files, findings)
    for path in paths:
        # members of an archive are read one by one, a single file is at hand
        reader.read(path, None if files.name == source.name and source.raw.startswith(_ZIP) else source.raw)
    items = reader.named()
    members = {key: value.item for key, value in items.items()}
    origin = AmdOrigin(source, reader.contents, items, tuple(reader.prefixes()))
    kind = "AXL (ASCET 6)" if source.raw.startswith(_ZIP) else "AMD (ASCET 6)"
    return ReadResult(kind, build_set(members, (), origin), findings.finish())


def _single(source: CalibrationSource) -> tuple[AmdFiles, list[str]]:
    """Return the files beside a `.data.amd` file, and its path among them."""
    root = parse_amd(source.raw, source.name)
    if root.tag != "ComponentData":
        name = component_stem(source.name) + DATA
        message = "is a part of a component that has no values"
        raise InputError.of(Location(source.name), message, f"Name {name} of the component.")
    path = source.path
    main = None if path is None else path.with_name(component_stem(path.name) + MAIN)
    if path is not None and main is not None and path.name.endswith(DATA) and main.is_file():
        files, stem = open_folder(path)
        return files, [stem + DATA]
    return AmdFiles(source.name, (source.name,)), [source.name]


@dataclass(eq=False)
class _AmdReader:
    files: AmdFiles
    findings: FileFindings
    contents: dict[str, bytes] = field(default_factory=dict)
    values: list[tuple[str, AmdValue]] = field(default_factory=list)  # with the path of the component

    def __post_init__(self) -> None:
        self.library = ComponentLibrary(self.files)

    def read(self, path: str, raw: bytes | None) -> None:
        """Read the parameters of a `.data.amd` file."""
        self.contents[path] = self.files.read(path) if raw is None else raw
        root = parse_amd(self.contents[path], file_name(path))
        component = path.removesuffix(DATA)
        declared = self._declared(component, path)
        ranges = read_ranges(self.files.optional_root(component + IMPLEMENTATION))
        for data_set in read_data_sets(root):
            is_chosen = data_set.is_shared or data_set.is_default
            for entry in data_set.entries:
                # without declarations, any element may be a parameter
                element = declared.get(entry.element) if declared is not None else _undeclared(entry)
                if element is None or element.kind != "parameter" or entry.form == "complex":
                    continue
                variant = "" if is_chosen else data_set.name
                if entry.variant != _DEFAULT:
                    variant = f"{variant}/{entry.variant}".strip("/")
                self._add(path, element, entry, variant, ranges.get(("", element.name)))

    def _declared(self, component: str, path: str) -> dict[str, ComponentElement] | None:
        """Return the elements of a component by name; None if its `.main.amd` file is missing."""
        if component + MAIN in self.files:
            return {element.name: element for element in self.library.component(component).elements}
        message = f"{file_name(component + MAIN)} is missing: variables cannot be distinguished from parameters"
        remedy = "Keep all .amd files of a component together."
        self.findings.add(Finding(Location(file_name(path)), message, remedy, severity="warning"))
        return None

    def _add(
        self, path: str, element: ComponentElement, entry: DataEntry, variant: str, own: PhysicalRange | None
    ) -> None:
        problem = entry.problem or ("is a dependent parameter" if element.is_dependent else "")
        if not problem:
            try:
                item = _item(element, entry, variant, own)
            except ArgumentError as error:
                problem = str(error)
            else:
                self.values.append((path.removesuffix(DATA), AmdValue(path, item, entry, self._labels(element))))
                return
        self._skip(path, entry, problem)

    def _labels(self, element: ComponentElement) -> tuple[tuple[str, int], ...]:
        """Return the labels of the enumeration of an element; none if it is missing."""
        path = self.library.locate(element.reference) if element.basic_type == "enumeration" else None
        return () if path is None else self.library.component(path).labels

    def _skip(self, path: str, entry: DataEntry, problem: str) -> None:
        location = Location(file_name(path), entry.line, entry.element)
        self.findings.add(Finding(location, f"skipped: {problem}", severity="warning"))

    # names

    def named(self) -> dict[Key, AmdValue]:
        """Return the parameters by name and variant; with their component, and its folders, where a name repeats."""
        result: dict[Key, AmdValue] = {}
        owners = {(value.item.name, path) for path, value in self.values}
        counts = Counter(name for name, _ in owners)
        short = Counter(f"{file_name(path)}.{name}" for name, path in owners)
        for path, value in self.values:
            name = own = value.item.name
            if counts[own] > 1:
                name = f"{file_name(path)}.{own}"
                name = name if short[name] == 1 else f"{qualified_name(path)}.{own}"
            key = name, value.item.variant
            if key in result:
                self._skip(value.path, value.entry, "it has several values in one data set")
                continue
            item = value.item.changed(name=name) if not isinstance(value.item, Text) else _renamed(value.item, name)
            result[key] = replace(value, item=item)
        return result

    def prefixes(self) -> Iterator[str]:
        """Yield what may stand before the name of a parameter: its component, with and without folders."""
        for path in dict.fromkeys(path for path, _ in self.values):
            yield f"{qualified_name(path)}."
            yield f"{file_name(path)}."


def _renamed(text: Text, name: str) -> Text:
    return Text(name, text.text, text.description, variant=text.variant, unit=text.unit, kind=text.kind)


def _undeclared(entry: DataEntry) -> ComponentElement:
    """Return an element for values whose declaration is missing."""
    return ComponentElement(entry.element, "", "", entry.line, kind="parameter")


def _item(element: ComponentElement, entry: DataEntry, variant: str, own: PhysicalRange | None) -> Item:
    first = entry.values[0]
    if entry.form == "scalar" and first.kind == "Enumeration":
        return Text(element.name, first.text, element.comment, variant=variant, kind="enumeration")
    if any(value.kind == "Enumeration" for value in entry.values):
        raise ArgumentError("arrays and tables of enumerations are not supported")
    attributes: dict[str, Any] = {"unit": element.unit, "description": element.comment, "variant": variant}
    if own is not None and element.basic_type == "cont":
        attributes |= {"lower": np.array(own.low), "upper": np.array(own.high)}
    if entry.form == "scalar":
        return Scalar(element.name, first.number, **attributes)
    if entry.form == "Array":
        return Block(element.name, _numbers(entry.values), **attributes)
    axes = [Axis(points, falling=falls) for points, falls in map(in_rising_order, map(_numbers, entry.axes))]
    # the last axis runs fastest
    values = _numbers(entry.values).reshape([len(axis) for axis in axes])
    return parameter(element.name, turn(values, axes), axes, **attributes)


def _numbers(values: tuple[DataValue, ...]) -> Float:
    return np.array([value.number for value in values], dtype=np.float64)
