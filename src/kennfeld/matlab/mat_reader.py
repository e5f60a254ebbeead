"""Reading of MATLAB data files of versions 4 to 7.3 and of model workspaces."""

import math
from collections.abc import Mapping

import numpy as np

from kennfeld.base.errors import InputError, Location
from kennfeld.matlab import mat_nodes, mat_v4, mat_v5, mat_v73
from kennfeld.matlab import values as v
from kennfeld.matlab.mcos import resolve_objects
from kennfeld.matlab.operators import cast_to_class

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_ORDERS = (b"IM", b"MI")  # the end of the header of version 5
_MAX_DEPTH = 40
_MAX_BYTES = 1_000_000_000  # of the arrays that a script loads


def load_variables(content: bytes, name: str) -> dict[str, v.Value]:
    """Read the variables of a data file, including parameter objects.

    Args:
        content: The bytes of the file.
        name: The file name in error messages.

    Returns:
        The variables by name.

    Raises:
        InputError: The file is damaged.

    Example:
        >>> load_variables(b"MATLAB 5.0 MAT-file".ljust(128), "none.mat")
        {}
    """
    try:
        nodes = read_nodes(content, _MAX_BYTES)
    except mat_nodes.MatFileError as error:
        raise InputError.of(Location(name), f"the MATLAB file is damaged: {error}", "Save it again.") from None
    return {key: to_value(node) for key, node in nodes.items()}


def read_nodes(content: bytes, max_bytes: int = mat_nodes.MAX_BYTES) -> Mapping[str, mat_nodes.Node]:
    """Read the variables of a data file as nodes, including the properties of objects.

    Args:
        content: The bytes of the file.
        max_bytes: Limit of the uncompressed size, in bytes.

    Returns:
        The variables by name.

    Raises:
        MatFileError: The file is damaged or exceeds `max_bytes`.
    """
    return load_nodes(content, max_bytes).whole().variables


def load_nodes(
    content: bytes, max_bytes: int = mat_nodes.MAX_BYTES, max_nodes: int = mat_nodes.MAX_NODES
) -> mat_nodes.MatFileContent:
    """Read the variables of a data file as nodes, as far as it is not damaged.

    Args:
        content: The bytes of the file.
        max_bytes: Limit of the uncompressed size, in bytes.
        max_nodes: Limit of the number of arrays.

    Returns:
        The variables, damaged ones included; reading ends at the limits.
    """
    if not content:
        return mat_nodes.MatFileContent(damage="it is empty", lost="it is empty")
    # version 7.3: MATLAB writes a header like that of version 5 into the user block before the HDF5 part
    if content.startswith(_HDF5) or content[_USER_BLOCK : _USER_BLOCK + len(_HDF5)] == _HDF5:
        return resolve_objects(mat_v73.load_guarded(content, max_bytes, max_nodes), max_bytes)
    # version 4 has neither text nor byte order at the beginning of the file
    if not content.startswith(b"MATLAB") and content[126:128] not in _ORDERS:
        return mat_v4.load_all(memoryview(content))
    return resolve_objects(mat_v5.load_all(memoryview(content), max_bytes, max_nodes), max_bytes)


def to_value(node: mat_nodes.Node, depth: int = 0) -> v.Value:
    """Convert a node to a value; an unreadable one becomes opaque."""
    if depth > _MAX_DEPTH:
        return v.OpaqueValue("value nested too deeply")
    match node:
        case mat_nodes.MatNumbers():
            return _array(node)
        case mat_nodes.MatText():
            return _characters(node)
        case mat_nodes.MatStruct():
            return v.MatlabStruct.of(
                {name: to_value(inner, depth + 1) for name, inner in node.fields.items()}, node.kind
            )
        case mat_nodes.MatStructArray():
            return _structs(node, depth)
        case mat_nodes.MatCells():
            values = [to_value(cell, depth + 1) for cell in node.cells]
            return v.MatlabCell(v.object_array(values, _shape(node.shape, len(values))))
        case _:
            return v.OpaqueValue(node.kind)


def _array(node: mat_nodes.MatNumbers) -> v.Array:
    """Return numbers in their class, which may be larger than the stored type."""
    # arrays have at least two dimensions in MATLAB, and a vector is a column unless stated otherwise
    values = node.values if node.values.ndim > 1 else node.values.reshape(-1, 1)
    if node.kind == "logical" or values.dtype == np.bool_:
        return np.asarray(values != 0)
    if node.kind in v.INTEGERS:
        return values.astype(node.kind)
    with np.errstate(invalid="ignore"):  # signaling NaN of single precision
        return cast_to_class(values.astype(np.float64), "single" if node.kind == "single" else "double")


def _characters(node: mat_nodes.MatText) -> v.Array:
    if not node.rows:
        return v.characters(node.text)
    widest = max(map(len, node.rows))
    return np.array([list(line.ljust(widest)) for line in node.rows], dtype="U1").reshape(len(node.rows), widest)


def _structs(node: mat_nodes.MatStructArray, depth: int) -> v.Value:
    names = tuple(node.elements[0].fields) if node.elements else ()
    kind = node.elements[0].kind if node.elements else ""
    # all elements of a struct array have the same fields; damage may have cost some of them
    missing = dict.fromkeys(names, v.OpaqueValue("nothing"))
    complete = [
        {**missing, **{name: to_value(part, depth + 1) for name, part in element.fields.items() if name in missing}}
        for element in node.elements
    ]
    return v.MatlabStruct(v.object_array(complete, _shape(node.shape, len(complete))), names, kind)


def _shape(shape: tuple[int, ...], count: int) -> tuple[int, ...]:
    return shape if len(shape) > 1 and math.prod(shape) == count else (1, count)
