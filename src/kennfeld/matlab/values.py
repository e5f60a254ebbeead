"""The values of MATLAB: arrays of numbers, truth values and characters, strings, cells, structs and functions.

Every array has at least two dimensions. An array of characters has the type `U1`, one of strings the type `object`.
A value is never changed once it is made; an assignment to a part makes a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Float
from kennfeld.matlab.syntax import Expression

__all__ = [
    "EMPTY",
    "INTEGERS",
    "Array",
    "MatlabCell",
    "MatlabFunctionHandle",
    "MatlabStruct",
    "MatlabValueError",
    "OpaqueValue",
    "Value",
    "array_value",
    "characters",
    "class_name",
    "elements_of",
    "from_python",
    "logical",
    "nested_size",
    "number",
    "numbers",
    "object_array",
    "row",
    "scalar",
    "strings",
    "text",
    "trimmed",
    "whole",
    "with_class_of",
]

Array: TypeAlias = NDArray[Any]
INTEGERS = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))

EMPTY = np.zeros((0, 0))


class MatlabValueError(Exception):
    """An operation has no value; the text says why, who catches it knows where."""


@dataclass(frozen=True, eq=False)
class MatlabCell:
    """A cell array: an object array of values."""

    values: Array


@dataclass(frozen=True, eq=False)
class MatlabStruct:
    """An array of structs, or of objects of the class `kind`; each element is a dictionary with the same keys."""

    elements: Array
    names: tuple[str, ...] = ()
    kind: str = ""

    @classmethod
    def of(cls, fields: Mapping[str, "Value"], kind: str = "") -> "MatlabStruct":
        """A struct of one element."""
        return cls(object_array([dict(fields)], (1, 1)), tuple(fields), kind)

    @property
    def fields(self) -> dict[str, "Value"]:
        """The fields of the first element."""
        return self.elements.flat[0] if self.elements.size else {}


@dataclass(frozen=True, eq=False)
class MatlabFunctionHandle:
    """A function by its name, or an anonymous one with the variables around it."""

    name: str = ""
    parameters: tuple[str, ...] = ()
    body: Expression | None = None
    variables: Mapping[str, "Value"] = field(default_factory=dict)


@dataclass(frozen=True)
class OpaqueValue:
    """What only MATLAB can make something of, by the word for it."""

    kind: str


Value: TypeAlias = Array | MatlabCell | MatlabStruct | MatlabFunctionHandle | OpaqueValue


def object_array(values: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Any values as an array, in column-major order."""
    made = np.empty(len(values), dtype=object)
    for at, value in enumerate(values):
        made[at] = value
    return made.reshape(shape, order="F")


def scalar(value: float) -> Array:
    """A number."""
    return np.array([[value]], dtype=np.float64)


def logical(value: object) -> Array:
    """A truth value."""
    return np.array([[bool(value)]])


def row(values: Any) -> Array:
    """Numbers side by side."""
    return np.asarray(values, dtype=np.float64).reshape(1, -1)


def characters(value: str) -> Array:
    """A text as a row of characters; the empty one has neither rows nor columns."""
    return np.array(list(value), dtype="U1").reshape(1 if value else 0, len(value))


def strings(values: Sequence[str]) -> Array:
    """Strings side by side."""
    return object_array(values, (1, len(values)))


def class_name(value: Value) -> str:
    """The class as MATLAB calls it.

    >>> class_name(scalar(1.0)), class_name(characters("a"))
    ('double', 'char')
    """
    if isinstance(value, np.ndarray):
        kinds = {"float64": "double", "float32": "single", "bool": "logical", "object": "string"}
        return "char" if value.dtype.kind == "U" else kinds.get(value.dtype.name, value.dtype.name)
    if isinstance(value, MatlabStruct):
        return value.kind or "struct"
    if isinstance(value, MatlabCell):
        return "cell"
    return "function_handle" if isinstance(value, MatlabFunctionHandle) else value.kind


def with_class_of(value: Value, data: Array) -> Value:
    """Other elements in the kind of array that a value is."""
    data = trimmed(data)
    if isinstance(value, MatlabCell):
        return MatlabCell(data)
    return MatlabStruct(data, value.names, value.kind) if isinstance(value, MatlabStruct) else data


