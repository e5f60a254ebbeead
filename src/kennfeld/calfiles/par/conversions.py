"""Conversions of labels between stored and physical values, from the A2L file that belongs to a parameter file.

It is the one that is given, else the one that the first line of the parameter file names, if it is in the same folder.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.a2l.conversion import CompuConversion, conversion_of
from kennfeld.calfiles.a2l.image_files import describe_a2l
from kennfeld.calfiles.a2l.objects import A2l, AxisDescr, AxisPts, Characteristic
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.calfiles.format import CalibrationSource, FileFindings
from kennfeld.calfiles.par.lines import AXES

_NAMED = re.compile(r'[^\n:]*:\s*(?:"([^"\n]+)"|(\S+))')


@dataclass(frozen=True)
class StoredQuantity:
    """The conversion of some numbers and their unit; those of an axis have an input."""

    conversion: CompuConversion
    unit: str
    input: str = ""


@dataclass(frozen=True)
class Conversions:
    """The quantities of the labels of an A2L file."""

    a2l: A2l

    def values(self, name: str) -> StoredQuantity | None:
        """Return the quantity of a label's values; None if it is not described, or its conversion is not supported."""
        source = self.a2l.characteristics.get(name) or self.a2l.axis_pts.get(name)
        return None if source is None else self._quantity(source)

    def axis(self, name: str, letter: str) -> StoredQuantity | None:
        """Return the quantity of the breakpoints of an axis, X, Y or Z; None as for values."""
        source = self.a2l.characteristics.get(name)
        at = AXES.index(letter)
        return None if source is None or at >= len(source.axes) else self._quantity(source.axes[at])

    def description(self, name: str) -> str:
        """Return the description of a label; empty if it has none."""
        source = self.a2l.characteristics.get(name)
        return "" if source is None else source.description

    def _quantity(self, source: Characteristic | AxisPts | AxisDescr) -> StoredQuantity | None:
        try:
            conversion = conversion_of(self.a2l, source.conversion, source.lower, source.upper)
        except A2lError:
            return None
        unit = (source.phys_unit or conversion.unit).strip()
        quantity = source.input_quantity if isinstance(source, AxisDescr) else ""
        return StoredQuantity(conversion, unit, "" if quantity == "NO_INPUT_QUANTITY" else quantity)


def find_conversions(source: CalibrationSource, findings: FileFindings) -> Conversions | None:
    """Return the conversions of the A2L file of a parameter file; None if there is none.

    Raises `InputError` if the A2L file that was given cannot be read; one that was merely found gives a warning.
    """
    if source.partner is not None:
        return Conversions(describe_a2l(source.partner).a2l)
    match = _NAMED.match(source.text)
    if match is None or source.path is None:
        return None
    # the folder is that of the computer on which the file was written
    path = source.path.parent / Path((match[1] or match[2]).replace("\\", "/")).name
    if path.suffix.lower() != ".a2l" or not path.is_file():
        return None
    try:
        return Conversions(describe_a2l(path).a2l)
    except InputError as error:
        findings.warning(1, "", f"{path.name} is not used: {error.findings[0]}")
        return None


def stored(quantity: StoredQuantity, value: float) -> float | None:
    """Return the number that is stored for a physical value, not rounded; None if there is none."""
    raw = quantity.conversion.raw
    return None if raw is None else _finite(raw, value)


def physical(quantity: StoredQuantity, raw: float) -> float | None:
    """Return the physical value of a stored number; None if there is none."""
    return _finite(quantity.conversion.physical, raw)


def _finite(formula: Callable[..., np.ndarray], value: float) -> float | None:
    with np.errstate(all="ignore"):
        result = float(formula(np.array([value]))[0])
    return result if np.isfinite(result) else None
