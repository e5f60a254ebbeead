"""Data dictionaries and model workspaces for tests, byte by byte.

workspace = mxarray({"K": 2.5, "name": "x", "P": Thing("Simulink.Parameter", {"Value": 3.0})})
dictionary = sldd({"K": entry(2.5), "P": thing("Simulink.Parameter", Value=entry(3.0))})
"""

import struct
from dataclasses import dataclass
from xml.sax.saxutils import escape

import numpy as np

from tests.importers.simulink.simulink_files import HEAD, zipped

MATRIX, CELL, STRUCT, CHAR, DOUBLE, UINT8, UINT32, UINT64, OPAQUE = 14, 1, 2, 4, 6, 9, 13, 15, 17
COMPLEX = 0x800
TAG = 0xDD000000


@dataclass(frozen=True)
class Thing:
    """An object of a class with its properties."""

    kind: str
    properties: dict


def element(kind, raw):
    return struct.pack("<II", kind, len(raw)) + raw + b"\0" * (-len(raw) % 8)


def array(kind, shape, *parts, name=""):
    head = element(6, struct.pack("<II", kind, 0)) + element(5, np.array(shape, "<i4").tobytes())
    return element(MATRIX, head + element(1, name.encode()) + b"".join(parts))


def numbers(values, kind=DOUBLE, dtype="<f8", mi=9, name=""):
    values = np.atleast_2d(np.asarray(values))
    return array(kind, values.shape, element(mi, values.astype(dtype).tobytes(order="F")), name=name)


def unsigned(values, name=""):
    kind, stored = {1: (UINT8, 2), 4: (UINT32, 6), 8: (UINT64, 13)}[values.dtype.itemsize]
    return numbers(values, kind, values.dtype.newbyteorder("<"), stored, name)


def complex_numbers(values, name=""):
    head = element(6, struct.pack("<II", DOUBLE | COMPLEX, 0)) + element(5, np.array(values.shape, "<i4").tobytes())
    parts = (element(9, part.astype("<f8").tobytes(order="F")) for part in (values.real, values.imag))
    return element(MATRIX, head + element(1, name.encode()) + b"".join(parts))


def text(value, name=""):
    return array(CHAR, (1, len(value)), element(4, value.encode("utf-16-le")), name=name)


def struct_of(fields, name=""):
    names = b"".join(key.encode().ljust(32, b"\0") for key in fields)
    return array(STRUCT, (1, 1), element(5, struct.pack("<i", 32)), element(1, names), *fields.values(), name=name)


def opaque(kind, inner, name=None):
    texts = ([name] if name is not None else []) + ["MCOS", kind]
    head = element(6, struct.pack("<II", OPAQUE, 0)) + b"".join(element(1, part.encode()) for part in texts)
    return element(MATRIX, head + inner)


class Store:
    """The table of objects that is kept behind the variables."""

    def __init__(self):
        self.names, self.classes, self.objects, self.blocks, self.cells = [], [], [], [], []

    def name(self, name):
        if name and name not in self.names:
            self.names.append(name)
        return self.names.index(name) + 1 if name else 0

    def reference(self, things):
        """The numbers of several objects of one class."""
        numbers_ = [self.add(thing) for thing in things]
        kind = self.classes.index(things[0].kind) + 1
        return [TAG, 2, len(things), 1, *numbers_, kind]

    def add(self, thing):
        if thing.kind not in self.classes:
            self.classes.append(thing.kind)
            for part in thing.kind.rpartition("."):
                self.name(part.strip("."))
        values = [(self.name(key), self.value(value)) for key, value in thing.properties.items()]
        block = [(index, 1, len(self.cells) + at) for at, (index, _) in enumerate(values)]
        self.cells += [value for _, value in values]
        self.blocks.append(block)
        self.objects.append(self.classes.index(thing.kind) + 1)
        return len(self.objects)

    def value(self, value, name=""):
        if isinstance(value, str):
            return text(value, name)
        if isinstance(value, dict):
            return struct_of({key: self.value(inner) for key, inner in value.items()}, name)
        if isinstance(value, Thing) or (isinstance(value, list) and value and isinstance(value[0], Thing)):
            things = value if isinstance(value, list) else [value]
            return numbers(np.array([self.reference(things)]).T, UINT32, "<u4", 6, name)
        if isinstance(value, tuple):
            return array(CELL, (1, len(value)), *map(self.value, value), name=name)
        if isinstance(value, np.ndarray) and value.dtype.kind in "uc":
            return complex_numbers(value, name) if value.dtype.kind == "c" else unsigned(value, name)
        return numbers(value, name=name)

    def written(self, defaults=None, version=4):
        """The bytes of the subsystem; versions before 4 (R2021a has 3) know two regions less."""
        names = b"".join(name.encode() + b"\0" for name in self.names)
        names += b"\0" * (-(40 + len(names)) % 8)
        classes = [0] * 4
        for kind in self.classes:
            package, _, name = kind.rpartition(".")
            classes += [self.name(package), self.name(name), 0, 0]
        objects = [0] * 6
        for number, kind in enumerate(self.objects, 1):
            objects += [kind, 0, 0, 0, number, number]
        blocks = [0, 0]
        for block in self.blocks:
            blocks += [len(block), *(n for row in block for n in row)]
            blocks += [0] * (len(blocks) % 2)
        regions = [classes, [0, 0], objects, blocks, [0, 0]]
        offsets = [40 + len(names)]
        for region in regions:
            offsets.append(offsets[-1] + 4 * len(region))
        offsets += [offsets[-1] if version > 3 else 0] * (8 - len(offsets))
        words = struct.pack("<II8I", version, len(self.names), *offsets) + names
        table = words + np.array([word for region in regions for word in region], "<i4").tobytes()
        last = [numbers(np.zeros((0, 0)))]
        last += [
            struct_of({key: self.value(v) for key, v in (defaults or {}).get(kind, {}).items()})
            for kind in self.classes
        ]
        cells = [
            numbers(np.frombuffer(table, np.uint8)[:, None], UINT8, "u1", 2),
            numbers(np.zeros((0, 0))),
            *self.cells,
        ]
        cells += [numbers(np.zeros((0, 0)))] * 2 + [array(CELL, (len(last), 1), *last)]
        wrapper = opaque("FileWrapper__", array(CELL, (len(cells), 1), *cells))
        return b"\0\1IM\0\0\0\0" + struct_of({"MCOS": wrapper})


