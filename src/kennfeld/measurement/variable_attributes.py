"""Attributes of variables in HDF5 and netCDF files: units, descriptions, and packed numbers.

Source of the conventions: NetCDF Climate and Forecast (CF) Metadata Conventions 1.11, sections 2.5, 3.1, 4.4 and 8.1.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kennfeld.arrays import Float

_UNITS = ("units", "unit", "Units", "Unit", "UNITS", "UNIT")
_DESCRIPTIONS = ("long_name", "description", "Description", "comment", "Comment", "standard_name")
_MISSING = ("_FillValue", "missing_value")


def unit_of(attributes: Mapping[str, Any]) -> str:
    """Return the unit; of a time such as `seconds since 2020-01-01` the part before the date.

    >>> unit_of({"units": b"seconds since 2020-01-01"}), unit_of({"Unit": "rpm"}), unit_of({})
    ('seconds', 'rpm', '')
    """
    text = next((text for name in _UNITS if (text := _text(attributes, name))), "")
    return text.partition(" since ")[0].strip()


def description_of(attributes: Mapping[str, Any]) -> str:
    """Return the description; empty if there is none."""
    return next((text for name in _DESCRIPTIONS if (text := _text(attributes, name))), "")


def unpack_numbers(values: Any, attributes: Mapping[str, Any]) -> Float:
    """Return stored numbers as physical ones: NaN where they are missing, then scaled.

    >>> unpack_numbers(np.array([1, -1, 3]), {"_FillValue": -1, "scale_factor": 0.5, "add_offset": 10.0})
    array([10.5,  nan, 11.5])
    """
    stored = np.asarray(values)
    numbers = stored.astype(np.float64)
    for name in _MISSING:
        for missing in np.ravel(attributes.get(name, ())):
            if isinstance(missing, int | float | np.number):
                numbers[stored == missing] = np.nan
    factor, offset = _number(attributes, "scale_factor", 1.0), _number(attributes, "add_offset", 0.0)
    return numbers if (factor, offset) == (1.0, 0.0) else numbers * factor + offset


def _text(attributes: Mapping[str, Any], name: str) -> str:
    value = attributes.get(name, "")
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    return value.strip("\0 ") if isinstance(value, str) else ""


def _number(attributes: Mapping[str, Any], name: str, default: float) -> float:
    value = np.ravel(attributes.get(name, default))
    return float(value[0]) if value.size == 1 and np.issubdtype(value.dtype, np.number) else default
