"""The objects of parameter scripts: Simulink.Parameter, Simulink.LookupTable, Simulink.Breakpoint, signals.

In a script they are structs with the name of their class; `parameter_of` says what they mean to a calibration.
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

__all__ = [
    "ENUMERATION",
    "Breakpoint",
    "LookupTable",
    "SimulinkParameter",
    "construct_object",
    "defaults",
    "enumeration",
    "is_constructor",
    "to_calibration_parameter",
]

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
    """A Simulink.Parameter: its value, limits (None where there are none), unit and description."""

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
    """A Simulink.LookupTable: the values of its table, and the breakpoints of each dimension."""

    value: Float
    breakpoints: Sequence[Breakpoint]
    min: float | None = None
    max: float | None = None
    unit: str = ""
    description: str = ""


def is_constructor(path: str) -> bool:
    """Whether a dotted name is that of a class known here; companies derive their own from Simulink.Parameter.

    >>> is_constructor("Simulink.Parameter"), is_constructor("table.Value")
    (True, False)
    """
    package, _, kind = path.rpartition(".")
    return kind in _KINDS and bool(package) and (package in _PACKAGES or kind in ("Parameter", "Signal"))


def construct_object(path: str, arguments: Sequence[Value]) -> MatlabStruct:
    """A new object of a class, with the value given to its constructor, if any."""
    fields = defaults(path)
    if path in (*_VARIANTS, _CONTROL):
        return _variant(path, fields, arguments)
    if arguments and "Value" in fields:
        fields["Value"] = arguments[0]
    return MatlabStruct.of(fields, path)


def _variant(path: str, fields: dict[str, Value], arguments: Sequence[Value]) -> MatlabStruct:
    """A Simulink.Variant or VariantExpression of a condition, or a Simulink.VariantControl of properties in pairs."""
    if path in _VARIANTS and arguments:
        fields["Condition"] = arguments[0]
    for name, value in zip(arguments[::2], arguments[1::2], strict=False):
        if path == _CONTROL and isinstance(name, np.ndarray) and name.dtype.kind == "U" and text(name) in fields:
            fields[text(name)] = value
    return MatlabStruct.of(fields, path)


def enumeration(arguments: Sequence[Value]) -> tuple[str, MatlabStruct]:
    """What Simulink.defineIntEnumType makes of a name, a list of members and their numbers; raises `NoValueError`."""
    if len(arguments) < 3 or not isinstance(arguments[1], MatlabCell):
        raise MatlabValueError("it takes a name, a list of members and their numbers")
    members = [text(one) for one in arguments[1].values.ravel(order="F")]
    values = numbers(arguments[2]).ravel(order="F")
    if len(members) != values.size:
        raise MatlabValueError(f"it has {len(members)} members and {values.size} numbers")
    fields: dict[str, Value] = {name: scalar(float(value)) for name, value in zip(members, values, strict=True)}
    return text(arguments[0]), MatlabStruct.of(fields, ENUMERATION)


def defaults(kind: str) -> dict[str, Value]:
    """The properties of a new object of a class."""
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
            "Table": MatlabStruct.of(defaults(_TABLE), _TABLE),
            "Breakpoints": MatlabStruct(object_array([], (1, 0)), tuple(defaults(_POINTS)), _POINTS),
            "BreakpointsSpecification": characters("Explicit values"),
            "CoderInfo": coder,
        }
    if name == "Breakpoint":
        return {"Breakpoints": MatlabStruct.of(defaults(_POINTS), _POINTS)}
    if name in ("Parameter", "Signal"):
        coder = MatlabStruct.of({key: characters(word) for key, word in _CODER.items()}, "Simulink.CoderInfo")
        fields = dict(_PLAIN) if name == "Parameter" else {k: v for k, v in _PLAIN.items() if k != "Value"}
        return {**fields, "DocUnits": characters(""), "CoderInfo": coder, "StorageClass": characters("Auto")}
    return {}


def to_calibration_parameter(value: Value) -> SimulinkParameter | LookupTable | Breakpoint | None:
    """What an object means; None for what is none of those objects, or has no numbers."""
    if not isinstance(value, MatlabStruct) or value.kind in ("", ENUMERATION) or value.elements.size != 1:
        return None
    fields = value.fields
    if isinstance(fields.get("Table"), MatlabStruct):
        return _table(fields)
    points = fields.get("Breakpoints")
    if isinstance(points, MatlabStruct) and points.elements.size == 1:
        found = _said(points.fields)
        return None if found is None else Breakpoint(*found, _word(points.fields, "FieldName"))
    said = _said(fields)
    return None if said is None else SimulinkParameter(*said)


def _table(fields: Mapping[str, Value]) -> LookupTable | None:
    table, points = fields["Table"], fields.get("Breakpoints")
    assert isinstance(table, MatlabStruct)
    said = _said(table.fields)
    if said is None or not isinstance(points, MatlabStruct):
        return None
    axes = [(one, _said(one)) for one in points.elements.ravel(order="F")]
    if any(axis is None for _, axis in axes):
        return None
    named = [Breakpoint(*axis, _word(one, "FieldName")) for one, axis in axes if axis is not None]
    return LookupTable(said[0], named, *said[1:])


def _said(fields: Mapping[str, Value]) -> tuple[Float, float | None, float | None, str, str] | None:
    """Value, limits, unit and description."""
    value = fields.get("Value")
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fbiu":
        return None
    unit = _word(fields, "Unit") or _word(fields, "DocUnits")
    limits = [_limit(fields.get(name)) for name in ("Min", "Max")]
    return numbers(value), limits[0], limits[1], unit, _word(fields, "Description")


def _limit(value: Value | None) -> float | None:
    if not isinstance(value, np.ndarray) or value.size != 1 or value.dtype.kind not in "fbiu":
        return None
    found = float(array_value(value).flat[0])
    return found if np.isfinite(found) else None


def _word(fields: Mapping[str, Value], name: str) -> str:
    value = fields.get(name)
    return text(value) if isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.shape[0] < 2 else ""
