"""Reader of MATLAB files of version 4.

Layout: MathWorks, "MAT-File Format": for each array type, rows, columns, imaginary part, length of the name, name, and
numbers in column-major order. The digits of the type, MOPT, are byte order, 0, number type, and full, text or sparse.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.matlab import mat_nodes as n

_STORED = ("f8", "f4", "i4", "i2", "u2", "u1")
_FULL, _TEXT, _SPARSE, _COMPLEX = 0, 1, 2, 10


def load(content: memoryview) -> dict[str, n.Node]:
    """Read the variables; raises `MatFileError` if the content is not a valid file."""
    return load_all(content).whole().variables


def load_all(content: memoryview) -> n.MatFileContent:
    """Read the variables, damaged ones included."""
    result, at, remaining = n.MatFileContent(), 0, n.MAX_DENSE
    try:
        # zeros may follow the last array
        while any(content[at : at + 20]):
            name, values, form, at = _array(content, at)
            with np.errstate(invalid="ignore"):  # signaling NaN of single precision
                node, remaining = _node(values, form, remaining)
            result.variables[name] = node
            result.damage = result.damage or (node.why if isinstance(node, n.MatUnreadable) else "")
    except n.MatFileError as error:
        result.lose(str(error))
    return result


def _array(content: memoryview, at: int) -> tuple[str, NDArray[Any], int, int]:
    """Return name, numbers, form and end of the array at an offset."""
    if at + 20 > len(content):
        raise n.MatFileError(f"the last {len(content) - at} bytes belong to no array")
    # MOPT is a number of four digits: the thousands, M, are 0 in a little-endian file, so that the number is below 1000
    order = "<" if struct.unpack_from("<i", content, at)[0] in range(1000) else ">"
    kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", content, at)
    # other values of M are the byte orders of the VAX and the Cray; O, the hundreds, is always 0
    if kind // 1000 != (order == ">") or kind % 1000 // 10 >= len(_STORED) or min(rows, columns, length) < 0:
        raise n.MatFileError(f"no array found at byte {at}")
    stored = np.dtype(order + _STORED[kind % 1000 // 10])
    begin, size = at + 20 + length, rows * columns * stored.itemsize
    end = begin + size * (2 if imaginary else 1)
    if end > len(content):
        raise n.MatFileError(f"the array at byte {at} claims {rows} x {columns} values")
    name = bytes(content[begin - length : begin]).partition(b"\0")[0].decode("latin-1")
    values = np.frombuffer(content[begin : begin + size], stored).reshape((rows, columns), order="F")
    return name, values, _COMPLEX if imaginary else kind % 10, end


def _node(values: NDArray[Any], form: int, remaining: int) -> tuple[n.Node, int]:
    """Return the node of an array, and the remaining number of values for sparse matrices."""
    if form == _TEXT:
        # text is stored as numbers of any type, mostly doubles; damage may make any of them
        codes = np.nan_to_num(values.astype(np.float64)).clip(0, 0x10FFFF).astype(int)
        return n.split_text_rows("".join(map(chr, codes.ravel(order="F").tolist())), len(codes)), remaining
    if form == _FULL:
        return n.MatNumbers(values), remaining
    # the fourth column of a sparse matrix has the imaginary parts
    if form != _SPARSE or values.shape[1] == 4:
        return n.MatUnreadable("complex numbers"), remaining
    try:
        node = _sparse(values.astype(np.float64), remaining)
    except n.MatFileError as error:
        return n.MatUnreadable("damaged value", why=str(error)), remaining
    return node, remaining - (node.values.size if isinstance(node, n.MatNumbers) else 0)


def _sparse(triples: NDArray[np.float64], remaining: int) -> n.Node:
    """Convert a sparse matrix: one line of row, column and value each; the last line holds its size."""
    # indices are doubles from 1 on
    known = triples.size and triples.shape[1] == 3 and np.all(np.isfinite(triples[:, :2]))
    known = known and np.all(np.floor(triples[:, :2]) == triples[:, :2])
    places, shape = (triples[:-1, :2], triples[-1, :2]) if known else (triples, np.full(2, -1))
    if min(shape) < 0 or not np.all((places >= 1) & (places <= shape)):
        raise n.MatFileError("the rows of a sparse matrix are inconsistent")
    if not shape[0] * shape[1] <= remaining:
        return n.MatUnreadable("sparse matrix")
    full = np.zeros(shape.astype(np.int64))
    full[tuple(places.T.astype(np.int64) - 1)] = triples[:-1, 2]
    return n.MatNumbers(full)
