"""The values of MATLAB: numeric, logical and character arrays, strings, cells, structs and function handles.

Every array has at least two dimensions. Character arrays have the type `U1`, string arrays the type `object`. Values
are never changed in place; an assignment to a part makes a new one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.program.tree import Expression

Array: TypeAlias = NDArray[Any]
INTEGERS = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))

EMPTY = np.zeros((0, 0))


class MatlabValueError(Exception):
    """An operation has no value. The text says why; the caller knows where."""


class Elements(np.ndarray[tuple[int, ...], np.dtype[Any]]):
    """An array of elements that are not numbers yet; a subclass defines what numpy's operations on them build."""

    matlab_class = "double"

    def first_extremes(self, name: str, axis: int) -> tuple[Array, Array]:
        """Return the extremes along a dimension, of the function called `name`, and their first positions, from 1."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class MatlabCell:
    """A cell array: an object array of values."""

    values: Array

    @classmethod
    def of(cls, contents: Iterable[Any], shape: tuple[int, ...]) -> "MatlabCell":
        """Return a cell array of these values, in column-major order."""
        return cls(object_array(list(contents), shape))

    @property
    def contents(self) -> list[Any]:
        """The values in column-major order."""
        return list(self.values.ravel(order="F"))


@dataclass(frozen=True, eq=False)
class MatlabStruct:
    """An array of structs, or of objects of the class `kind`; the elements are dictionaries with equal keys."""

    elements: Array
    names: tuple[str, ...] = ()
    kind: str = ""

    @classmethod
    def of(cls, fields: Mapping[str, Any], kind: str = "") -> "MatlabStruct":
        """Return a struct of one element."""
        return cls(object_array([dict(fields)], (1, 1)), tuple(fields), kind)

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of the first element."""
        return self.elements.flat[0] if self.elements.size else {}


@dataclass(frozen=True, eq=False)
class MatlabFunctionHandle:
    """A handle of a named function, or an anonymous function with the variables it captured."""

    name: str = ""
    parameters: tuple[str, ...] = ()
    body: Expression | None = None
    variables: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class OpaqueValue:
    """A value that only MATLAB can read; `kind` describes it."""

    kind: str


Value: TypeAlias = Array | MatlabCell | MatlabStruct | MatlabFunctionHandle | OpaqueValue


class StructArray(tuple[Mapping[str, Any], ...]):
    """An array of structs as a Python value, by columns; a plain tuple is a cell array."""

    shape: tuple[int, ...] = ()

    @classmethod
    def of(cls, elements: Iterable[Mapping[str, Any]], shape: tuple[int, ...]) -> "StructArray":
        """Return an array of structs of this shape."""
        result = cls(elements)
        result.shape = shape
        return result

    @property
    def names(self) -> tuple[str, ...]:
        """The fields that all elements have."""
        return tuple(name for name in (self[0] if self else ()) if all(name in element for element in self))


