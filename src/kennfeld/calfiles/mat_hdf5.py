"""MATLAB data of version 7.3, which is HDF5: groups are structs, references are cells, arrays lie turned."""

from dataclasses import dataclass
from io import BytesIO
from math import prod
from typing import Any

import numpy as np

from kennfeld.calfiles.matlab_values import Opaque, Struct, Value

__all__ = ["hdf5_variables"]

_MOST_VALUES = 20_000_000
_MOST_DEPTH = 20
_MOST_MEMBERS = 200_000
_NUMBERS = "biuf"


def hdf5_variables(raw: bytes) -> dict[str, Value]:
    """The variables of a file; raises `ValueError` where it is damaged or larger than a calibration."""
    import h5py

    try:
        with h5py.File(BytesIO(raw), "r") as file:
            reader = _Reader(file)
            return {str(name): reader.value(file[name], 0) for name in file if not str(name).startswith("#")}
    except (OSError, KeyError, RuntimeError, TypeError, AttributeError, OverflowError, MemoryError) as error:
        raise ValueError(str(error)) from None


@dataclass
class _Reader:
    file: Any
    left: int = _MOST_VALUES
    members: int = _MOST_MEMBERS

    def value(self, node: Any, depth: int) -> Value:
        """What a group or a dataset holds."""
        self.members -= 1
        if depth > _MOST_DEPTH or self.members < 0:
            raise ValueError("it nests its variables too deeply, or has too many of them")
        attributes = dict(node.attrs)
        kind = attributes.get("MATLAB_class", b"")
        name = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
        if "MATLAB_object_decode" in attributes or "MATLAB_sparse" in attributes:
            return Opaque("sparse matrix" if "MATLAB_sparse" in attributes else name)
        if not hasattr(node, "dtype"):
            return self._struct(node, depth)
        if attributes.get("MATLAB_empty"):
            return "" if name == "char" else Struct() if name == "struct" else np.zeros((0, 0))
        return self._dataset(node, name, depth)

    def _struct(self, group: Any, depth: int) -> Value:
        """A struct, or the list of structs whose fields are lists of references."""
        found = {str(name): self.value(group[name], depth + 1) for name in group}
        listed = [name for name in group if hasattr(group[name], "dtype") and _is_list(group[name])]
        lengths = {len(value) for value in found.values() if isinstance(value, list)}
        if not found or len(listed) < len(found) or len(lengths) != 1:
            return Struct(found)
        count = lengths.pop()
        return [
            Struct({name: value[at] for name, value in found.items() if isinstance(value, list)}) for at in range(count)
        ]

    def _dataset(self, node: Any, name: str, depth: int) -> Value:
        size = prod(node.shape)
        self.left -= size
        if self.left < 0:
            raise ValueError(f"it holds more than {_MOST_VALUES} values, which no calibration has")
        if node.dtype.kind == "O":
            references = node[()].ravel()
            return [self.value(self.file[reference], depth + 1) for reference in references]
        if name == "char":
            codes = np.asarray(node[()]).ravel().astype("<u2")
            return codes.tobytes().decode("utf-16-le", errors="replace")
        if node.dtype.kind not in _NUMBERS:
            return Opaque("complex number" if node.dtype.names else name)
        array = np.asarray(node[()], dtype=np.float64)
        return array.reshape(-1, 1) if array.ndim < 2 else array.T


def _is_list(node: Any) -> bool:
    return node.dtype.kind == "O" and "MATLAB_class" not in node.attrs