def elements_of(value: Value) -> Array:
    """The elements of any value, as an array that has its size."""
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, MatlabCell):
        return value.values
    return value.elements if isinstance(value, MatlabStruct) else object_array([value], (1, 1))


def trimmed(array: Array) -> Array:
    """An array without the dimensions of one element behind its second."""
    while array.ndim > 2 and array.shape[-1] == 1:
        array = array[..., 0]
    return array


def array_value(value: Value) -> Array:
    """An array; of a parameter object its value."""
    if isinstance(value, MatlabStruct) and value.kind and "Value" in value.names and value.elements.size == 1:
        value = value.fields["Value"]
    if isinstance(value, np.ndarray):
        return value
    raise MatlabValueError(f"a {class_name(value)} is no number")


def numbers(value: Value) -> Float:
    """Numbers in double precision; of characters their codes."""
    array = array_value(value)
    if array.dtype.kind == "U":
        return np.array([ord(one) if one else 0 for one in array.ravel(order="F")], dtype=np.float64).reshape(
            array.shape, order="F"
        )
    if array.dtype.kind == "O":
        raise MatlabValueError("a string is no number")
    return array.astype(np.float64, copy=False)


def number(value: Value) -> float:
    """The one number of a scalar."""
    array = numbers(value)
    if array.size != 1:
        raise MatlabValueError(f"one number is needed, not {_size(array)}")
    return float(array.flat[0])


def whole(value: Value) -> int:
    """The one whole number of a scalar."""
    found = number(value)
    if not np.isfinite(found) or found != int(found) or abs(found) > 2**53:
        raise MatlabValueError(f"a whole number is needed, not {found:g}")
    return int(found)


def text(value: Value) -> str:
    """The one text of a row of characters, or of a string."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "U" and (value.shape[0] == 1 or not value.size):
        return "".join(one or "\0" for one in value.ravel(order="F").tolist())
    if isinstance(value, np.ndarray) and value.dtype.kind == "O" and value.size == 1:
        return str(value.flat[0])
    raise MatlabValueError(f"a text is needed, not a {class_name(value)}")


def _size(array: Array) -> str:
    return " x ".join(map(str, array.shape))


def nested_size(value: Value) -> tuple[int, int]:
    """How many values stand within a value, shared ones each time, and how deep; known for parts seen before."""
    if not isinstance(value, MatlabCell | MatlabStruct):
        return 1, 1
    known: tuple[int, int] | None = value.__dict__.get("_burden")
    if known is None:
        inner = [nested_size(one) for one in _within(value)]
        known = 1 + sum(count for count, _ in inner), 1 + max((depth for _, depth in inner), default=0)
        object.__setattr__(value, "_burden", known)
    return known


def _within(value: "MatlabCell | MatlabStruct") -> list[Value]:
    if isinstance(value, MatlabCell):
        return list(value.values.ravel())
    return [inner for element in value.elements.ravel() for inner in element.values()]


def from_python(given: Any) -> Value:
    """A value of Python as one of MATLAB: numbers, texts, arrays, lists as cells, mappings as structs.

    One-dimensional arrays become rows; `TypeError` for what has no counterpart.
    """
    if isinstance(given, MatlabCell | MatlabStruct | MatlabFunctionHandle | OpaqueValue):
        return given
    if isinstance(given, str):
        return characters(given)
    if isinstance(given, Mapping):
        return MatlabStruct.of({str(name): from_python(inner) for name, inner in given.items()})
    if isinstance(given, list | tuple):
        return MatlabCell(object_array([from_python(inner) for inner in given], (1, len(given))))
    array = np.asarray(given)
    if array.dtype.kind not in "fbiuUO" or (array.dtype.kind == "O" and not isinstance(given, np.ndarray)):
        raise TypeError(f"{type(given).__name__} has no counterpart in MATLAB")
    if array.dtype.name not in (*INTEGERS, "float64", "float32", "bool") and array.dtype.kind in "fiu":
        array = array.astype(np.float64)
    if not isinstance(given, np.ndarray | np.generic) and array.dtype.kind in "iu":
        array = array.astype(np.float64)
    return array.reshape(1, -1) if array.ndim < 2 else array
