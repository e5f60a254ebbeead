"""The objects of parameter scripts: Simulink.Parameter, LookupTable, Breakpoint, Signal and variants.

In a script they are structs with the name of their class; `to_calibration_parameter` converts them for a calibration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.values import (
    EMPTY,
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    Value,
    array_value,
    characters,
    numbers,
    object_array,
    scalar,
    text,
)

_TABLE, _POINTS = "Simulink.lookuptable.Table", "Simulink.lookuptable.Breakpoint"
ENUMERATION = "Simulink.IntEnumType"
_VARIANTS, _CONTROL = ("Simulink.Variant", "Simulink.VariantExpression"), "Simulink.VariantControl"
_CODER = {"StorageClass": "Auto", "Alias": "", "Identifier": "", "CustomStorageClass": "Default"}
_PLAIN: Mapping[str, Value] = {
    "Value": EMPTY,
    "Min": EMPTY,
    "Max": EMPTY,
    "Unit": characters(""),
    "Description": characters(""),
    "DataType": characters("auto"),
}
_KINDS = frozenset(
    {"Parameter", "Signal", "LookupTable", "Breakpoint", "Bus", "BusElement", "NumericType", "AliasType"}
    | {"Variant", "VariantExpression", "VariantControl"}
)
_PACKAGES = frozenset({"Simulink", "mpt", "AUTOSAR", "AUTOSAR4", "ECoderDemos", "canlib", "lookuptable"})


@dataclass(frozen=True, eq=False)
class SimulinkParameter:
    """A Simulink.Parameter: its value, limits (None if not set), unit and description."""

    value: Float
    min: float | None = None
    max: float | None = None
    unit: str = ""
    description: str = ""


@dataclass(frozen=True, eq=False)
class Breakpoint:
    """The breakpoints of one dimension, from a Simulink.Breakpoint or a Simulink.LookupTable."""

    value: Float
    min: float | None = None
    max: float | None = None
    unit: str = ""
    description: str = ""
    name: str = ""


@dataclass(frozen=True, eq=False)
class LookupTable:
    """A Simulink.LookupTable: the values of its table and the breakpoints of each dimension."""

    value: Float
    breakpoints: Sequence[Breakpoint]
    min: float | None = None
    max: float | None = None
    unit: str = ""
    description: str = ""


def is_constructor(path: str) -> bool:
    """Return True if a dotted name is a supported class; companies derive their own from Simulink.Parameter.

    >>> is_constructor("Simulink.Parameter"), is_constructor("table.Value")
    (True, False)
    """
    package, _, kind = path.rpartition(".")
    return kind in _KINDS and bool(package) and (package in _PACKAGES or kind in ("Parameter", "Signal"))


def construct_object(path: str, arguments: Sequence[Value]) -> MatlabStruct:
    """Create an object of a class, with the value passed to its constructor, if any."""
    fields = default_properties(path)
    if path in (*_VARIANTS, _CONTROL):
        return _variant(path, fields, arguments)
    if arguments and "Value" in fields:
        fields["Value"] = arguments[0]
    return MatlabStruct.of(fields, path)


def _variant(path: str, fields: dict[str, Value], arguments: Sequence[Value]) -> MatlabStruct:
    """Create a variant with a condition, or a Simulink.VariantControl from name-value pairs."""
    if path in _VARIANTS and arguments:
        fields["Condition"] = arguments[0]
    for name, value in zip(arguments[::2], arguments[1::2], strict=False):
        if path == _CONTROL and isinstance(name, np.ndarray) and name.dtype.kind == "U" and text(name) in fields:
            fields[text(name)] = value
    return MatlabStruct.of(fields, path)


def define_enumeration(arguments: Sequence[Value]) -> tuple[str, MatlabStruct]:
    """Return name and members of `Simulink.defineIntEnumType(name, members, numbers)`.

    Raises:
        MatlabValueError: The arguments are incomplete or inconsistent.
    """
    if len(arguments) < 3 or not isinstance(arguments[1], MatlabCell):
        raise MatlabValueError("a name, a list of members and their numbers are required")
    members = [text(member) for member in arguments[1].values.ravel(order="F")]
    values = numbers(arguments[2]).ravel(order="F")
    if len(members) != values.size:
        raise MatlabValueError(f"{len(members)} members, but {values.size} numbers")
    fields: dict[str, Value] = {name: scalar(float(value)) for name, value in zip(members, values, strict=True)}
    return text(arguments[0]), MatlabStruct.of(fields, ENUMERATION)


def default_properties(kind: str) -> dict[str, Value]:
    """Return the properties of a new object of a class."""
    name = kind.rpartition(".")[2]
    if kind in _VARIANTS:
        return {"Condition": characters("")}
    if kind == _CONTROL:
        return {"Value": _PLAIN["Value"], "ActivationTime": characters("update diagram")}
    if kind in (_TABLE, _POINTS):
        return {**_PLAIN, "FieldName": characters("")}
    if name == "LookupTable":
        coder = MatlabStruct.of({key: characters(word) for key, word in _CODER.items()}, "Simulink.CoderInfo")
        return {
            "Table": MatlabStruct.of(default_properties(_TABLE), _TABLE),
            "Breakpoints": MatlabStruct(object_array([], (1, 0)), tuple(default_properties(_POINTS)), _POINTS),
            "BreakpointsSpecification": characters("Explicit values"),
            "CoderInfo": coder,
        }
    if name == "Breakpoint":
        return {"Breakpoints": MatlabStruct.of(default_properties(_POINTS), _POINTS)}
    if name in ("Parameter", "Signal"):
        coder = MatlabStruct.of({key: characters(word) for key, word in _CODER.items()}, "Simulink.CoderInfo")
        fields = dict(_PLAIN) if name == "Parameter" else {k: v for k, v in _PLAIN.items() if k != "Value"}
        return {**fields, "DocUnits": characters(""), "CoderInfo": coder, "StorageClass": characters("Auto")}
    return {}


def to_calibration_parameter(value: Value) -> SimulinkParameter | LookupTable | Breakpoint | None:
    """Convert a parameter object; None for any other value and for objects without numbers."""
    if not isinstance(value, MatlabStruct) or value.kind in ("", ENUMERATION) or value.elements.size != 1:
        return None
    fields = value.fields
    if isinstance(fields.get("Table"), MatlabStruct):
        return _table(fields)
    points = fields.get("Breakpoints")
    if isinstance(points, MatlabStruct) and points.elements.size == 1:
        breakpoints = _properties(points.fields)
        return None if breakpoints is None else Breakpoint(*breakpoints, _word(points.fields, "FieldName"))
    properties = _properties(fields)
    return None if properties is None else SimulinkParameter(*properties)


def _table(fields: Mapping[str, Value]) -> LookupTable | None:
    table, points = fields["Table"], fields.get("Breakpoints")
    assert isinstance(table, MatlabStruct)
    properties = _properties(table.fields)
    if properties is None or not isinstance(points, MatlabStruct):
        return None
    axes = [(one, _properties(one)) for one in points.elements.ravel(order="F")]
    if any(axis is None for _, axis in axes):
        return None
    named = [Breakpoint(*axis, _word(one, "FieldName")) for one, axis in axes if axis is not None]
    return LookupTable(properties[0], named, *properties[1:])


def _properties(fields: Mapping[str, Value]) -> tuple[Float, float | None, float | None, str, str] | None:
    """Return value, limits, unit and description."""
    value = fields.get("Value")
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fbiu":
        return None
    unit = _word(fields, "Unit") or _word(fields, "DocUnits")
    limits = [_limit(fields.get(name)) for name in ("Min", "Max")]
    return numbers(value), limits[0], limits[1], unit, _word(fields, "Description")


def _limit(value: Value | None) -> float | None:
    if not isinstance(value, np.ndarray) or value.size != 1 or value.dtype.kind not in "fbiu":
        return None
    limit = float(array_value(value).flat[0])
    return limit if np.isfinite(limit) else None


def _word(fields: Mapping[str, Value], name: str) -> str:
    value = fields.get(name)
    return text(value) if isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.shape[0] < 2 else ""
