"""Reads the characteristics of the classes of an ESDL file, and where their numbers are in its text.

A table has its breakpoints and its values, a row for each x, in braces: `{{x, ...}, {y, ...}, {{z, ...}, ...}}`. Other
braces are value blocks. Enumerations and structs are skipped: their types may be in other files.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import field

import numpy as np

from kennfeld.ascet import syntax as e
from kennfeld.ascet.parser import scan_esdl
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import in_rising_order, turn
from kennfeld.calfiles.format import CalibrationSource, FileFindings, ReadResult
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Parameter, Scalar, parameter

Number = e.Number | e.Truth | e.Unary


@dataclass(frozen=True)
class EsdlValue:
    """The numbers of a characteristic: those of each axis, and the values, as trees with their positions.

    An axis of the parameter falls if it does in the file.
    """

    parameter: Parameter
    axes: tuple[tuple[Number, ...], ...]
    values: tuple[Number, ...]


@dataclass(frozen=True)
class EsdlAxis:
    """A shared axis, which falls if it does in the file, and its numbers as trees with their positions."""

    axis: Axis
    points: tuple[Number, ...]


@dataclass(frozen=True)
class EsdlOrigin:
    """An ESDL file as read: its text, and its characteristics by name; `prefixes` are those of long names."""

    source: CalibrationSource
    text: str
    items: Mapping[str, EsdlValue]
    axes: Mapping[str, EsdlAxis]
    prefixes: tuple[str, ...] = ()

    def item(self, name: str) -> EsdlValue | None:
        """Return the characteristic of a name, which may be the long one of ASCET."""
        return next((self.items[short] for short in self.short_names(name) if short in self.items), None)

    def short_names(self, name: str) -> Iterator[str]:
        """Yield a name as it is, and without the package and the class."""
        yield name
        yield from (name[len(prefix) :] for prefix in self.prefixes if name.startswith(prefix))


def read_esdl(source: CalibrationSource) -> ReadResult:
    """Return the characteristics of all classes of an ESDL file; raises `InputError` with all syntax errors.

    A characteristic is named as its element; with its class if several classes of the file have one of that name.
    """
    findings = FileFindings(source.name)
    text = "".join(source.lines)
    parsed = scan_esdl(text, source.name)
    findings.add(*parsed.findings)
    findings.finish()
    reader = _EsdlReader(parsed.file, findings)
    reader.read()
    package = f"{parsed.file.package}." if parsed.file.package else ""
    classes = [item.name for item in parsed.file.declarations if isinstance(item, e.ClassDeclaration)]
    prefixes = tuple(prefix for name in classes for prefix in (f"{package}{name}.", f"{name}."))
    origin = EsdlOrigin(source, text, reader.items, reader.axes, prefixes)
    items, axes = [item.parameter for item in reader.items.values()], [each.axis for each in reader.axes.values()]
    return ReadResult("ESDL", ParameterSet(items, (), axes, origin=origin), findings.finish())


@dataclass(eq=False)
class _EsdlReader:
    file: e.EsdlFile
    findings: FileFindings
    items: dict[str, EsdlValue] = field(default_factory=dict)
    axes: dict[str, EsdlAxis] = field(default_factory=dict)

    def read(self) -> None:
        """Read all characteristics, the shared axes of a class before its tables."""
        self.kinds = {item.name: item.type for item in self.file.declarations if isinstance(item, e.TypeDeclaration)}
        classes = [item for item in self.file.declarations if isinstance(item, e.ClassDeclaration)]
        elements = [(item, element) for item in classes for element in item.elements if _is_read(element)]
        counts = Counter(element.name for _, element in elements)
        self.shared = {size.name for _, element in elements for size in element.sizes if isinstance(size, e.Name)}
        # False comes before True
        for owner, element in sorted(elements, key=lambda pair: pair[1].name not in self.shared):
            name = element.name if counts[element.name] == 1 else f"{owner.name}.{element.name}"
            try:
                self._add(name, element)
            except ArgumentError as error:
                self.findings.warning(element.place.line, name, f"skipped: {error}")

    def _add(self, name: str, element: e.Element) -> None:
        value = element.value
        assert value is not None
        if element.name in self.shared:
            self._add_axis(name, value)
            return
        if isinstance(value, Number):
            if isinstance(number := _number(value), float):
                self._keep(Scalar(name, number, description=element.description), (), (value,))
            return
        if not isinstance(value, e.Braces):
            return
        names = [size.name for size in element.sizes if isinstance(size, e.Name) and size.name in self.axes]
        if names and len(names) == len(element.sizes):
            self._add_group_table(name, element, value, [self.axes[name].axis for name in names])
        elif self._is_table(element, value):
            self._add_table(name, element, value)
        else:
            self._add_block(name, element, value)

    def _add_axis(self, name: str, value: e.Expression) -> None:
        points = _array(value)
        if points is not None and points.ndim == 1:
            self.axes[name] = EsdlAxis(_axis(points, name), tuple(_leaves(value)))

    def _is_table(self, element: e.Element, value: e.Braces) -> bool:
        """Return True if the braces hold breakpoints and values: that is in their form, if not in their type."""
        kind = self.kinds.get(element.type.name) if isinstance(element.type, e.TypeName) else None
        if kind is not None and not isinstance(kind, e.TypeName):
            return isinstance(kind, e.TableType)
        *points, values = [_array(part) for part in value.elements]
        if values is None or len(points) != max(len(element.sizes), 1) or any(item is None for item in points):
            return False
        sizes = tuple(item.size for item in points if item is not None and item.ndim == 1)
        return values.shape == sizes

    def _add_table(self, name: str, element: e.Element, value: e.Braces) -> None:
        *points, values = value.elements
        arrays = [array for part in points if (array := _array(part)) is not None]
        numbers = _array(values)
        if numbers is None or len(arrays) != len(points):
            self.findings.warning(element.place.line, name, "skipped: its breakpoints or values are not numbers")
            return
        axes = [_axis(array) for array in arrays]
        item = parameter(name, turn(numbers, axes), axes, description=element.description)
        self._keep(item, tuple(tuple(_leaves(part)) for part in points), tuple(_leaves(values)))

    def _add_group_table(self, name: str, element: e.Element, value: e.Braces, axes: list[Axis]) -> None:
        numbers = _array(value)
        if numbers is not None:
            item = parameter(name, turn(numbers, axes), axes, description=element.description)
            self._keep(item, (), tuple(_leaves(value)))

    def _add_block(self, name: str, element: e.Element, value: e.Braces) -> None:
        numbers = _array(value)
        if numbers is not None and numbers.size:
            self._keep(Block(name, numbers, description=element.description), (), tuple(_leaves(value)))

    def _keep(self, item: Parameter, axes: tuple[tuple[Number, ...], ...], values: tuple[Number, ...]) -> None:
        self.items[item.name] = EsdlValue(item, axes, values)


def _axis(points: Float, name: str = "") -> Axis:
    rising, falls = in_rising_order(points)
    return Axis(rising, name=name, falling=falls)


def _is_read(element: e.Element) -> bool:
    return element.kind == "characteristic" and element.value is not None and element.formula is None


def _number(tree: e.Expression) -> float | None:
    match tree:
        case e.Number(value) | e.Unary("+", e.Number(value)):
            return value
        case e.Truth(value):
            return float(value)
        case e.Unary("-", e.Number(value)):
            return -value
    return None


def _leaves(tree: e.Expression) -> Iterator[Number]:
    """Yield the numbers of a tree in the order of the text."""
    if isinstance(tree, e.Braces):
        for part in tree.elements:
            yield from _leaves(part)
    elif isinstance(tree, Number):
        yield tree


def _array(tree: e.Expression) -> Float | None:
    """Return the numbers of a tree as an array; None if it holds anything else, or rows of different lengths."""
    nested = _nested(tree)
    try:
        array = np.array(nested, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    # numpy makes NaN of a part that is not a number
    return array if np.all(np.isfinite(array)) else None


def _nested(tree: e.Expression) -> object:
    return [_nested(part) for part in tree.elements] if isinstance(tree, e.Braces) else _number(tree)
