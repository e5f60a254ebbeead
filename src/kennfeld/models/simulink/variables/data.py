"""Variables of a model workspace or a data dictionary, as far as they are plain values or well-known objects."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias, Union

import numpy as np

from kennfeld.arrays import Float, readonly

__all__ = ["Data", "Entry", "Value", "entry_of"]

Value: TypeAlias = Union[Float, str, "Mapping[str, Value]", "tuple[Value, ...]", "Entry", None]


@dataclass(frozen=True)
class Entry:
    """One variable.

    `value` is an array of at least two dimensions (numbers and booleans), a text, a mapping (a struct), a tuple (a
    cell array, an array of structs or objects), another entry (an object within), or None where the file gives none.
    `kind` is the class: "double", "single", "struct", "Simulink.Parameter", ... `type` is the data type that an object
    states ("auto", "single", "fixdt(1,16,4)"), `minimum` and `maximum` its limits. Of a Simulink.LookupTable, `value`
    is the table and `breakpoints` are its axes; all else it says is in `properties`.
    """

    name: str
    value: Value
    kind: str
    type: str = ""
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""
    breakpoints: tuple["Entry", ...] = ()
    properties: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Data:
    """The variables of one source; `unreadable` says by name what could not be decoded, and why."""

    entries: Mapping[str, Entry] = field(default_factory=dict)
    unreadable: Mapping[str, str] = field(default_factory=dict)


def entry_of(name: str, kind: str, properties: Mapping[str, Value]) -> Entry:
    """An object by its properties: what calibration needs of it by name, the rest as it is."""
    table, axes = properties.get("Table"), properties.get("Breakpoints")
    if table is not None:
        return _lookup(name, kind, properties, _part(table), tuple(map(_part, _several(axes))))
    inner = _several(axes)
    if inner and "Value" not in properties:
        properties = {**properties, **_part(inner[0])}
    return _plain(name, kind, properties)


def _lookup(
    name: str,
    kind: str,
    properties: Mapping[str, Value],
    table: Mapping[str, Value],
    axes: tuple[Mapping[str, Value], ...],
) -> Entry:
    made = _plain(name, kind, table)
    named = [
        _plain(_text(axis, "FieldName") or f"{name}.{number}", "breakpoints", axis)
        for number, axis in enumerate(axes, 1)
    ]
    return Entry(
        name,
        made.value,
        kind,
        made.type,
        made.unit,
        made.minimum,
        made.maximum,
        made.description,
        tuple(named),
        properties,
    )


def _plain(name: str, kind: str, properties: Mapping[str, Value]) -> Entry:
    return Entry(
        name,
        properties.get("Value"),
        kind,
        _text(properties, "DataType"),
        _text(properties, "Unit") or _text(properties, "DocUnits"),
        _limit(properties.get("Min")),
        _limit(properties.get("Max")),
        _text(properties, "Description"),
        properties={key: value for key, value in properties.items() if key != "Value"},
    )


def _part(value: Value) -> Mapping[str, Value]:
    """The properties of an inner struct or object."""
    if isinstance(value, Entry):
        return {**value.properties, "Value": value.value}
    return value if isinstance(value, Mapping) else {"Value": value}


def _several(value: Value) -> tuple[Value, ...]:
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)


def _text(properties: Mapping[str, Value], key: str) -> str:
    found = properties.get(key)
    return found if isinstance(found, str) else ""


def _limit(value: Value) -> float | None:
    """A limit; none where it is empty or infinite."""
    if not isinstance(value, np.ndarray) or value.size != 1:
        return None
    number = float(readonly(value).flat[0])
    return number if np.isfinite(number) else None
