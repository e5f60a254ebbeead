"""MATLAB data files (.mat), versions 4 to 7.3, as calibrations; objects such as Simulink.Parameter included."""

import re

import numpy as np

from kennfeld.calfiles.format import Content, Notes, Source
from kennfeld.calfiles.matlab_values import Opaque, Struct, Value, holds_samples, parameters_of
from kennfeld.errors import InputError
from kennfeld.matlab import tree
from kennfeld.matlab.data import nodes_of

__all__ = ["is_calibration_mat", "read_mat", "recognises_mat"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_MOST_BYTES = 200_000_000  # unpacked
_OLD_TYPES = 6  # of numbers, in version 4
_OLD_NAME = re.compile(rb"[A-Za-z]\w{0,62}\0")
_LETTERS = "xyzw"
_WORDS = {"complex numbers": "complex number"}
_SAID = ("Value", "Unit", "DocUnits", "Description")  # what an object says to a calibration


def recognises_mat(source: Source) -> bool:
    """Whether a file, of which the beginning may suffice, is a MATLAB data file."""
    raw = source.raw
    return raw.startswith(b"MATLAB 5.0 MAT-file") or _is_hdf5(raw) or _is_old(raw)


def _is_hdf5(raw: bytes) -> bool:
    return raw.startswith(_HDF5) or raw[_USER_BLOCK : _USER_BLOCK + len(_HDF5)] == _HDF5


def _is_old(raw: bytes) -> bool:
    """Whether a variable of version 4 stands at the beginning, which no mark tells."""
    if len(raw) < 22:
        return False
    for order in "<>":
        code, rows, columns, is_complex, length = (int(n) for n in np.frombuffer(raw[:20], f"{order}i4"))
        thousands, rest = divmod(code, 1000)
        fits = thousands == "<>".index(order) and rest < 10 * _OLD_TYPES and rest % 10 < 3
        plain = is_complex in (0, 1) and min(rows, columns) >= 0 and 1 < length < 65
        if fits and plain and _OLD_NAME.fullmatch(raw[20 : 20 + length]):
            return True
    return False


def read_mat(source: Source) -> Content:
    """The parameters of a data file: plain numbers, vectors, matrices, texts, structs with axes and values.

    Raises `InputError` where it is damaged or holds recorded samples; objects that only MATLAB reads are remarked.
    """
    notes = Notes(source.name)
    version, variables = _variables(source)
    samples = holds_samples(variables)
    if samples:
        what = f"holds recorded samples ({samples}), not a calibration"
        notes.error(0, "", what, "Name it as a file of a dataset.")
        notes.settle()
    return Content(f"MATLAB {version}", parameters_of(variables, notes), notes.settle())


def is_calibration_mat(source: Source) -> bool:
    """Whether a data file holds a calibration rather than recorded samples."""
    try:
        variables = _variables(source)[1]
    except InputError:
        return False
    plain = any(isinstance(value, (Struct, np.ndarray)) for value in variables.values())
    return plain and not holds_samples(variables)


def _variables(source: Source) -> tuple[str, dict[str, Value]]:
    raw = source.raw
    try:
        nodes = nodes_of(raw, _MOST_BYTES)
    except Exception as error:  # of many kinds: the library for version 7.3 trusts what it reads
        what = " ".join(str(error).split())[:160] or type(error).__name__
    else:
        version = "7.3" if _is_hdf5(raw) else "5" if raw.startswith(b"MATLAB") else "4"
        return version, {name: _value(node) for name, node in nodes.items()}
    mend = "The file may be cut off or damaged: save it anew in MATLAB."
    raise InputError.of(source.name, f"cannot be read as MATLAB data: {what}", mend) from None


def _value(node: tree.Node) -> Value:
    match node:
        case tree.Numbers():
            values = node.values.astype(np.float64)
            return values if values.ndim > 1 else values.reshape(-1, 1)
        case tree.Text():
            return node.text
        case tree.Struct():
            return _object(node) if node.kind else Struct({name: _value(one) for name, one in node.fields.items()})
        case tree.Structs():
            return [_value(element) for element in node.elements]
        case tree.Cells():
            return [_value(cell) for cell in node.cells]
        case _:
            return Opaque(_WORDS.get(node.kind, node.kind))


def _object(node: tree.Struct) -> Value:
    """An object as a struct: its value or its table with axes, its unit and description."""
    axes = _axes(node.fields.get("Breakpoints"))
    inner = node.fields.get("Table")
    if isinstance(inner, tree.Struct):
        said = {f"{letter}_unit": axis.pop("Unit", "") for letter, axis in zip(_LETTERS, axes, strict=False)}
        points = {letter: axis.get("Value", "") for letter, axis in zip(_LETTERS, axes, strict=False)}
        table = _said(inner)
        values = table.pop("Value", np.zeros((0, 0)))
        return Struct({**_filled(said), **points, **table, "values": values})
    if len(axes) == 1 and "Value" not in node.fields:
        return Struct(dict(axes[0]))
    found = _said(node)
    return Struct(dict(found)) if "Value" in found else Opaque(node.kind)


def _axes(node: tree.Node | None) -> list[dict[str, Value]]:
    elements = node.elements if isinstance(node, tree.Structs) else [node]
    return [_said(element) for element in elements if isinstance(element, tree.Struct)]


def _said(node: tree.Struct) -> dict[str, Value]:
    """What an object says to a calibration; words that are empty are left out."""
    found = {name: _value(node.fields[name]) for name in _SAID if name in node.fields}
    return _filled(found)


def _filled(found: dict[str, Value]) -> dict[str, Value]:
    return {name: value for name, value in found.items() if not isinstance(value, str) or value}
