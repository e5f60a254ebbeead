"""Variables stored in a model workspace, data dictionary or MAT-file."""

from collections.abc import Mapping
from dataclasses import field, replace
from typing import TypeAlias, Union

import numpy as np

from kennfeld.base.arrays import Float, readonly
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.model_tree import StoredWorkspace
from kennfeld.matlab import mat_nodes as n
from kennfeld.matlab.mat_reader import load_nodes
from kennfeld.matlab.mcos import read_array, read_workspace

Value: TypeAlias = Union[Float, str, "Mapping[str, Value]", "tuple[Value, ...]", "StoredVariable", None]

ENUMERATED = "Enum:"  # begins the data type of enumerated values

_MAX_BYTES = 200_000_000  # unpacked
_MAX_ARRAYS = 1_000_000
_NEEDED = ("Value", "Table", "Breakpoints")  # the value proper of an object
_WHY = {
    "complex numbers": "it is complex",
    "sparse matrix": "it is a sparse matrix that is too large",
    "function handle": "it is a function handle",
}


@dataclass(frozen=True)
class StoredVariable:
    """One variable.

    `value` is an array of at least two dimensions (numbers and booleans), a text, a mapping (a struct), a tuple (a cell
    array, an array of structs or objects), another entry (an inner object), or None if the file gives none. `kind` is
    the class: "double", "single", "struct", "Simulink.Parameter", ... `type` is the data type that an object specifies
    ("auto", "single", "fixdt(1,16,4)"), `minimum` and `maximum` are its limits. For a Simulink.LookupTable, `value` is
    the table and `breakpoints` are its axes; everything else is in `properties`. Enumerated values have the type
    "Enum: Class"; their value is numbers, or the names of members.
    """

    name: str
    value: Value
    kind: str
    type: str = ""
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""
    breakpoints: tuple["StoredVariable", ...] = ()
    properties: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class StoredVariables:
    """The variables of one source; `unreadable` gives the reason by name of what could not be decoded."""

    entries: Mapping[str, StoredVariable] = field(default_factory=dict)
    unreadable: Mapping[str, str] = field(default_factory=dict)

    def merged_with(self, further: "StoredVariables") -> "StoredVariables":
        """Add the variables of another source to those of this one, which take precedence."""
        entries, unreadable = {**further.entries, **self.entries}, {**further.unreadable, **self.unreadable}
        return StoredVariables(entries, unreadable)


class UnusableValueError(Exception):
    """A value cannot be used; the text gives the reason."""


def stored_variable(kind: str, properties: Mapping[str, Value]) -> StoredVariable:
    """Build an object from its properties: those used for calibration by name, the rest as they are."""
    # bus objects of newer releases keep Elements_internal, DataType_internal, Min_internal
    properties = {name.removesuffix("_internal"): value for name, value in properties.items()}
    table, axes = properties.get("Table"), properties.get("Breakpoints")
    if table is not None:
        breakpoints = tuple(
            _plain(_text(axis, "FieldName") or f".{number}", "breakpoints", axis)
            for number, axis in enumerate(map(_part, several(axes)), 1)
        )
        return replace(_plain("", kind, _part(table)), breakpoints=breakpoints, properties=properties)
    inner = several(axes)
    # a Simulink.Breakpoint holds its value one level down, in `Breakpoints`
    if inner and "Value" not in properties:
        properties = {**properties, **_part(inner[0])}
    return _plain("", kind, properties)


def _plain(name: str, kind: str, properties: Mapping[str, Value]) -> StoredVariable:
    return StoredVariable(
        name,
        properties.get("Value"),
        kind,
        _text(properties, "DataType"),
        _text(properties, "Unit") or _text(properties, "DocUnits"),
        _limit(properties.get("Min")),
        _limit(properties.get("Max")),
        _text(properties, "Description"),
        properties={key: value for key, value in properties.items() if key != "Value"},
    )


def _part(value: Value) -> Mapping[str, Value]:
    if isinstance(value, StoredVariable):
        return {**value.properties, "Value": value.value}
    return value if isinstance(value, Mapping) else {"Value": value}


def several(value: Value) -> tuple[Value, ...]:
    """Return the parts of a stored value, which is not a tuple if it is the only one."""
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)


def _text(properties: Mapping[str, Value], key: str) -> str:
    text = properties.get(key)
    return text if isinstance(text, str) else ""


def _limit(value: Value) -> float | None:
    """Return a limit, None if it is empty or infinite."""
    if not isinstance(value, np.ndarray) or value.size != 1:
        return None
    number = float(readonly(value).flat[0])
    return number if np.isfinite(number) else None


