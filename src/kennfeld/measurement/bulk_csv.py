"""Reader of large and clean text files through the C parser of pandas.

Anything unusual (text among numbers, rows of another length, blank lines) is left to the exact reader, which knows the
line of each cell.
"""

import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.measurement.cells import MISSING, TRUTH, is_stamp, parse_number
from kennfeld.measurement.csv_dialect import Dialect, is_comment, split_line
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.table import Column, Selection, Table

_CHUNK = 1 << 24
_SAMPLE = 200  # lines


def read_bulk(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table | None:
    """Return the table of a text file; None if the exact reader is required."""
    if dialect.encoding == "utf-16":
        return None
    sample = _sample(source, dialect)
    cells = [split_line(line, dialect.separator) for line in sample or ()]
    if sample is None or len({len(row) for row in cells}) != 1 or any(map(is_comment, sample)):
        return None
    width = len(cells[0])
    if width < dialect.header.width:
        return None
    kinds = {i: _kind([row[i] for row in cells], dialect) for i in range(width)}
    wanted = [i for i in selection.wants(dialect.header) if i < width]
    numeric = [i for i in wanted if kinds[i] is not None]
    if selection.channels is not None and numeric != wanted:
        return None
    if any(is_stamp(cells[0][i]) for i in wanted if i not in numeric):
        return None
    frame = _frame(source, dialect, sample, kinds)
    return None if frame is None else _table(source, dialect, frame, numeric)


def _kind(cells: list[str], dialect: Dialect) -> str | None:
    """Return the type that the column seems to hold: `float`, `bool`, or None for text."""
    if any(parse_number(cell, dialect.decimal) is None for cell in cells):
        return None
    return "bool" if any(cell.strip().casefold() in TRUTH for cell in cells) else "float"


def _sample(source: MeasurementFile, dialect: Dialect) -> list[str] | None:
    """Return the first lines of numbers; None if a cell above spans several lines, which pandas would miscount."""
    with source.open() as stream:
        head = [stream.readline(_CHUNK) for _ in range(dialect.header.data)]
        lines = [stream.readline(_CHUNK) for _ in range(_SAMPLE)]
    if any(line.count(b'"') % 2 for line in head):
        return None
    return [line.decode(dialect.encoding, "replace").rstrip("\r\n") for line in lines if line]


def _frame(source: MeasurementFile, dialect: Dialect, sample: list[str], kinds: dict[int, str | None]) -> Any:
    """Return all columns: only when pandas reads each of them does it complain of a row with too many cells.

    Their types are left to pandas, which is a third faster than when it is told that they are floating-point numbers.
    """
    import pandas as pd

    options: dict[str, Any] = {"float_precision": "round_trip"} if int(pd.__version__.split(".")[0]) < 3 else {}
    if "bool" in kinds.values():  # each of these options costs a fifth of the time
        options["true_values"] = _spelt(word for word, value in TRUTH.items() if value)
        options["false_values"] = _spelt(word for word, value in TRUTH.items() if not value)
    if any(f"{dialect.separator} " in line for line in sample):
        options["skipinitialspace"] = True
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return pd.read_csv(
                source.path,  # by path: pandas decodes what it reads from an open file
                compression="gzip" if source.packed else None,
                sep=r"\s+" if dialect.separator == " " else dialect.separator,
                decimal=dialect.decimal,
                header=None,
                skiprows=dialect.header.data,
                names=range(len(kinds)),
                index_col=False,
                keep_default_na=False,
                na_values=_spelt(MISSING),
                skip_blank_lines=False,
                encoding=dialect.encoding.removesuffix("-sig"),
                encoding_errors="replace",
                **options,
            )
        except (ValueError, OverflowError):  # pandas' own errors are ValueErrors
            return None


def _spelt(words: Iterable[str]) -> list[str]:
    """Return the words as files spell them; pandas compares them letter by letter."""
    return sorted({spelt for word in words for spelt in (word, word.upper(), word.title(), word.replace("nan", "NaN"))})


def _table(source: MeasurementFile, dialect: Dialect, frame: Any, numeric: list[int]) -> Table | None:
    if any(frame[i].dtype.kind not in "fbiu" for i in numeric):
        return None
    last = frame[dialect.header.width - 1].isna().to_numpy()
    kept = last.size - _blank_end(source, dialect)
    if last[:kept].any() and not _even(source, dialect, kept, frame.shape[1]):
        return None
    values = {i: frame[i].to_numpy(dtype=np.float64)[:kept] for i in numeric}
    if not kept or _empty_rows(list(values.values())):
        return None
    rows = np.arange(kept) + dialect.header.data + 1
    names, units = dialect.header.names, dialect.header.units
    columns = tuple(Column(names[i], units[i], names[i], column) for i, column in values.items())
    return Table(source.name, columns, rows, names=names, details=dialect.details)


def _blank_end(source: MeasurementFile, dialect: Dialect) -> int:
    """Return the number of blank lines at the end of the file, without the empty text after the last line end."""
    if source.packed:
        return 0
    with source.open() as stream:
        stream.seek(max(source.size - 4096, 0))
        tail = stream.read().decode(dialect.encoding, "replace")
    lines = tail.replace("\r\n", "\n").removesuffix("\n").split("\n")
    count = 0
    while count < len(lines) and not lines[-1 - count].strip():
        count += 1
    return count


def _even(source: MeasurementFile, dialect: Dialect, rows: int, width: int) -> bool:
    """Return whether the file has exactly the separators of complete rows, so that gaps are not short rows."""
    if dialect.separator == " ":
        return False
    separator, count = ord(dialect.separator), 0
    with source.open() as stream:
        for _ in range(dialect.header.data):
            stream.readline(_CHUNK)
        while chunk := stream.read(_CHUNK):
            if b'"' in chunk:
                return False
            count += int(np.count_nonzero(np.frombuffer(chunk, np.uint8) == separator))  # bytes.count is 7x slower
    return count == rows * (width - 1)


def _empty_rows(columns: list[Float]) -> bool:
    empty = np.ones(columns[0].size if columns else 0, dtype=bool)
    for column in columns:
        if not empty.any():
            return False
        empty &= np.isnan(column)
    return bool(empty.any())
