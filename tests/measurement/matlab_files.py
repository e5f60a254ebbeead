"""Writes MATLAB files: version 7.3 as MATLAB lays it out in HDF5, and single elements of version 5."""

import struct

import h5py
import numpy as np

HEAD = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan 1 2024 HDF5 schema 1.00 ."
_CLASSES = {
    "f8": "double",
    "f4": "single",
    "b1": "logical",
    "i4": "int32",
    "u1": "uint8",
    "u2": "uint16",
    "u4": "uint32",
    "u8": "uint64",
}


def save73(path, variables):
    """A file of version 7.3: dicts become structs, lists of dicts struct arrays, tuples cell arrays, at any depth."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _write(file, name, value)
    with path.open("r+b") as stream:
        stream.write(HEAD.ljust(116) + b"\0" * 8 + b"\x00\x02IM")


def _write(group, name, value):
    """Write a value as a member of a group."""
    if isinstance(value, dict):
        _write_struct(group, name, value)
    elif isinstance(value, list):
        _write_structs(group, name, value)
    elif isinstance(value, tuple):
        _write_cells(group, name, value)
    else:
        _write_array(group, name, value)


def _write_struct(group, name, fields):
    member = group.create_group(name)
    _call(member, "struct")
    for field, value in fields.items():
        _write(member, field, value)


def _write_structs(group, name, elements):
    member = group.create_group(name)
    _call(member, "struct")
    for field in elements[0]:
        member[field] = _references(member, field, [element[field] for element in elements])


def _write_cells(group, name, cells):
    group[name] = _references(group, name, cells)
    _call(group[name], "cell")


def _call(item, kind):
    """Name the class of a member."""
    item.attrs["MATLAB_class"] = np.bytes_(kind)


def _references(group, name, values):
    """The references of values that stand in a group of their own, each called by its place in the file."""
    store = group.file.require_group("#refs#")
    owner = f"{group.name}/{name}".replace("/", ".")
    references = []
    for number, value in enumerate(values):
        _write(store, f"{owner}.{number}", value)
        references.append(store[f"{owner}.{number}"].ref)
    return np.array(references, dtype=h5py.ref_dtype).reshape(-1, 1)  # a row, turned around


def _write_array(group, name, value):
    if isinstance(value, str):
        codes = np.array([[ord(c)] for c in value], dtype=np.uint16)
        group[name] = codes if value else np.zeros(2, dtype=np.uint64)
        _call(group[name], "char")
        if not value:
            group[name].attrs["MATLAB_empty"] = np.uint8(1)
        return
    array = np.atleast_2d(value)
    if array.dtype.kind == "c":
        pairs = np.zeros(array.T.shape, [("real", "f8"), ("imag", "f8")])
        pairs["real"], pairs["imag"] = array.T.real, array.T.imag
        group[name] = pairs
        _call(group[name], "double")
        return
    group[name] = array.T.astype(np.uint8) if array.dtype == bool else array.T
    _call(group[name], _CLASSES[array.dtype.str[1:]])


def element(kind, content):
    """An element of version 5: type, size, content, padding."""
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def array5(kind, content, name=b"", shape=(1, 1)):
    """An array of a class, around the elements that it holds."""
    flags, dimensions = struct.pack("<II", kind, 0), struct.pack(f"<{len(shape)}i", *shape)
    return element(14, element(6, flags) + element(5, dimensions) + element(1, name) + content)


def opaque5(name, kind):
    """An object that only MATLAB reads."""
    texts = element(1, name) + element(1, b"MCOS") + element(1, kind)
    return element(14, element(6, struct.pack("<II", 17, 0)) + texts + array5(13, element(6, b"\1\0\0\0")))


def file5(*elements):
    """A file of version 5."""
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x100, 0x4D49) + b"".join(elements)
