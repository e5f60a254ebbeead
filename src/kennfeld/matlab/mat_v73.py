"""Reads MATLAB files of version 7.3, which are HDF5 files, into a tree.

MATLAB turns arrays around, so that the first dimension is the last one of the file. A struct is a group, an array of
structs a group of datasets with references, a cell array one dataset of them; MATLAB_class, an attribute, is the kind.
"""

import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from kennfeld.matlab.mat_nodes import (
    MOST_BYTES,
    MOST_DENSE,
    MOST_NODES,
    PACKING,
    MatCells,
    MatFileContent,
    MatFileError,
    MatNumbers,
    MatStruct,
    MatStructArray,
    MatText,
    MatUnreadable,
    Node,
    TooManyError,
    dense,
    text_in_rows,
)

__all__ = []

_DEEPEST = 50
_MOST_DIMENSIONS = 32
_MOST_CLAIMED = 2**48  # values of an array that is empty
_OBJECTS = "#subsystem#/MCOS"
_NUMBERS = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))


def load(path: Path | BinaryIO, most_bytes: int = MOST_BYTES) -> dict[str, Node]:
    """The variables of a file; `DamageError` where it claims what it cannot hold."""
    return _loaded(path, _Loader(most_bytes, MOST_NODES), False).whole().variables


def load_all(path: Path | BinaryIO, most_bytes: int = MOST_BYTES, most_nodes: int = MOST_NODES) -> MatFileContent:
    """The variables of a file, the damaged ones among them, and where objects keep their properties."""
    return _loaded(path, _Loader(most_bytes, most_nodes), True)


def _loaded(path: Path | BinaryIO, loader: "_Loader", behind: bool) -> MatFileContent:
    import h5py

    found = MatFileContent()
    try:
        with h5py.File(path, "r") as file:
            for name, item in _own(file):
                found.variables[name] = loader.variable(item)
            found.damage = loader.damage
            if behind:
                found.further += loader.behind(file)
    except Exception as error:  # of many kinds: the library trusts what it reads
        found.damage = loader.damage
        found.lose(_said(error))
    return found


def _said(error: Exception) -> str:
    if isinstance(error, MatFileError):
        return str(error)
    return f"it is cut off or garbled ({' '.join(str(error).split())[:160] or type(error).__name__})"


def is_matlab(path: Path) -> bool:
    """Whether an HDF5 file is one of MATLAB."""
    import h5py

    with h5py.File(path, "r") as file:
        return any("MATLAB_class" in item.attrs for _, item in _own(file))


def _own(group: Any) -> list[tuple[str, Any]]:
    """The members that lie in the group itself; links to other places and files are not followed."""
    import h5py

    names = [name for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink)]
    return [(name, group[name]) for name in names if not name.startswith("#")]


