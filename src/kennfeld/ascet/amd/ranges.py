"""Physical ranges of elements, from the `.implementation.amd` file of a component."""

import math
from typing import TypeAlias

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement


@dataclass(frozen=True)
class PhysicalRange:
    """The physical interval of an element; `is_limited` if assignments are limited to it."""

    low: float
    high: float
    is_limited: bool = False


Ranges: TypeAlias = dict[tuple[str, str], PhysicalRange]  # by method, "" for elements, and name


def read_ranges(root: XmlElement | None) -> Ranges:
    """Read the ranges of the elements, arguments and table values of a component; none without a file."""
    result: Ranges = {}
    if root is None:
        return result
    for item in root.walk():
        if item.tag == "ElementImplementation":
            values = next((part for part in item.walk() if part.tag == "TableValues"), item)
            own = _range(values)
            if own is not None:
                result.setdefault((item.get("methodName"), item.get("elementName")), own)
    return result


def _range(element: XmlElement) -> PhysicalRange | None:
    for item in element.walk():
        if item.tag == "NumericImplementation" and (interval := item.first("PhysicalInterval")) is not None:
            try:
                low, high = float(interval.get("min")), float(interval.get("max"))
            except ValueError:
                return None
            if math.isfinite(low) and math.isfinite(high) and low < high:
                return PhysicalRange(low, high, item.is_true("limitAssignments"))
    return None
