"""Clean text files of moderate size, all at once: nothing but plain numbers, as many in each row.

Whatever else a file may hold (gaps, text, quotes, blank lines, rows of another length) is left to the exact reader,
which knows the line it stands in.
"""

import warnings

import numpy as np

from kennfeld.measurement.columns import Column, Selection, Table
from kennfeld.measurement.dialect import Dialect
from kennfeld.measurement.sniff import Source

__all__ = ["read_clean"]

_MOST = 64_000_000  # bytes, unpacked; larger files are read row by row
_NUMBERS = b"0123456789+-.eE"


def read_clean(source: Source, dialect: Dialect, selection: Selection) -> Table | None:
    """The table of a text file, or None where the exact reader has to look at it."""
    header = dialect.header
    width = len(header.names)
    if dialect.decimal != "." or dialect.separator == " " or header.width != width:
        return None
    with source.open() as stream:
        text = stream.read(_MOST + 1)
    text = text.replace(b"\r\n", b"\n")
    lines = text.split(b"\n", header.data)
    if len(text) > _MOST or b"\r" in text or len(lines) <= header.data:
        return None
    cells, separator = lines[-1].rstrip(b"\n"), dialect.separator.encode()
    count = cells.count(b"\n") + 1
    row = separator * (width - 1) + b"\n"
    if cells.translate(None, _NUMBERS) != (row * count)[:-1]:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy's word for what is no number
        try:
            values = np.fromstring(cells.replace(b"\n", b",").replace(separator, b",").decode("ascii"), sep=",")
        except (DeprecationWarning, ValueError):
            return None
    if values.size != count * width:
        return None
    table = values.reshape(count, width)
    made = tuple(
        Column(header.names[i], header.units[i], header.names[i], np.ascontiguousarray(table[:, i]))
        for i in selection.wants(header)
    )
    rows = np.arange(count) + header.data + 1
    return Table(source.name, made, rows, names=header.names, details=dialect.details)