class _Loader:
    """Counts what it reads."""

    def __init__(self, most_bytes: int, most_nodes: int) -> None:
        self.most_bytes = most_bytes
        self.most_nodes = most_nodes
        self.nodes = self.bytes = 0
        self.dense = MOST_DENSE
        self.damage = ""

    def variable(self, item: Any) -> Node:
        """A variable; one that is damaged does not take the others with it."""
        try:
            return self._node(item, 0)
        except TooManyError:
            raise
        except Exception as error:  # of many kinds: the library trusts what it reads
            self.damage = self.damage or _said(error)
            return MatUnreadable("damaged value", why=_said(error))

    def behind(self, file: Any) -> list[Node]:
        """The properties of all objects, in the form that they have in version 5."""
        import h5py

        wrapper = file.get(_OBJECTS, None)
        if not isinstance(wrapper, h5py.Dataset) or not _refers(wrapper):
            return []
        try:
            targets = self._targets(wrapper)
            cells = [self.variable(file[one]) if one else MatUnreadable("nothing") for one in targets]
        except Exception as error:  # of many kinds: the library trusts what it reads
            return [MatUnreadable("damaged value", why=_said(error))]
        return [MatStruct({"MCOS": MatUnreadable("FileWrapper__", MatCells(cells, (len(cells), 1)))})]

    def _node(self, item: Any, depth: int) -> Node:
        import h5py

        self.nodes += 1
        if self.nodes > self.most_nodes:
            raise TooManyError(f"it holds more than {self.most_nodes} arrays")
        if depth > _DEEPEST:
            raise MatFileError(f"arrays are nested more than {_DEEPEST} deep")
        kind = _class(item)
        if "MATLAB_object_decode" in item.attrs:
            return self._object(item, kind or "object")
        if isinstance(item, h5py.Group):
            return self._sparse(item, kind) if "MATLAB_sparse" in item.attrs else self._struct(item, depth)
        if not isinstance(item, h5py.Dataset):
            return MatUnreadable(kind or "object")
        return self._dataset(item, kind, depth)

    def _object(self, item: Any, kind: str) -> Node:
        """An object: its class, and the numbers by which its properties are found."""
        import h5py

        if kind == "function_handle":
            return MatUnreadable("function handle")
        if not isinstance(item, h5py.Dataset) or item.dtype.kind != "u":
            return MatUnreadable(kind, why="it is an enumeration or an object without numbers")
        self._check(item)
        return MatUnreadable(kind, MatNumbers(np.asarray(item[()]).T, True, "uint32"))

    def _sparse(self, group: Any, kind: str) -> Node:
        """A sparse matrix: where its columns begin; its rows and numbers are not there where all of it is 0."""
        import h5py

        parts = {name: item for name, item in _own(group) if isinstance(item, h5py.Dataset)}
        if "jc" not in parts:
            return MatUnreadable("sparse matrix")
        shape = int(group.attrs["MATLAB_sparse"]), parts["jc"].size - 1
        if any(part.dtype.kind not in "buif" for part in parts.values()):
            return MatUnreadable(
                "complex numbers" if "data" in parts and parts["data"].dtype.names else "sparse matrix"
            )
        if not 0 <= shape[0] * shape[1] <= self.dense:
            return MatUnreadable("sparse matrix")
        for part in parts.values():
            self._check(part)
        rows, values = (
            np.ravel(parts[name][()]) if name in parts else np.zeros(0, np.uint64) for name in ("ir", "data")
        )
        self.dense -= shape[0] * shape[1]
        full = dense(shape, rows, np.ravel(parts["jc"][()]), values)
        return MatNumbers(full, kind not in ("double", "single", ""), kind)

    def _struct(self, group: Any, depth: int) -> Node:
        import h5py

        members = _own(group)
        arrays = [m for _, m in members if isinstance(m, h5py.Dataset) and _refers(m) and not _class(m)]
        if not arrays or len(arrays) < len(members):
            return MatStruct({name: self._node(member, depth + 1) for name, member in members})
        count = min(member.size for member in arrays)
        if count > self.most_nodes:
            raise MatFileError(f"{group.name} claims {count} structs")
        targets = {name: self._targets(member) for name, member in members}
        return MatStructArray(
            [MatStruct({n: self._reference(group, t[k], depth) for n, t in targets.items()}) for k in range(count)]
        )

    def _targets(self, dataset: Any) -> list[Any]:
        """The references of a dataset, in MATLAB's order."""
        self._check(dataset)
        return list(np.asarray(dataset[()], dtype=object).ravel())  # turned around twice: column by column

    def _reference(self, item: Any, reference: Any, depth: int) -> Node:
        return self._node(item.file[reference], depth + 1) if reference else MatUnreadable("nothing")

    def _dataset(self, dataset: Any, kind: str, depth: int) -> Node:
        if dataset.attrs.get("MATLAB_empty", 0):
            return self._empty(dataset, kind)
        if _refers(dataset):
            return MatCells(
                [self._reference(dataset, target, depth) for target in self._targets(dataset)], dataset.shape[::-1]
            )
        if dataset.shape is None or dataset.dtype.kind not in "buif":
            return MatUnreadable("complex numbers" if dataset.dtype.names == ("real", "imag") else kind or "data")
        if kind not in (*_NUMBERS, "char", ""):
            return MatUnreadable(kind)
        self._check(dataset)
        values = np.asarray(dataset[()]).T
        if kind == "char":
            letters = "".join(map(chr, values.ravel(order="F").astype(np.uint32).clip(0, 0xFFFF).tolist()))
            return text_in_rows(letters, values.shape[0] if values.ndim > 1 else 1)
        return MatNumbers(values, kind not in ("double", "single", ""), kind)

    def _empty(self, dataset: Any, kind: str) -> Node:
        """An empty array, which says its size instead of its numbers; a struct without fields is kept like one."""
        shape = tuple(int(n) for n in np.ravel(dataset[()])) if 2 <= dataset.size <= _MOST_DIMENSIONS else (0, 0)
        if kind == "char":
            return MatText("")
        if kind == "struct":
            return MatStruct() if math.prod(shape) == 1 else MatStructArray([], shape)
        if kind == "cell":
            return MatCells([], shape)
        known = min(shape) == 0 and math.prod(filter(None, shape)) < _MOST_CLAIMED
        name = kind if kind in _NUMBERS else ""
        return MatNumbers(np.empty(shape if known else (0, 0)), name not in ("double", "single", ""), name)

    def _check(self, dataset: Any) -> None:
        """Refuse what the file cannot hold; the library would ask for that memory."""
        self.bytes += dataset.nbytes
        stored = dataset.id.get_storage_size()
        if (
            self.bytes > self.most_bytes
            or dataset.nbytes > PACKING * (stored + 8)
            or dataset.external
            or dataset.is_virtual
        ):
            raise MatFileError(f"{dataset.name} claims {dataset.size} values in {stored} bytes")


def _class(item: Any) -> str:
    kind = item.attrs.get("MATLAB_class", b"")
    return kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)


def _refers(dataset: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference
