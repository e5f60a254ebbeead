"""The objects of parameter scripts: Simulink.Parameter, LookupTable, Breakpoint, Signal, variants and data types.

In a script they are structs with the name of their class; `to_calibration_parameter` converts them for a calibration.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab import values as v
from kennfeld.matlab.simulink_types import ALIAS_TYPE, type_properties

_TABLE, _POINTS = "Simulink.lookuptable.Table", "Simulink.lookuptable.Breakpoint"
ENUMERATION = "Simulink.IntEnumType"
_VARIANTS, _CONTROL = ("Simulink.Variant", "Simulink.VariantExpression"), "Simulink.VariantControl"
_NO_TEXT = v.characters("")
_CODER = v.MatlabStruct.of(
    {
        "StorageClass": v.characters("Auto"), "Alias": _NO_TEXT, "Identifier": _NO_TEXT,
        "CustomStorageClass": v.characters("Default"),
    },
    "Simulink.CoderInfo",
)  # fmt: skip
_PLAIN: Mapping[str, v.Value] = {
    "Value": v.EMPTY, "Min": v.EMPTY, "Max": v.EMPTY, "Unit": _NO_TEXT, "Description": _NO_TEXT,
    "DataType": v.characters("auto"),
}  # fmt: skip
_KINDS = frozenset(
    {"Parameter", "Signal", "LookupTable", "Breakpoint", "Bus", "BusElement", "NumericType", "AliasType", "ValueType"}
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
class StructParameter:
    """A Simulink.Parameter whose value is a struct, the fields of which have neither limits nor units of their own."""

    value: v.MatlabStruct
    description: str = ""


@dataclass(frozen=True, eq=False)
class Breakpoint(SimulinkParameter):
    """The breakpoints of one dimension, from a Simulink.Breakpoint or a Simulink.LookupTable."""

    name: str = ""


@dataclass(frozen=True, eq=False)
class LookupTable(SimulinkParameter):
    """A Simulink.LookupTable: the values of its table and the breakpoints of each dimension."""

    breakpoints: Sequence[Breakpoint] = ()


def is_constructor(path: str) -> bool:
    """Return True if a dotted name is a supported class; companies derive their own from Simulink.Parameter.

    >>> is_constructor("Simulink.Parameter"), is_constructor("table.Value")
    (True, False)
    """
    package, _, kind = path.rpartition(".")
    return kind in _KINDS and bool(package) and (package in _PACKAGES or kind in ("Parameter", "Signal"))


def construct_object(path: str, arguments: Sequence[v.Value]) -> v.MatlabStruct:
    """Create an object of a class from the arguments of its constructor: a value, a condition or name-value pairs."""
    fields = default_properties(path)
    if path == _CONTROL:
        for name, value in zip(arguments[::2], arguments[1::2], strict=False):
            if isinstance(name, np.ndarray) and name.dtype.kind == "U" and v.text(name) in fields:
                fields[v.text(name)] = value
        return v.MatlabStruct.of(fields, path)
    first = "Condition" if path in _VARIANTS else "BaseType" if path == ALIAS_TYPE else "Value"
    if arguments and first in fields:
        fields[first] = arguments[0]
    return v.MatlabStruct.of(fields, path)


def define_enumeration(arguments: Sequence[v.Value]) -> tuple[str, v.MatlabStruct]:
    """Return name and members of `Simulink.defineIntEnumType(name, members, numbers)`.

    Raises:
        MatlabValueError: The arguments are incomplete or inconsistent.
    """
    if len(arguments) < 3 or not isinstance(arguments[1], v.MatlabCell):
        raise v.MatlabValueError("a name, a list of members and their numbers are required")
    members = [v.text(member) for member in arguments[1].values.ravel(order="F")]
    values = v.numbers(arguments[2]).ravel(order="F")
    if len(members) != values.size:
        raise v.MatlabValueError(f"{len(members)} members, but {values.size} numbers")
    numbers = with_default(dict(zip(members, map(float, values), strict=True)), _default_member(arguments[3:]))
    fields: dict[str, v.Value] = {name: v.scalar(value) for name, value in numbers.items()}
    return v.text(arguments[0]), v.MatlabStruct.of(fields, ENUMERATION)


def with_default(members: Mapping[str, float], default: str) -> dict[str, float]:
    """Return the members of an enumeration with the default one first, in their order if it is none of them."""
    return {default: members[default], **members} if default in members else dict(members)


def _default_member(options: Sequence[v.Value]) -> str:
    """Return the member that the option DefaultValue names, "" if there is none."""
    texts = [
        v.text(option) if isinstance(option, np.ndarray) and option.dtype.kind == "U" else "" for option in options
    ]
    return next((value for name, value in pairwise(texts) if name == "DefaultValue"), "")


def default_properties(kind: str) -> dict[str, v.Value]:
    """Return the properties of a new object of a class."""
    name = kind.rpartition(".")[2]
    if kind in _VARIANTS:
        return {"Condition": _NO_TEXT}
    if kind == _CONTROL:
        return {"Value": _PLAIN["Value"], "ActivationTime": v.characters("update diagram")}
    if kind in (_TABLE, _POINTS):
        return {**_PLAIN, "FieldName": _NO_TEXT}
    if name == "LookupTable":
        return {
            "Table": v.MatlabStruct.of(default_properties(_TABLE), _TABLE),
            "Breakpoints": v.MatlabStruct(v.object_array([], (1, 0)), tuple(default_properties(_POINTS)), _POINTS),
            "BreakpointsSpecification": v.characters("Explicit values"),
            "CoderInfo": _CODER,
        }
    if name == "Breakpoint":
        return {"Breakpoints": v.MatlabStruct.of(default_properties(_POINTS), _POINTS)}
    if name in ("Parameter", "Signal"):
        fields = {key: value for key, value in _PLAIN.items() if key != "Value" or name == "Parameter"}
        # -1: inherited
        store = {"InitialValue": _NO_TEXT, "Dimensions": v.scalar(-1.0)} if name == "Signal" else {}
        return {**fields, **store, "DocUnits": _NO_TEXT, "CoderInfo": _CODER, "StorageClass": v.characters("Auto")}
    return type_properties(kind)


def to_calibration_parameter(value: v.Value) -> SimulinkParameter | StructParameter | None:
    """Convert a parameter object; None for any other value and for objects without numbers."""
    if not isinstance(value, v.MatlabStruct) or value.kind in ("", ENUMERATION) or value.elements.size != 1:
        return None
    fields = value.fields
    if isinstance(fields.get("Table"), v.MatlabStruct):
        return _table(fields)
    # a Simulink.Breakpoint has breakpoints, but no table
    points = fields.get("Breakpoints")
    if isinstance(points, v.MatlabStruct) and points.elements.size == 1:
        return _breakpoint(points.fields)
    inner = fields.get("Value")
    if isinstance(inner, v.MatlabStruct) and not inner.kind:
        return StructParameter(inner, _word(fields, "Description"))
    properties = _properties(fields)
    return None if properties is None else SimulinkParameter(*properties)


def _table(fields: Mapping[str, v.Value]) -> LookupTable | None:
    table, points = fields["Table"], fields.get("Breakpoints")
    assert isinstance(table, v.MatlabStruct)
    properties = _properties(table.fields)
    if properties is None or not isinstance(points, v.MatlabStruct):
        return None
    axes = [axis for item in points.elements.ravel(order="F") if (axis := _breakpoint(item)) is not None]
    return LookupTable(*properties, axes) if len(axes) == points.elements.size else None


def _breakpoint(fields: Mapping[str, v.Value]) -> Breakpoint | None:
    properties = _properties(fields)
    return None if properties is None else Breakpoint(*properties, _word(fields, "FieldName"))


def _properties(fields: Mapping[str, v.Value]) -> tuple[Float, float | None, float | None, str, str] | None:
    """Return value, limits, unit and description."""
    value = fields.get("Value")
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fbiu":
        return None
    # older releases store the unit as DocUnits
    unit = _word(fields, "Unit") or _word(fields, "DocUnits")
    limits = [_limit(fields.get(name)) for name in ("Min", "Max")]
    return v.numbers(value), limits[0], limits[1], unit, _word(fields, "Description")


def _limit(value: v.Value | None) -> float | None:
    # a limit that is not set is [] or infinite
    if not isinstance(value, np.ndarray) or value.size != 1 or value.dtype.kind not in "fbiu":
        return None
    limit = float(v.array_value(value).flat[0])
    return limit if np.isfinite(limit) else None


def _word(fields: Mapping[str, v.Value], name: str) -> str:
    value = fields.get(name)
    return v.text(value) if isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.shape[0] < 2 else ""