def object_array(values: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return any values as an object array, in column-major order."""
    array = np.empty(len(values), dtype=object)
    for at, value in enumerate(values):
        array[at] = value
    return array.reshape(shape, order="F")


def scalar(value: float) -> Array:
    """Return a number as an array, Float[1, 1]."""
    return np.array([[value]], dtype=np.float64)


def logical(value: object) -> Array:
    """Return a truth value as an array, Bool[1, 1]."""
    return np.array([[bool(value)]])


def row(values: Any) -> Array:
    """Return numbers as a row vector, Float[1, n]."""
    return np.asarray(values, dtype=np.float64).reshape(1, -1)


def characters(value: str) -> Array:
    """Return text as a row of characters, 1 x n; empty text is 0 x 0."""
    return np.array(list(value), dtype="U1").reshape(1 if value else 0, len(value))


def strings(values: Sequence[str]) -> Array:
    """Return a row of strings, 1 x n."""
    return object_array(values, (1, len(values)))


def class_name(value: Value) -> str:
    """Return the MATLAB class of a value.

    >>> class_name(scalar(1.0)), class_name(characters("a"))
    ('double', 'char')
    """
    if isinstance(value, Elements):
        return value.matlab_class
    if isinstance(value, np.ndarray):
        kinds = {"float64": "double", "float32": "single", "bool": "logical", "object": "string"}
        return "char" if value.dtype.kind == "U" else kinds.get(value.dtype.name, value.dtype.name)
    if isinstance(value, MatlabStruct):
        return value.kind or "struct"
    if isinstance(value, MatlabCell):
        return "cell"
    return "function_handle" if isinstance(value, MatlabFunctionHandle) else value.kind


def with_class_of(value: Value, data: Array) -> Value:
    """Return elements as a value of the same kind as `value`: cell array, struct array or plain array."""
    data = trim_dimensions(data)
    if isinstance(value, MatlabCell):
        return MatlabCell(data)
    return MatlabStruct(data, value.names, value.kind) if isinstance(value, MatlabStruct) else data


def elements_of(value: Value) -> Array:
    """Return the elements of any value, as an array of its size."""
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, MatlabCell):
        return value.values
    return value.elements if isinstance(value, MatlabStruct) else object_array([value], (1, 1))


def trim_dimensions(array: Array) -> Array:
    """Remove trailing dimensions of length 1 behind the second."""
    while array.ndim > 2 and array.shape[-1] == 1:
        array = array[..., 0]
    return array


def is_vector(array: Array) -> bool:
    """Return True if an array is one row or one column; it may be empty."""
    return array.ndim == 2 and 1 in array.shape


def array_value(value: Value) -> Array:
    """Return a value as an array; a parameter object counts as its Value."""
    if isinstance(value, MatlabStruct) and value.kind and "Value" in value.names and value.elements.size == 1:
        value = value.fields["Value"]
    if isinstance(value, np.ndarray):
        return value
    raise MatlabValueError(f"a {class_name(value)} is not a number")


def numbers(value: Value) -> Float:
    """Return an array in double precision; characters become their codes."""
    array = array_value(value)
    if array.dtype.kind == "U":
        return np.array([ord(letter) if letter else 0 for letter in array.ravel(order="F")], dtype=np.float64).reshape(
            array.shape, order="F"
        )
    if array.dtype.kind == "O":
        raise MatlabValueError("a string is not a number")
    return array.astype(np.float64, copy=False)


def number(value: Value) -> float:
    """Return the number of a scalar."""
    array = numbers(value)
    if array.size != 1:
        raise MatlabValueError(f"must be one number, got an array of {size_text(array.shape)}")
    return float(array.flat[0])


def integer(value: Value) -> int:
    """Return the integer of a scalar."""
    result = number(value)
    if not np.isfinite(result) or result != int(result) or abs(result) > 2**53:
        raise MatlabValueError(f"must be an integer, got {result:g}")
    return int(result)


def is_text(value: Value | None) -> bool:
    """Return True if a value is a character array or a string array."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "UO"


def text(value: Value) -> str:
    """Return the text of a row of characters or of a single string."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "U" and (value.shape[0] == 1 or not value.size):
        return "".join(letter or "\0" for letter in value.ravel(order="F").tolist())
    if isinstance(value, np.ndarray) and value.dtype.kind == "O" and value.size == 1:
        return str(value.flat[0])
    raise MatlabValueError(f"must be text, got a {class_name(value)}")


def measure_nesting(value: Value) -> tuple[int, int]:
    """Return the number of values in a value, shared ones counted each time, and the nesting depth."""
    if not isinstance(value, MatlabCell | MatlabStruct):
        return 1, 1
    nesting: tuple[int, int] | None = value.__dict__.get("_burden")
    if nesting is None:
        inner = [measure_nesting(part) for part in _nested_values(value)]
        nesting = 1 + sum(count for count, _ in inner), 1 + max((depth for _, depth in inner), default=0)
        object.__setattr__(value, "_burden", nesting)
    return nesting


def _nested_values(value: "MatlabCell | MatlabStruct") -> list[Value]:
    if isinstance(value, MatlabCell):
        return list(value.values.ravel())
    return [inner for element in value.elements.ravel() for inner in element.values()]


def from_python(value: Any) -> Value:
    """Convert a Python value: numbers, texts, arrays, lists to cells, mappings to structs.

    One-dimensional arrays become rows.

    Raises:
        TypeError: The value has no counterpart in MATLAB.
    """
    if isinstance(value, MatlabCell | MatlabStruct | MatlabFunctionHandle | OpaqueValue):
        return value
    if isinstance(value, str):
        return characters(value)
    if isinstance(value, Mapping):
        return MatlabStruct.of({str(name): from_python(inner) for name, inner in value.items()})
    if isinstance(value, StructArray):
        structs = [{name: from_python(element[name]) for name in value.names} for element in value]
        return MatlabStruct(object_array(structs, value.shape), value.names)
    if isinstance(value, list | tuple):
        return MatlabCell(object_array([from_python(inner) for inner in value], (1, len(value))))
    array = np.asarray(value)
    if array.dtype.kind not in "fbiuUO" or (array.dtype.kind == "O" and not isinstance(value, np.ndarray)):
        raise TypeError(f"{type(value).__name__} has no counterpart in MATLAB")
    if array.dtype.name not in (*INTEGERS, "float64", "float32", "bool") and array.dtype.kind in "fiu":
        array = array.astype(np.float64)
    if not isinstance(value, np.ndarray | np.generic) and array.dtype.kind in "iu":
        array = array.astype(np.float64)
    return array.reshape(1, -1) if array.ndim < 2 else array
