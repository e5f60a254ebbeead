"""Data types that scripts define: buses, aliases and fixed-point types, as structs with the name of their class."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from kennfeld.matlab import values as v

BUS: Final = "Simulink.Bus"
BUS_ELEMENT: Final = "Simulink.BusElement"
NUMERIC_TYPE: Final = "Simulink.NumericType"
ALIAS_TYPE: Final = "Simulink.AliasType"
VALUE_TYPE: Final = "Simulink.ValueType"
TYPE_CLASSES: Final = frozenset({BUS, NUMERIC_TYPE, ALIAS_TYPE, VALUE_TYPE})

_NO_TEXT = v.characters("")
_ELEMENT: Mapping[str, v.Value] = {
    "Name": v.characters("a"), "DataType": v.characters("double"), "Dimensions": v.scalar(1.0),
    "Min": v.EMPTY, "Max": v.EMPTY, "Unit": _NO_TEXT, "Description": _NO_TEXT,
}  # fmt: skip
_PROPERTIES: Mapping[str, Mapping[str, v.Value]] = {
    BUS: {"Elements": v.MatlabStruct(v.object_array([], (0, 1)), tuple(_ELEMENT), BUS_ELEMENT)},
    BUS_ELEMENT: _ELEMENT,
    NUMERIC_TYPE: {
        "DataTypeMode": v.characters("Double"), "Signedness": v.characters("Signed"), "WordLength": v.scalar(16.0),
        "FractionLength": v.scalar(0.0), "Bias": v.scalar(0.0),
    },
    ALIAS_TYPE: {"BaseType": v.characters("double")},
    VALUE_TYPE: {name: value for name, value in _ELEMENT.items() if name != "Name"},
}  # fmt: skip
_MODE: Final = "Fixed-point: "
MOST_BITS: Final = 128  # of a fixed-point type
_MAX_DEPTH: Final = 50
_MAX_ZEROS: Final = 1_000_000


def type_properties(kind: str) -> dict[str, v.Value]:
    """Return the properties of a new type object, {} for other classes."""
    return dict(_PROPERTIES.get(kind, {}))


def buses_of_cells(listed: v.Value) -> dict[str, v.MatlabStruct]:
    """Return the buses that `Simulink.Bus.cellToObject(listed)` defines, by name.

    Raises:
        MatlabValueError: The list does not have the form {{name, ..., {element, ...}}, ...}.
    """
    buses: dict[str, v.MatlabStruct] = {}
    for bus in _cells(listed, "buses"):
        parts = _cells(bus, "the parts of a bus")
        # header file, description and so on in between, more of them with each release
        elements = [part for part in parts[1:] if isinstance(part, v.MatlabCell)]
        if not elements:
            raise v.MatlabValueError("a bus requires a name and a list of elements")
        fields = [_element_of(element) for element in _cells(elements[-1], "the elements of a bus")]
        array = v.MatlabStruct(v.object_array(fields, (len(fields), 1)), tuple(_ELEMENT), BUS_ELEMENT)
        buses[v.text(parts[0])] = v.MatlabStruct.of({"Elements": array}, BUS)
    return buses


def _cells(value: v.Value, meaning: str) -> list[v.Value]:
    if not isinstance(value, v.MatlabCell):
        raise v.MatlabValueError(f"{meaning} must be a cell array, got a {v.class_name(value)}")
    return value.contents


def _element_of(element: v.Value) -> dict[str, v.Value]:
    """Return the properties of an element {name, dimensions, type, sample time, complexity, ...}."""
    parts = _cells(element, "a bus element")
    if len(parts) < 3:
        raise v.MatlabValueError(f"a bus element requires a name, dimensions and a type, got {len(parts)} parts")
    known = {"Name": parts[0], "Dimensions": parts[1], "DataType": parts[2]}
    # only the long form has limits, unit and description, at the end
    if len(parts) >= 11:
        known |= dict(zip(("Min", "Max", "Unit", "Description"), parts[7:11], strict=True))
    return {**_ELEMENT, **known}


def fixed_point_object(arguments: Sequence[v.Value]) -> v.MatlabStruct:
    """Return the object of `fixdt(...)`: of a type name, or of sign, bits and scaling.

    Raises:
        MatlabValueError: The arguments are incomplete or not numbers.
    """
    if arguments and v.is_text(arguments[0]):
        return v.MatlabStruct.of({"BaseType": arguments[0]}, ALIAS_TYPE)
    # name-value pairs may follow the numbers
    count = next((at for at, value in enumerate(arguments) if v.is_text(value)), len(arguments))
    numbers = [v.numbers(value).ravel() for value in arguments[:count]]
    if not 2 <= count <= 5 or any(part.size != 1 for part in numbers[1:]):
        raise v.MatlabValueError("a sign, the number of bits and the scaling are required")
    signed, (bits, *scaling) = numbers[0], [float(part[0]) for part in numbers[1:]]
    if not (bits.is_integer() and 1 <= bits <= MOST_BITS):
        raise v.MatlabValueError(f"the number of bits must be an integer from 1 to {MOST_BITS}, got {bits:g}")
    # [] leaves the sign to the signal
    sign = "Auto" if not signed.size else "Signed" if signed[0] else "Unsigned"
    fields: dict[str, v.Value] = {"Signedness": v.characters(sign), "WordLength": v.scalar(bits)}
    match scaling:
        case []:
            mode = "unspecified scaling"
        case [fraction]:
            mode, fields["FractionLength"] = "binary point scaling", v.scalar(fraction)
        case [*slope, bias]:
            # slope, or its adjustment factor and exponent: slope = factor 2^exponent
            total = slope[0] if len(slope) == 1 else slope[0] * float(np.exp2(slope[1]))
            mode = "slope and bias scaling"
            fields |= {"Slope": v.scalar(total), "Bias": v.scalar(bias)}
    return v.MatlabStruct.of({**type_properties(NUMERIC_TYPE), "DataTypeMode": v.characters(_MODE + mode), **fields},
                             NUMERIC_TYPE)  # fmt: skip


def struct_of_bus(name: str, variables: Mapping[str, v.Value], known: v.Value | None, depth: int = 0) -> v.MatlabStruct:
    """Return the struct of zeros that `Simulink.Bus.createMATLABStruct(name, known)` creates.

    Args:
        name: name of a bus.
        variables: the buses by name.
        known: a struct of values that differ from 0, or None.
        depth: number of buses around it.

    Raises:
        MatlabValueError: The bus, or one within it, is not defined or contains itself.
    """
    name = name.removeprefix("Bus:").strip()
    bus = variables.get(name)
    if not isinstance(bus, v.MatlabStruct) or bus.kind != BUS:
        raise v.MatlabValueError(f"the bus {name[:60]} is not defined")
    if depth > _MAX_DEPTH:
        raise v.MatlabValueError(f"the bus {name[:60]} contains itself")
    values = known.fields if isinstance(known, v.MatlabStruct) else {}
    elements = bus.fields.get("Elements")
    fields: dict[str, v.Value] = {}
    for element in elements.elements.ravel(order="F") if isinstance(elements, v.MatlabStruct) else ():
        key, kind = v.text(element["Name"]), v.text(element["DataType"])
        inner = variables.get(kind.removeprefix("Bus:").strip())
        if isinstance(inner, v.MatlabStruct) and inner.kind == BUS:
            fields[key] = struct_of_bus(kind, variables, values.get(key), depth + 1)
        else:
            fields[key] = values.get(key, _zeros(element["Dimensions"]))
    return v.MatlabStruct.of(fields)


def _zeros(dimensions: v.Value) -> v.Array:
    shape = [max(int(size), 1) for size in v.numbers(dimensions).ravel()] or [1]
    # one dimension is a column in a struct
    shape = [*shape, 1] if len(shape) == 1 else shape
    if np.prod(shape, dtype=float) > _MAX_ZEROS:
        raise v.MatlabValueError(f"an element of {np.prod(shape, dtype=float):g} numbers is too large")
    return np.zeros(shape)
