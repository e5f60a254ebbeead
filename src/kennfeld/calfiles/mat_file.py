"""MATLAB data files (.mat), versions 4 to 7.3, as calibrations; objects such as Simulink.Parameter included."""

import re

import numpy as np

from kennfeld.calfiles.format import Content, Notes, Source
from kennfeld.calfiles.matlab_plain import plain_of
from kennfeld.calfiles.matlab_values import Struct, Value, holds_samples, parameters_of
from kennfeld.errors import InputError
from kennfeld.matlab.data import nodes_of, value_of

__all__ = ["is_calibration_mat", "read_mat", "recognises_mat"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_MOST_BYTES = 200_000_000  # unpacked
_OLD_TYPES = 6  # of numbers, in version 4
_OLD_NAME = re.compile(rb"[A-Za-z]\w{0,62}\0")


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
        return version, {name: plain_of(value_of(node)) for name, node in nodes.items()}
    mend = "The file may be cut off or damaged: save it anew in MATLAB."
    raise InputError.of(source.name, f"cannot be read as MATLAB data: {what}", mend) from None
