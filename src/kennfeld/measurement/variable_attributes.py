"""Attributes of variables in HDF5 and netCDF files: units, descriptions, and packed numbers.

Source of the conventions: NetCDF Climate and Forecast (CF) Metadata Conventions 1.11, sections 2.5, 3.1, 4.4 and 8.1,
and the Attribute Conventions of the NetCDF Users Guide (`_Unsigned`, `valid_range`).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.measurement.unit_text import in_seconds, says_time

_UNITS = ("units", "unit", "Units", "Unit", "UNITS", "UNIT")
_DESCRIPTIONS = ("long_name", "description", "Description", "comment", "Comment", "standard_name")
_MISSING = ("_FillValue", "missing_value")
_NEVER_WRITTEN = 9.969209968386869e36  # what netCDF puts where no number was written
_SINCE = " since "
_PLACEHOLDER = "This is a netCDF dimension but not a netCDF variable"


def unit_of(attributes: Mapping[str, Any]) -> str:
    """Return the unit; of a time such as `seconds since 2020-01-01` the part before the date.

    >>> unit_of({"units": b"seconds since 2020-01-01"}), unit_of({"Unit": "rpm"}), unit_of({})
    ('seconds', 'rpm', '')
    """
    text = next((text for name in _UNITS if (text := _text(attributes, name))), "")
    return text.partition(_SINCE)[0].strip()


def description_of(attributes: Mapping[str, Any]) -> str:
    """Return the description; empty if there is none."""
    return next((text for name in _DESCRIPTIONS if (text := _text(attributes, name))), "")


def texts_of(attributes: Mapping[str, Any], name: str) -> list[str]:
    """Return the texts of an attribute that holds several; empty if there are none."""
    values = attributes.get(name, ())
    if not isinstance(values, np.ndarray | list | tuple):
        return []
    return [text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in values]


def is_time_coordinate(attributes: Mapping[str, Any]) -> bool:
    """Return whether the attributes of a variable say that it is the time of the others.

    >>> is_time_coordinate({"units": "hours since 2020-01-01"}), is_time_coordinate({"units": "ms"})
    (True, False)
    """
    stated = next((text for name in _UNITS if (text := _text(attributes, name))), "")
    timed = in_seconds(unit_of(attributes)) is not None
    if (timed and _SINCE in stated) or _text(attributes, "standard_name") == "time" or _text(attributes, "axis") == "T":
        return True
    is_scale = _text(attributes, "CLASS") == "DIMENSION_SCALE"
    return timed and (is_scale or says_time(_text(attributes, "long_name")))


def is_placeholder(attributes: Mapping[str, Any]) -> bool:
    """Return whether a dataset only states the length of a dimension of netCDF 4, without values."""
    return _text(attributes, "NAME").startswith(_PLACEHOLDER)


def unpack_numbers(values: Any, attributes: Mapping[str, Any]) -> Float:
    """Convert stored numbers, any[samples], to physical ones, Float[samples]: NaN where they are missing, then scaled.

    >>> unpack_numbers(np.array([1, -1, 3]), {"_FillValue": -1, "scale_factor": 0.5, "add_offset": 10.0})
    array([10.5,  nan, 11.5])
    """
    stored = np.asarray(values)
    is_unsigned = stored.dtype.kind == "i" and _text(attributes, "_Unsigned").casefold() == "true"
    numbers = (stored.view(f"{stored.dtype.byteorder}u{stored.dtype.itemsize}") if is_unsigned else stored).astype(
        np.float64
    )
    if stored.dtype.kind == "f":
        # rounded to the type of the file
        numbers[numbers == np.float64(stored.dtype.type(_NEVER_WRITTEN))] = np.nan
    # the limits of an unsigned variable are stored as signed numbers, too
    if not is_unsigned:
        low, high = _valid_range(attributes)
        numbers[(numbers < low) | (numbers > high)] = np.nan
    for name in _MISSING:
        for missing in np.ravel(attributes.get(name, ())):
            if isinstance(missing, int | float | np.number):
                # before scaling: these attributes hold packed numbers (CF 8.1)
                numbers[stored == missing] = np.nan
    factor, offset = _number(attributes, "scale_factor", 1.0), _number(attributes, "add_offset", 0.0)
    return numbers if (factor, offset) == (1.0, 0.0) else numbers * factor + offset


def _valid_range(attributes: Mapping[str, Any]) -> tuple[float, float]:
    bounds = np.ravel(attributes.get("valid_range", ()))
    if bounds.size == 2 and np.issubdtype(bounds.dtype, np.number):
        return float(bounds[0]), float(bounds[1])
    return _number(attributes, "valid_min", -np.inf), _number(attributes, "valid_max", np.inf)


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
