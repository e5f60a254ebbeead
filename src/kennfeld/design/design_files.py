"""Files of designs: lists of points, segments and recordings, and time tables of planned manoeuvres."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.atomic_files import replace_atomically, write_whole
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.design.manoeuvres import TimeTable
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.measurement.writable_recording import WritableRecording
from kennfeld.project.csv_cells import neutral_cell

ENDINGS = (".csv", ".xlsx", ".parquet", ".mf4", ".json")
SHEET_NAME, SHEET_ROWS = 31, 1_048_576  # the most characters and rows in Excel
Columns = Mapping[str, NDArray[Any]]


def require_design_format(path: Path) -> None:
    """Raise `InputError` if the extension is not that of a design, or the package that writes it is missing."""
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        message = f"must have the extension {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}, got {ending or 'none'}"
        raise InputError.of(Location(str(path)), message)
    if ending == ".mf4":
        from kennfeld.measurement.mdf_writer import require_library

        require_library(path)


def write_tables(
    path: Path, tables: Mapping[str, Columns], planned: Sequence[TimeTable], content: Any, *, follow: bool = False
) -> Path:
    """Write the tables of a design in the format of the extension.

    Args:
        path: the file; its folder is created.
        tables: columns by the name of each table.
        planned: what an .mf4 has, set values over time.
        content: what a .json has.
        follow: a symbolic link stays one; otherwise it is replaced.

    Raises:
        InputError: the extension is unknown, a table does not fit the format, or the file cannot be written.
    """
    require_design_format(path)
    ending, place = path.suffix.lower(), Location(str(path))
    longest = max((len(next(iter(columns.values()))) for columns in tables.values()), default=0)
    if ending == ".mf4" and not planned:
        message = "a list of segments or recordings has no time, which .mf4 requires"
        raise InputError.of(place, message, "Name a .csv, .xlsx, .parquet or .json file with -o.")
    if ending == ".xlsx" and longest >= SHEET_ROWS:
        message = f"a sheet has {SHEET_ROWS} rows, too few for {longest} and a heading"
        raise InputError.of(place, message, "Name a .csv or .parquet file with -o.")
    with convert_errors(path, "cannot be written", "Name another file with -o."):
        path.parent.mkdir(parents=True, exist_ok=True)
        if ending == ".json":
            write_whole(path, json.dumps(content, indent=2), follow=follow)
            return path
        with replace_atomically(path, follow=follow) as beside:
            if ending == ".mf4":
                _write_mdf(planned, beside)
            elif ending == ".xlsx":
                _write_workbook(tables, beside)
            else:
                _write_table(_joined(tables), beside, ending)
    return path


def _joined(tables: Mapping[str, Columns]) -> Columns:
    """Return tables of equal columns one after the other, with the name of each; a single one as it is."""
    if len(tables) == 1:
        return next(iter(tables.values()))
    names = list(dict.fromkeys(name for columns in tables.values() for name in columns))
    sizes = {name: len(next(iter(columns.values()))) for name, columns in tables.items()}
    joined: dict[str, NDArray[Any]] = {"table": np.repeat(list(tables), list(sizes.values()))}
    for name in names:
        parts = [columns.get(name, np.full(sizes[table], np.nan)) for table, columns in tables.items()]
        joined[name] = np.concatenate(parts)
    return joined


def _write_table(columns: Columns, path: Path, ending: str) -> None:
    import pyarrow as pa
    from pyarrow import csv, parquet

    text = neutral_cell if ending == ".csv" else str
    table = pa.table(
        {
            text(name): [text(cell) for cell in values.tolist()] if values.dtype.kind == "U" else values
            for name, values in columns.items()
        }
    )
    if ending == ".csv":
        csv.write_csv(table, path)
    else:
        parquet.write_table(table, path)


def _write_workbook(tables: Mapping[str, Columns], path: Path) -> None:
    import xlsxwriter

    with xlsxwriter.Workbook(path, {"strings_to_formulas": False, "strings_to_urls": False}) as book:
        for number, (name, columns) in enumerate(tables.items(), 1):
            clean = "".join("_" if letter in "[]:*?/\\'" else letter for letter in name)
            sheet = book.add_worksheet(f"{number} {clean}"[:SHEET_NAME])
            for at, (head, values) in enumerate(columns.items()):
                sheet.write_string(0, at, head)
                sheet.write_column(1, at, values.tolist())


def _write_mdf(planned: Sequence[TimeTable], path: Path) -> None:
    from kennfeld.measurement.mdf_writer import write_mdf

    write_mdf(map(_recording, planned), path, "Planned by kennfeld design")


def set_value_table(columns: Mapping[str, NDArray[Any]], ramp: NDArray[Any], wait: NDArray[Any]) -> TimeTable:
    """Return points as set values over time: a ramp to each, at least 1 ms, then its wait."""
    ramps, waits = np.maximum(ramp, 1e-3), np.maximum(wait, 1e-3)
    arrivals = np.cumsum(ramps + waits) - waits
    time = np.column_stack([arrivals, arrivals + waits]).ravel()
    return TimeTable("points", time - time[0], {name: np.repeat(values, 2) for name, values in columns.items()})


def _recording(table: TimeTable) -> WritableRecording:
    channels = tuple(Channel(name, values) for name, values in table.columns.items())
    data = Dataset(table.name, channels, time=table.time)
    return WritableRecording(table.name, table.name, "training", "", None, [data], [np.zeros(data.samples, np.int64)])
