"""Reader of MATLAB files of version 7.3, which are HDF5 files.

MATLAB reverses the dimensions of arrays. A struct is a group, an array of structs a group of datasets of references, a
cell array one dataset of references; the attribute MATLAB_class names the class.

The library may crash on damaged files, so that `load_guarded` is the one to call; the others are for its process.
"""

import math
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.library_process import LibraryFailure, LibraryProcess
from kennfeld.matlab import mat_nodes as n

LIBRARY = LibraryProcess("HDF5")

_MAX_DEPTH = 50
_MAX_DIMENSIONS = 32
_MAX_CLAIMED = 2**48  # values of an array that is empty
_OBJECTS = "#subsystem#/MCOS"
_NUMBERS = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))


def load(path: Path | BinaryIO, max_bytes: int = n.MAX_BYTES) -> dict[str, n.Node]:
    """Read the variables; raises `MatFileError` if the file is damaged or claims more than it can hold."""
    return _load_file(path, _Loader(max_bytes, n.MAX_NODES), False).whole().variables


@dataclass(frozen=True)
class _FileBytes:
    """The bytes of a file, which the caller names in its own findings."""

    content: bytes

    @property
    def size(self) -> int:
        return len(self.content)

    def stored_size(self) -> int:
        return self.size

    def open(self) -> BinaryIO:
        return BytesIO(self.content)

    @property
    def location(self) -> Location:
        return Location()


def load_guarded(content: bytes, max_bytes: int = n.MAX_BYTES, max_nodes: int = n.MAX_NODES) -> n.MatFileContent:
    """Read the same as `load_all` in a process that may crash; then the whole file is lost."""
    try:
        loaded: n.MatFileContent = LIBRARY.attempt(_load_content, _FileBytes(content), max_bytes, max_nodes)
    except LibraryFailure as failure:
        loaded = n.MatFileContent()
        loaded.lose(str(failure))
    return loaded


def is_matlab_guarded(content: bytes) -> bool:
    """Return the same as `is_matlab`, found in a process that may crash; False also for a damaged file."""
    try:
        return bool(LIBRARY.attempt(_is_matlab_content, _FileBytes(content)))
    except LibraryFailure:
        return False


def _is_matlab_content(source: _FileBytes) -> bool:
    try:
        return is_matlab(BytesIO(source.content))
    except Exception:  # of many kinds: the library does not check what it reads
        return False


def _load_content(source: _FileBytes, max_bytes: int, max_nodes: int) -> n.MatFileContent:
    return load_all(BytesIO(source.content), max_bytes, max_nodes)


def load_all(path: Path | BinaryIO, max_bytes: int = n.MAX_BYTES, max_nodes: int = n.MAX_NODES) -> n.MatFileContent:
    """Read the variables, damaged ones included, and the properties of objects."""
    return _load_file(path, _Loader(max_bytes, max_nodes), True)


def _load_file(path: Path | BinaryIO, loader: "_Loader", with_objects: bool) -> n.MatFileContent:
    import h5py

    loaded = n.MatFileContent()
    try:
        with h5py.File(path, "r") as file:
            for name, item in _members(file):
                loaded.variables[name] = loader.variable(item)
            loaded.damage = loader.damage
            if with_objects:
                loaded.further += loader.object_properties(file)
    except Exception as error:  # of many kinds: the library does not validate its input
        loaded.damage = loader.damage
        loaded.lose(_describe(error))
    return loaded


def _describe(error: Exception) -> str:
    if isinstance(error, n.MatFileError):
        return str(error)
    return f"it is truncated or corrupt ({' '.join(str(error).split())[:160] or type(error).__name__})"


def is_matlab(path: Path | BinaryIO) -> bool:
    """Return True if an HDF5 file was written by MATLAB."""
    import h5py

    with h5py.File(path, "r") as file:
        return any("MATLAB_class" in item.attrs for _, item in _members(file))


def _members(group: Any) -> list[tuple[str, Any]]:
    """Return the members of the group itself; links to other places and files are not followed."""
    import h5py

    names = [name for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink)]
    return [(name, group[name]) for name in names if not name.startswith("#")]