def workspace_variables(workspace: StoredWorkspace) -> StoredVariables:
    """Decode the variables stored in the model file itself, none if they are code or in another file.

    `unreadable` lists what cannot be read; the name "" stands for the whole workspace.
    """
    if workspace.kind == "mxarray":
        return mxarray_variables(workspace.raw)
    return mat_variables(workspace.raw) if workspace.kind == "mat" else StoredVariables()


def mxarray_value(raw: bytes) -> Value:
    """Decode the value of a single `.mxarray` array; raises `MatFileError` if there is none."""
    try:
        return _NodeDecoder().value(read_array(raw, _MAX_BYTES), "")
    except UnusableValueError as why:
        raise n.MatFileError(str(why)) from None


def mxarray_variables(raw: bytes) -> StoredVariables:
    """Decode the variables in the bytes of a `.mxarray` part."""
    try:
        return _data(read_workspace(raw, _MAX_BYTES), "the model workspace cannot be read")
    except n.MatFileError as error:
        return StoredVariables(unreadable={"": f"the model workspace has an unknown format: {error}"})


def mat_variables(raw: bytes) -> StoredVariables:
    """Decode the variables in the bytes of a MAT-file of any version."""
    return _data(load_nodes(raw, _MAX_BYTES, _MAX_ARRAYS), "the MAT-file cannot be read")


def _data(loaded: n.MatFileContent, message: str) -> StoredVariables:
    """Return the usable variables; losses without a name are recorded for the file."""
    reader, entries = _NodeDecoder(), {}
    for name, node in loaded.variables.items():
        try:
            # one value that cannot be used leaves the others usable
            entries[name] = _entry(name, node, reader.value(node, name))
        except UnusableValueError as why:
            reader.unreadable[name] = str(why)
    # a file that is cut off still gives the variables before the cut
    if loaded.lost:
        whole = message if not entries else f"{message} whole"
        reader.unreadable[""] = f"{whole}: {loaded.lost}"
    return StoredVariables(entries, reader.unreadable)


def _entry(name: str, node: n.Node, value: Value) -> StoredVariable:
    """Return a variable; an object keeps its properties."""
    if isinstance(value, StoredVariable):
        return replace(value, name=name)
    if isinstance(node, n.MatNumbers):
        return StoredVariable(name, value, node.kind or "double")
    kind = node.elements[0].kind if isinstance(node, n.MatStructArray) and node.elements else ""
    word = "char" if isinstance(node, n.MatText) else "cell" if isinstance(node, n.MatCells) else "struct"
    return StoredVariable(name, value, kind or word)


@dataclass
class _NodeDecoder:
    """Converts nodes to values; `unreadable` lists what was skipped within them."""

    unreadable: dict[str, str] = field(default_factory=dict)

    def value(self, node: n.Node, path: str) -> Value:
        """Convert a node to its value; raise `UnusableValueError` if it is unsupported."""
        match node:
            case n.MatNumbers():
                with np.errstate(invalid="ignore"):  # some single-precision NaNs warn
                    return readonly(node.values)
            case n.MatText():
                # several rows of characters are a tuple of texts
                return node.rows or node.text
            case n.MatStruct():
                return stored_variable(node.kind, self._properties(node)) if node.kind else self._fields(node, path)
            case n.MatStructArray():
                return tuple(self.value(element, f"{path}({at})") for at, element in enumerate(node.elements, 1))
            case n.MatCells():
                return tuple(self.value(element, f"{path}{{{at}}}") for at, element in enumerate(node.cells, 1))
            case n.MatUnreadable():
                if node.kind in _WHY or node.kind == "damaged value":
                    raise UnusableValueError(node.why or _WHY[node.kind])
                raise UnusableValueError(f"{node.kind}: {node.why or 'it can only be read by MATLAB'}")

    def _fields(self, node: n.MatStruct, path: str) -> Mapping[str, Value]:
        """Return the fields of a struct; unreadable ones are recorded and skipped."""
        fields = {}
        for name, inner in node.fields.items():
            try:
                fields[name] = self.value(inner, f"{path}.{name}")
            except UnusableValueError as why:
                self.unreadable[f"{path}.{name}"] = str(why)
        return fields

    def _properties(self, node: n.MatStruct) -> Mapping[str, Value]:
        """Return the properties of an object; unreadable ones are skipped unless they are its value."""
        properties = {}
        for name, inner in node.fields.items():
            try:
                # a decoder of its own: what it skips within a property is not reported
                properties[name] = _NodeDecoder().value(inner, name)
            except UnusableValueError:
                if name in _NEEDED:
                    raise
        return properties
