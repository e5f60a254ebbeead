"""Elements of components with their types and values, in the syntax tree of ESDL."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.components import ComponentElement
from kennfeld.ascet.amd.data_sets import DataEntry, DataValue
from kennfeld.ascet.amd.ranges import PhysicalRange, Ranges
from kennfeld.base.lazy_dataclass import dataclass

SHARED: Final = "shared"  # annotation of elements that all components know by their names
_UNSIGNED: Final = (0.0, 2.0**32 - 1)
_SIGNED: Final = (-(2.0**31), 2.0**31 - 1)
_KINDS: Final = {"parameter": "characteristic"}


@dataclass(frozen=True)
class ElementCode:
    """Declares elements.

    Attributes:
        file: name of the `.main.amd` file, for messages.
        ranges: physical ranges by method and name.
        qualified: returns the qualified name of the component at a path such as `/Lib/Filter/DT1`.
        data_sets: returns the names of the data sets of the class at a path.
    """

    file: str
    ranges: Ranges
    qualified: Callable[[str], str]
    data_sets: Callable[[str], Sequence[str]]

    def element(self, element: ComponentElement, entry: DataEntry | None) -> e.Element:
        """Return the declaration of an element with its value."""
        place = e.TextPosition(element.line, 0, file=self.file)
        flags = (("dT", element.basic_type == "dt"), ("set", element.is_set), ("get", element.is_get))
        names = [name for name, is_present in (*flags, (SHARED, element.is_shared)) if is_present]
        return e.Element(
            element.name,
            self.type(element),
            "const" if element.is_constant else _KINDS.get(element.kind, ""),
            value=self._value(element, entry),
            annotations=tuple(e.Annotation(name) for name in names),
            description=element.comment,
            place=place,
        )

    def type(self, element: ComponentElement, method: str = "") -> e.TypeExpression:
        """Return the type of an element, or of an argument or the result of a method."""
        place = e.TextPosition(element.line, 0, file=self.file)
        own = self.ranges.get((method, element.name or "return"))
        if element.is_dependent:
            return e.UnsupportedType("dependent parameter of ASCET 6", place=place)
        match element.model_type:
            case "scalar":
                return self._number(element, own, place)
            case "array" if element.sizes:
                size = e.Number(float(element.sizes[0]), False)
                return e.ArrayType((size,), self._number(element, own, place), place=place)
            case "oned" | "twod" if element.table_type == "normal":
                axis = e.TypeName("real", place=place)
                count = 1 if element.model_type == "oned" else 2
                return e.TableType((axis,) * count, self._number(element, own, place), place=place)
            case "complex" if element.reference:
                return e.TypeName(self.qualified(element.reference), place=place)
        kind = f"{element.model_type or 'unknown'} {element.basic_type} {element.table_type}".strip()
        return e.UnsupportedType(kind.removesuffix(" normal"), place=place)

    def _number(self, element: ComponentElement, own: PhysicalRange | None, place: e.TextPosition) -> e.TypeExpression:
        match element.basic_type:
            case "cont" | "dt":
                limits = None if own is None else _limits(own.low, own.high)
                is_limited = own is not None and own.is_limited
                return e.ScalarType("real", limits, unit=element.unit, is_limited=is_limited, place=place)
            case "udisc" | "sdisc":
                low, high = _UNSIGNED if element.basic_type == "udisc" else _SIGNED
                if own is not None and own.is_limited:
                    low, high = max(low, own.low), min(high, own.high)
                return e.ScalarType("integer", _limits(low, high), unit=element.unit, place=place)
            case "log":
                return e.TypeName("boolean", place=place)
            case "enumeration" if element.reference:
                return e.TypeName(self.qualified(element.reference), place=place)
        return e.UnsupportedType(element.basic_type or "unknown", place=place)

    def _value(self, element: ComponentElement, entry: DataEntry | None) -> e.Expression | None:
        """Return the initial value; None for that of the type."""
        place = e.TextPosition(element.line, 0, file=self.file)
        if entry is None:
            if element.kind == "parameter" or element.is_constant:
                remedy = "Keep the .amd file that exports it in the archive or folder."
                return e.Unsupported(f"{element.name} has no value in the files", remedy, place=place)
            return None
        if entry.problem:
            return e.Unsupported(f"{element.name} {entry.problem}", place=place)
        match entry.form:
            case "complex":
                return self._instance(element, entry)
            case "scalar":
                return _literal(entry.values[0], element)
            case "Array":
                return e.Braces(tuple(_literal(value, element) for value in entry.values))
        if any(after.number <= before.number for axis in entry.axes for before, after in pairwise(axis)):
            return e.Unsupported(f"{element.name} has breakpoints that do not increase", place=place)
        return _table(element, entry)

    def _instance(self, element: ComponentElement, entry: DataEntry) -> e.Expression | None:
        """Return the initializer with the values of a data set; None for the default one."""
        if entry.reference not in self.data_sets(element.reference):
            return None
        of = e.Name(self.qualified(element.reference).rpartition(".")[2])
        return e.Call(e.Field(of, entry.reference), ())


def _limits(low: float, high: float) -> e.Range:
    return e.Range(e.Number(low), e.Number(high))


def _literal(value: DataValue, element: ComponentElement) -> e.Expression:
    if value.kind == "Enumeration":
        return e.Name(value.text)
    if value.kind == "Logic":
        return e.Truth(value.number != 0.0)
    return e.Number(value.number, element.basic_type == "cont")


def _table(element: ComponentElement, entry: DataEntry) -> e.Expression:
    """Return breakpoints and values in braces, those of a map row by x."""
    axes = [e.Braces(tuple(e.Number(point.number) for point in axis)) for axis in entry.axes]
    values = [_literal(value, element) for value in entry.values]
    if len(axes) == 1:
        return e.Braces((*axes, e.Braces(tuple(values))))
    height = len(entry.axes[1])
    # values[x * height + y]
    rows = (e.Braces(tuple(values[at : at + height])) for at in range(0, len(values), height))
    return e.Braces((*axes, e.Braces(tuple(rows))))
