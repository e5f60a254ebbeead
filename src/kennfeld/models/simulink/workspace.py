"""The variables of a model workspace: as the model file keeps them, or as a MAT-file.

`modelWorkspace.mxarray` is a struct whose fields are the variables (in classic files an array of structs with a Name
and a Value each), then the subsystem with the properties of their
objects: elements of a MAT-file of level 5 behind eight bytes instead of the 128 of a file.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from kennfeld.arrays import readonly
from kennfeld.models.simulink.data import Data, Entry, Value
from kennfeld.models.simulink.mat5 import Element, Mat5Error, Opaque, Plain, Reader, elements
from kennfeld.models.simulink.objects import Objects, objects_of
from kennfeld.models.simulink.tree import Workspace

__all__ = ["mat_variables", "mxarray_value", "mxarray_variables", "workspace_variables"]

_HEADER = 128


def workspace_variables(workspace: Workspace) -> Data:
    """The variables that a model file keeps in itself; none where they are code or in another file.

    What cannot be read is told by name in `unreadable`; a workspace that is broken altogether under the name "".
    """
    if workspace.kind == "mxarray":
        return mxarray_variables(workspace.raw)
    return mat_variables(workspace.raw) if workspace.kind == "mat" else Data()


def mxarray_value(raw: bytes) -> Value:
    """The value of a single array in the form of `.mxarray` parts; raises `Mat5Error` where there is none."""
    order = "<" if raw[2:4] == b"IM" else ">"
    reader = Reader(order)
    first = next(elements(raw[8:], order), None)
    if raw[:4] not in (b"\0\1IM", b"\1\0MI") or first is None:
        raise Mat5Error("it is in an unknown form")
    return _value(reader.array(reader.unpacked(first))[2], None, "it is an object")


def mxarray_variables(raw: bytes) -> Data:
    """The variables in the bytes of a `.mxarray` part."""
    if raw[:4] not in (b"\0\1IM", b"\1\0MI"):
        return Data(unreadable={"": "the model workspace is in an unknown form"})
    order = "<" if raw[2:4] == b"IM" else ">"
    reader = Reader(order)
    try:
        found = _arrays(elements(raw[8:], order), reader)
    except Mat5Error as error:
        return Data(unreadable={"": f"the model workspace cannot be read: {error}"})
    if not found:
        return Data()
    fields, further = found[0][2], found[1:]
    if isinstance(fields, tuple) or _is_pair(fields):
        return _read(_paired(fields if isinstance(fields, tuple) else (fields,)), further)
    if not isinstance(fields, dict):
        return Data(unreadable={"": "the model workspace is in an unknown form"})
    return _read([(name, "", value) for name, value in fields.items()], further)


def _is_pair(fields: Plain) -> bool:
    """Whether a struct is one variable with its name, not two variables."""
    return isinstance(fields, dict) and fields.keys() == {"Name", "Value"} and isinstance(fields["Name"], str)


def _paired(fields: tuple[Plain, ...]) -> list[tuple[str, str, Plain]]:
    """Variables as an array of structs with a Name and a Value each, as older releases keep them."""
    named = [pair for pair in fields if isinstance(pair, dict)]
    return [(str(pair.get("Name", "")), "", pair["Value"]) for pair in named if "Value" in pair]


def mat_variables(raw: bytes) -> Data:
    """The variables in the bytes of a MAT-file of level 5 (versions 5 to 7)."""
    if len(raw) < _HEADER or raw[126:128] not in (b"IM", b"MI"):
        return Data(unreadable={"": "this is no MAT-file of version 5 to 7"})
    order = "<" if raw[126:128] == b"IM" else ">"
    reader = Reader(order)
    try:
        found = _arrays(elements(raw[_HEADER:], order), reader)
    except Mat5Error as error:
        return Data(unreadable={"": f"the MAT-file cannot be read: {error}"})
    named = [array for array in found if array[0]]
    return _read(named, [array for array in found if not array[0]])


def _arrays(found: Iterable[Element], reader: Reader) -> list[tuple[str, str, Plain]]:
    return [reader.array(reader.unpacked(part)) for part in found]


def _read(variables: Iterable[tuple[str, str, Plain]], further: list[tuple[str, str, Plain]]) -> Data:
    entries: dict[str, Entry] = {}
    unreadable: dict[str, str] = {}
    objects, why = _objects(further)
    for name, kind, given in variables:
        try:
            entries[name] = _entry(name, kind, _value(given, objects, why))
        except Mat5Error as error:
            what = f"{given.kind}: " if isinstance(given, Opaque) else ""
            unreadable[name] = f"{what}{error}"
    return Data(entries, unreadable)


def _objects(further: list[tuple[str, str, Plain]]) -> tuple[Objects | None, str]:
    """The objects of the file, or why there are none."""
    try:
        return (objects_of(further[0][2]), "") if further else (None, "the file does not hold its properties")
    except Mat5Error as error:
        return None, str(error)


def _value(given: Plain, objects: Objects | None, why: str) -> Value:
    if objects is not None:
        return objects.value(given)
    if isinstance(given, Opaque):
        raise Mat5Error(why)
    if isinstance(given, np.ndarray | str):
        return given
    if isinstance(given, tuple):
        return tuple(_value(inner, None, why) for inner in given)
    if isinstance(given, dict):
        return {name: _value(inner, None, why) for name, inner in given.items()}
    raise Mat5Error(getattr(given, "why", why))


def _entry(name: str, kind: str, value: Value) -> Entry:
    """A variable under its name: an object keeps what it says of itself."""
    if isinstance(value, Entry):
        return replace(value, name=name)
    if isinstance(value, np.ndarray):
        return Entry(name, readonly(value), kind or "double")
    word = "char" if isinstance(value, str) else "cell" if isinstance(value, tuple) else "struct"
    return Entry(name, value, kind or word)
