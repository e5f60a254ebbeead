"""The variables of data files, of versions 4 to 7.3, and of model workspaces as values of the language."""

import math
from collections.abc import Mapping
from io import BytesIO

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import mat_nodes, mat_v4, mat_v5, mat_v73
from kennfeld.matlab.mcos import opened, workspace
from kennfeld.matlab.operators import cast_to_class
from kennfeld.matlab.values import (
    INTEGERS,
    Array,
    MatlabCell,
    MatlabStruct,
    OpaqueValue,
    Value,
    characters,
    object_array,
)

__all__ = ["load_nodes", "load_variables", "nodes_of", "value_of", "workspace_of"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_ORDERS = (b"IM", b"MI")  # how the header of version 5 ends
_DEEPEST = 40
_MOST_BYTES = 1_000_000_000  # of the arrays that a script loads


def load_variables(content: bytes, name: str) -> dict[str, Value]:
    """The variables of a data file, parameter objects included; `InputError` where it is damaged.

    >>> load_variables(b"MATLAB 5.0 MAT-file".ljust(128), "none.mat")
    {}
    """
    try:
        nodes = nodes_of(content, _MOST_BYTES)
    except mat_nodes.MatFileError as error:
        raise InputError.of(name, f"the MATLAB file is damaged: {error}", "Save it anew.") from None
    return {key: value_of(node) for key, node in nodes.items()}


def workspace_of(content: bytes, name: str) -> dict[str, Value]:
    """The variables of a model workspace (`modelWorkspace.mxarray`); `InputError` where it is damaged."""
    try:
        nodes = workspace(content).whole().variables
    except mat_nodes.MatFileError as error:
        raise InputError.of(name, f"the model workspace is damaged: {error}", "Save the model anew.") from None
    return {key: value_of(node) for key, node in nodes.items()}


def nodes_of(content: bytes, most_bytes: int = mat_nodes.MOST_BYTES) -> Mapping[str, mat_nodes.Node]:
    """The variables of a data file as a tree, with the properties of objects.

    `DamageError` where it is damaged, or takes more than `most_bytes` when it is unpacked.
    """
    return load_nodes(content, most_bytes).whole().variables


def load_nodes(
    content: bytes, most_bytes: int = mat_nodes.MOST_BYTES, most_nodes: int = mat_nodes.MOST_NODES
) -> mat_nodes.MatFileContent:
    """The variables of a data file as a tree, with the properties of objects, the damaged ones among them.

    It ends where they take more than `most_bytes` when they are unpacked, or are more than `most_nodes` arrays.
    """
    if not content:
        return mat_nodes.MatFileContent(damage="it is empty", lost="it is empty")
    if content.startswith(_HDF5) or content[_USER_BLOCK : _USER_BLOCK + len(_HDF5)] == _HDF5:
        return opened(mat_v73.load_all(BytesIO(content), most_bytes, most_nodes), most_bytes)
    if not content.startswith(b"MATLAB") and content[126:128] not in _ORDERS:
        return mat_v4.load_all(memoryview(content))
    return opened(mat_v5.load_all(memoryview(content), most_bytes, most_nodes), most_bytes)


def value_of(node: mat_nodes.Node, depth: int = 0) -> Value:
    """A node as a value; what cannot be read stays opaque."""
    if depth > _DEEPEST:
        return OpaqueValue("value too deep within others")
    match node:
        case mat_nodes.MatNumbers():
            return _array(node)
        case mat_nodes.MatText():
            return _characters(node)
        case mat_nodes.MatStruct():
            return MatlabStruct.of({name: value_of(inner, depth + 1) for name, inner in node.fields.items()}, node.kind)
        case mat_nodes.MatStructArray():
            return _structs(node, depth)
        case mat_nodes.MatCells():
            values = [value_of(cell, depth + 1) for cell in node.cells]
            return MatlabCell(object_array(values, _shape(node.shape, len(values))))
        case _:
            return OpaqueValue(node.kind)


def _array(node: mat_nodes.MatNumbers) -> Array:
    """Numbers in their class, which may be larger than the type in which they are stored."""
    values = node.values if node.values.ndim > 1 else node.values.reshape(-1, 1)
    if node.kind == "logical" or values.dtype == np.bool_:
        return np.asarray(values != 0)
    if node.kind in INTEGERS:
        return values.astype(node.kind)
    with np.errstate(invalid="ignore"):  # some not-a-numbers of single precision warn
        return cast_to_class(values.astype(np.float64), "single" if node.kind == "single" else "double")


def _characters(node: mat_nodes.MatText) -> Array:
    if not node.rows:
        return characters(node.text)
    widest = max(map(len, node.rows))
    return np.array([list(line.ljust(widest)) for line in node.rows], dtype="U1").reshape(len(node.rows), widest)


def _structs(node: mat_nodes.MatStructArray, depth: int) -> Value:
    names = tuple(node.elements[0].fields) if node.elements else ()
    kind = node.elements[0].kind if node.elements else ""
    same = [
        {name: value_of(one.fields[name], depth + 1) for name in names if name in one.fields} for one in node.elements
    ]
    whole = [{**dict.fromkeys(names, OpaqueValue("nothing")), **one} for one in same]
    return MatlabStruct(object_array(whole, _shape(node.shape, len(whole))), names, kind)


def _shape(shape: tuple[int, ...], count: int) -> tuple[int, ...]:
    return shape if len(shape) > 1 and math.prod(shape) == count else (1, count)