def mxarray(variables, defaults=None, version=4):
    """A model workspace: the bytes of a `.mxarray` part."""
    store, fields = Store(), {}
    for name, value in variables.items():
        if isinstance(value, Thing):
            reference = np.array([store.reference([value])]).T
            fields[name] = opaque(value.kind, numbers(reference, UINT32, "<u4", 6))
        else:
            fields[name] = store.value(value)
    raw = b"\0\1IM\0\0\0\0" + struct_of(fields)
    if store.objects:
        raw += numbers(np.frombuffer(store.written(defaults, version), np.uint8)[:, None], UINT8, "u1", 2)
    return raw


def matfile(variables):
    """A data file with objects among its variables: the subsystem stands behind them, without a name."""
    store, parts = Store(), []
    for name, value in variables.items():
        if isinstance(value, Thing):
            reference = np.array([store.reference([value])]).T
            parts.append(opaque(value.kind, numbers(reference, UINT32, "<u4", 6), name))
        else:
            parts.append(store.value(value, name))
    parts.append(numbers(np.frombuffer(store.written(), np.uint8)[:, None], UINT8, "u1", 2))
    return b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\0\1IM" + b"".join(parts)


def pairs(variables):
    """A model workspace as classic files hold it: structs with a name and a value each."""
    names = b"".join(key.encode().ljust(6, b"\0") for key in ("Name", "Value"))
    values = [part for name, value in variables.items() for part in (text(name), Store().value(value))]
    head = (element(5, struct.pack("<i", 6)), element(1, names))
    return b"\0\1IM\0\0\0\0" + array(STRUCT, (len(variables), 1), *head, *values)


def entry(value, kind="", name="Value"):
    """A property of a data dictionary: numbers column by column, texts, structs, cells."""
    if isinstance(value, str):
        return f'<P Name="{name}" Class="{kind or "char"}">{escape(value)}</P>'
    if isinstance(value, dict):
        inside = "".join(entry(inner, name=key) for key, inner in value.items())
        return f'<P Name="{name}" Class="struct"><Element>{inside}</Element></P>'
    values = np.atleast_2d(np.asarray(value, dtype=float))
    size = "" if values.shape == (1, 1) else f' Dimension="{"*".join(map(str, values.shape))}"'
    written = " ".join(f"{number!r}" for number in values.ravel(order="F").tolist())
    return (
        f'<P Name="{name}" Class="{kind or "double"}"{size}>{written.replace("inf", "Inf").replace("nan", "NaN")}</P>'
    )


def thing(kind, name="Value", **properties):
    """A property that is an object."""
    inside = "".join(
        value if isinstance(value, str) and value.startswith("<P") else entry(value, name=key)
        for key, value in properties.items()
    )
    return f'<P Name="{name}"><Element Class="{kind}">{inside}</Element></P>'


def sldd(entries, references=()):
    """The bytes of a data dictionary; `entries` are names with the text of their values."""
    inside = "".join(
        f'<Object Class="DD.ENTRY"><P Name="Name" Class="char">{name}</P>{value}</Object>\n'
        for name, value in entries.items()
    )
    inside += "".join(
        f'<Object Class="DD.DICTIONARYREFERENCE"><P Name="Subdictionary" Class="char">{name}</P></Object>'
        for name in references
    )
    source = f'{HEAD}<DataSource FormatVersion="1" MinRelease="R2014a" Arch="glnxa64">{inside}</DataSource>'
    return zipped({"data/chunk0.xml": source, "metadata/mwcoreProperties.xml": "<a/>"})
