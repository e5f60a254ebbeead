"""The variables of a model workspace: as the model file keeps them, or as a MAT-file."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.arrays import Float, readonly
from kennfeld.matlab.data import loaded_of
from kennfeld.matlab.mcos import single, workspace
from kennfeld.matlab.tree import Cells, DamageError, Loaded, Node, Numbers, Struct, Structs, Text, Unreadable
from kennfeld.models.simulink.files.tree import Workspace
from kennfeld.models.simulink.variables.data import Data, Entry, Value, entry_of

__all__ = ["mat_variables", "mxarray_value", "mxarray_variables", "workspace_variables"]

_MOST_BYTES = 200_000_000  # unpacked
_MOST_ARRAYS = 1_000_000
_NEEDED = ("Value", "Table", "Breakpoints")  # what an object is there for
_WHY = {
    "complex numbers": "it is complex",
    "sparse matrix": "it is a sparse matrix that is too large",
    "function handle": "it is a function handle",
}


def workspace_variables(workspace: Workspace) -> Data:
    """The variables that a model file keeps in itself; none where they are code or in another file.

    What cannot be read is told by name in `unreadable`; a workspace that is broken altogether under the name "".
    """
    if workspace.kind == "mxarray":
        return mxarray_variables(workspace.raw)
    return mat_variables(workspace.raw) if workspace.kind == "mat" else Data()


def mxarray_value(raw: bytes) -> Value:
    """The value of a single array in the form of `.mxarray` parts; raises `DamageError` where there is none."""
    try:
        return _Reader().value(single(raw, _MOST_BYTES), "")
    except _UnreadError as why:
        raise DamageError(str(why)) from None


def mxarray_variables(raw: bytes) -> Data:
    """The variables in the bytes of a `.mxarray` part."""
    try:
        return _data(workspace(raw, _MOST_BYTES), "the model workspace cannot be read")
    except DamageError as error:
        return Data(unreadable={"": f"the model workspace is in an unknown form: {error}"})


def mat_variables(raw: bytes) -> Data:
    """The variables in the bytes of a MAT-file of any version."""
    return _data(loaded_of(raw, _MOST_BYTES, _MOST_ARRAYS), "the MAT-file cannot be read")


def _data(loaded: Loaded, what: str) -> Data:
    """The variables that can be used; of what is lost with its name, the file itself is told."""
    reader, entries = _Reader(), {}
    for name, node in loaded.variables.items():
        try:
            entries[name] = _entry(name, node, reader.value(node, name))
        except _UnreadError as why:
            reader.unreadable[name] = str(why)
    if loaded.lost:
        whole = what if not entries else f"{what} whole"
        reader.unreadable[""] = f"{whole}: {loaded.lost}"
    return Data(entries, reader.unreadable)


def _entry(name: str, node: Node, value: Value) -> Entry:
    """A variable under its name: an object keeps what it says of itself."""
    if isinstance(value, Entry):
        return replace(value, name=name)
    if isinstance(node, Numbers):
        return Entry(name, value, node.kind or "double")
    kind = node.elements[0].kind if isinstance(node, Structs) and node.elements else ""
    word = "char" if isinstance(node, Text) else "cell" if isinstance(node, Cells) else "struct"
    return Entry(name, value, kind or word)


class _UnreadError(Exception):
    """A value is of no use here; the text says why."""


@dataclass
class _Reader:
    """Turns nodes into values; `unreadable` says what was left out within them."""

    unreadable: dict[str, str] = field(default_factory=dict)

    def value(self, node: Node, path: str) -> Value:
        """The value of a node; raises `_UnreadError` where it is none of those that are used here."""
        match node:
            case Numbers():
                return _numbers(node)
            case Text():
                return node.rows or node.text
            case Struct():
                return entry_of("", node.kind, self._properties(node)) if node.kind else self._fields(node, path)
            case Structs():
                return tuple(self.value(one, f"{path}({n})") for n, one in enumerate(node.elements, 1))
            case Cells():
                return tuple(self.value(one, f"{path}{{{n}}}") for n, one in enumerate(node.cells, 1))
            case Unreadable():
                raise _UnreadError(_why(node))

    def _fields(self, node: Struct, path: str) -> Mapping[str, Value]:
        """The fields of a struct; one that cannot be read is told, and does not take the others with it."""
        fields = {}
        for name, inner in node.fields.items():
            try:
                fields[name] = self.value(inner, f"{path}.{name}")
            except _UnreadError as why:
                self.unreadable[f"{path}.{name}"] = str(why)
        return fields

    def _properties(self, node: Struct) -> Mapping[str, Value]:
        """The properties of an object; one that cannot be read is left out, unless the object is there for it."""
        properties = {}
        for name, inner in node.fields.items():
            try:
                properties[name] = _Reader().value(inner, name)
            except _UnreadError:
                if name in _NEEDED:
                    raise
        return properties


def _numbers(node: Numbers) -> Float:
    with np.errstate(invalid="ignore"):  # some not-a-numbers of single precision warn
        return readonly(node.values)


def _why(node: Unreadable) -> str:
    """Why a value cannot be used."""
    if node.kind in _WHY or node.kind == "damaged value":
        return node.why or _WHY[node.kind]
    return f"{node.kind}: {node.why or 'only MATLAB can read it'}"