class _Loader:
    """Converts datasets and groups to nodes, within limits."""

    def __init__(self, max_bytes: int, max_nodes: int) -> None:
        self.max_bytes = max_bytes
        self.max_nodes = max_nodes
        self.nodes = self.bytes = 0
        self.dense = n.MAX_DENSE
        self.damage = ""

    def variable(self, item: Any) -> n.Node:
        """Convert a variable; damage does not affect others."""
        try:
            return self._node(item, 0)
        except n.ArrayLimitError:
            raise
        except Exception as error:  # of many kinds: the library does not validate its input
            self.damage = self.damage or _describe(error)
            return n.MatUnreadable("damaged value", why=_describe(error))

    def object_properties(self, file: Any) -> list[n.Node]:
        """Return the properties of all objects, in the form of version 5."""
        import h5py

        wrapper = file.get(_OBJECTS, None)
        if not isinstance(wrapper, h5py.Dataset) or not _holds_references(wrapper):
            return []
        try:
            targets = self._targets(wrapper)
            # a null reference is false
            cells = [self.variable(file[target]) if target else n.MatUnreadable("nothing") for target in targets]
        except Exception as error:  # of many kinds: the library does not validate its input
            return [n.MatUnreadable("damaged value", why=_describe(error))]
        return [n.MatStruct({"MCOS": n.MatUnreadable("FileWrapper__", n.MatCells(cells, (len(cells), 1)))})]

    def _node(self, item: Any, depth: int) -> n.Node:
        import h5py

        self.nodes += 1
        if self.nodes > self.max_nodes:
            raise n.ArrayLimitError(f"it contains more than {self.max_nodes} arrays")
        if depth > _MAX_DEPTH:
            raise n.MatFileError(f"arrays are nested more than {_MAX_DEPTH} deep")
        kind = _class(item)
        if "MATLAB_object_decode" in item.attrs:
            return self._object(item, kind or "object")
        if isinstance(item, h5py.Group):
            return self._sparse(item, kind) if "MATLAB_sparse" in item.attrs else self._struct(item, depth)
        if not isinstance(item, h5py.Dataset):
            return n.MatUnreadable(kind or "object")
        return self._dataset(item, kind, depth)

    def _object(self, item: Any, kind: str) -> n.Node:
        """Convert an object to its class and the reference to its properties."""
        import h5py

        if kind == "function_handle":
            return n.MatUnreadable("function handle")
        if not isinstance(item, h5py.Dataset) or item.dtype.kind != "u":
            return n.MatUnreadable(kind, why="it is an enumeration or an object without references")
        self._check(item)
        return n.MatUnreadable(kind, n.MatNumbers(np.asarray(item[()]).T, True, "uint32"))

    def _sparse(self, group: Any, kind: str) -> n.Node:
        """Convert a sparse matrix; rows and values are absent if all values are 0."""
        import h5py

        parts = {name: item for name, item in _members(group) if isinstance(item, h5py.Dataset)}
        if "jc" not in parts:
            return n.MatUnreadable("sparse matrix")
        # the attribute is the number of rows; jc has the offset of each column and the end
        shape = int(group.attrs["MATLAB_sparse"]), parts["jc"].size - 1
        if any(part.dtype.kind not in "buif" for part in parts.values()):
            return n.MatUnreadable(
                "complex numbers" if "data" in parts and parts["data"].dtype.names else "sparse matrix"
            )
        if not 0 <= shape[0] * shape[1] <= self.dense:
            return n.MatUnreadable("sparse matrix")
        for part in parts.values():
            self._check(part)
        rows, values = (
            np.ravel(parts[name][()]) if name in parts else np.zeros(0, np.uint64) for name in ("ir", "data")
        )
        self.dense -= shape[0] * shape[1]
        full = n.to_dense(shape, rows, np.ravel(parts["jc"][()]), values)
        return n.MatNumbers(full, kind not in ("double", "single", ""), kind)

    def _struct(self, group: Any, depth: int) -> n.Node:
        import h5py

        members = _members(group)
        arrays = [m for _, m in members if isinstance(m, h5py.Dataset) and _holds_references(m) and not _class(m)]
        # a single struct may have cells as fields: those have a class, the columns of an array of structs none
        if not arrays or len(arrays) < len(members):
            return n.MatStruct({name: self._node(member, depth + 1) for name, member in members})
        count = min(member.size for member in arrays)
        if count > self.max_nodes:
            raise n.MatFileError(f"{group.name} claims {count} structs")
        targets = {name: self._targets(member) for name, member in members}
        return n.MatStructArray(
            [n.MatStruct({n: self._reference(group, t[k], depth) for n, t in targets.items()}) for k in range(count)]
        )

    def _targets(self, dataset: Any) -> list[Any]:
        """Return the references of a dataset in column-major order."""
        self._check(dataset)
        return list(np.asarray(dataset[()], dtype=object).ravel())  # reversed twice: column-major order

    def _reference(self, item: Any, reference: Any, depth: int) -> n.Node:
        return self._node(item.file[reference], depth + 1) if reference else n.MatUnreadable("nothing")

    def _dataset(self, dataset: Any, kind: str, depth: int) -> n.Node:
        if dataset.attrs.get("MATLAB_empty", 0):
            return self._empty(dataset, kind)
        if _holds_references(dataset):
            return n.MatCells(
                [self._reference(dataset, target, depth) for target in self._targets(dataset)], dataset.shape[::-1]
            )
        if dataset.shape is not None and dataset.dtype.names == ("real", "imag"):
            return self._complex(dataset)
        if dataset.shape is None or dataset.dtype.kind not in "buif":
            return n.MatUnreadable(kind or "data")
        if kind not in (*_NUMBERS, "char", ""):
            return n.MatUnreadable(kind)
        self._check(dataset)
        values = np.asarray(dataset[()]).T
        if kind == "char":
            # characters are stored as UTF-16 code units, uint16
            letters = "".join(map(chr, values.ravel(order="F").astype(np.uint32).clip(0, 0xFFFF).tolist()))
            return n.split_text_rows(letters, values.shape[0] if values.ndim > 1 else 1)
        return n.MatNumbers(values, kind not in ("double", "single", ""), kind)

    def _complex(self, dataset: Any) -> n.Node:
        if dataset.dtype["real"].kind != "f" or dataset.dtype["imag"].kind != "f":
            return n.MatUnreadable("complex numbers")
        self._check(dataset)
        values = np.asarray(dataset[()]).T
        return n.MatUnreadable("complex numbers", parts=(values["real"], values["imag"]))

    def _empty(self, dataset: Any, kind: str) -> n.Node:
        """Convert an empty array, which stores its size instead of numbers."""
        shape = tuple(int(n) for n in np.ravel(dataset[()])) if 2 <= dataset.size <= _MAX_DIMENSIONS else (0, 0)
        if kind == "char":
            return n.MatText("")
        if kind == "struct":
            return n.MatStruct() if math.prod(shape) == 1 else n.MatStructArray([], shape)
        if kind == "cell":
            return n.MatCells([], shape)
        # numpy refuses empty arrays as well if the product of the other dimensions overflows
        known = min(shape) == 0 and math.prod(filter(None, shape)) < _MAX_CLAIMED
        name = kind if kind in _NUMBERS else ""
        return n.MatNumbers(np.empty(shape if known else (0, 0)), name not in ("double", "single", ""), name)

    def _check(self, dataset: Any) -> None:
        """Reject a size that the file cannot hold, since the library would allocate it."""
        self.bytes += dataset.nbytes
        stored = dataset.id.get_storage_size()
        if (
            self.bytes > self.max_bytes
            or dataset.nbytes > n.MAX_COMPRESSION * (stored + 8)
            or dataset.external
            or dataset.is_virtual
        ):
            raise n.MatFileError(f"{dataset.name} claims {dataset.size} values in {stored} bytes")


def _class(item: Any) -> str:
    kind = item.attrs.get("MATLAB_class", b"")
    return kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)


def _holds_references(dataset: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference
