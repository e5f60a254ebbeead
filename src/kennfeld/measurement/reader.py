"""Read any measurement file: detect its kind by its content and call the reader of that kind."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from kennfeld.base.errors import ArgumentError, Finding, InputError
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.streams import Source, local_file, stream_name
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.file_spans import FileSpans
from kennfeld.files.file_format import Role, call
from kennfeld.files.formats import ZIP_ARCHIVE, recording_formats
from kennfeld.files.head import FileHead
from kennfeld.files.identification import identify_head
from kennfeld.files.unpacking import choose_member, unpacked
from kennfeld.measurement.bus_databases import AnyDatabase, DatabaseFile, to_databases
from kennfeld.measurement.channel_groups import join_groups, split_timelines
from kennfeld.measurement.dataset_tables import table_of
from kennfeld.measurement.epochs import with_epochs
from kennfeld.measurement.fine_clocks import with_fine_clocks
from kennfeld.measurement.fraction_columns import with_days, with_fractions
from kennfeld.measurement.source import MeasurementFile, locate, locate_head, run_guarded
from kennfeld.measurement.table import Selection, Table, with_word_warnings, without_infinite
from kennfeld.measurement.table_conversion import Description, TableDescription, assemble, describe_table
from kennfeld.measurement.time_column import drop_untimed, with_date_doubts, with_unread_time


def read(
    path: Source,
    channels: Sequence[str] | None = None,
    raster: float | None = None,
    *,
    sheet: str | None = None,
    units: Mapping[str, str] | None = None,
    dbc: AnyDatabase | Iterable[AnyDatabase] = (),
) -> Dataset:
    """Read a measurement file, recognised by its content: CSV, Excel, Parquet, MDF, MATLAB, HDF5, TDMS, ...

    A time column becomes the dataset's time, in seconds; without one the samples are steady-state points. Columns
    without a name and columns of text are skipped. Channels of different rasters need a `raster`; they are read over
    the time they share. Infinite values become NaN; the dataset's `findings` count them.

    Args:
        path: the file, or an open stream such as `io.BytesIO`; a sheet of a workbook may be named after a `#`,
            `bench.xlsx#Data`.
        channels: the channels to read, in any order; all by default.
        raster: step in s; resamples to even time stamps, linearly between valid samples (channels that jump between
            levels are held), without extrapolation.
        sheet: the sheet of a workbook.
        units: units of columns for which the file has none or a wrong one. That of the time column, such as `ms`,
            converts it to seconds; numbers of other columns stay.
        dbc: the CAN databases of a bus log (MDF, ASC, BLF, TRC, candump): files, `engine.dbc@1` for channel 1 alone,
            or mappings with `file`, `bus` and `network`. Signals are named `Speed`, or `Message.Speed` if several
            messages have one.

    Returns:
        The recording. Its channels are Float[samples], in the units of the file.

    Raises:
        InputError: the file cannot be read; reports all problems, with lines and columns.
        ArgumentError: the raster is not a positive number, or `channels` is a single name.

    >>> data = read("bench.csv", ["Speed", "Torque"])
    >>> data.samples, data["Torque"].unit
    (2812, 'Nm')
    """
    if raster is not None and not (raster > 0 and math.isfinite(raster)):
        raise ArgumentError(f"raster={raster} must be a time in s > 0")
    if isinstance(channels, str):
        raise ArgumentError(f"channels={channels!r} must be a list of names; write [{channels!r}]")
    with local_file(path) as file, _readable(file, sheet, to_databases(dbc)) as source:
        recording = _read(source, channels, raster, units or {}, strict=True)
    whole = str(path) if isinstance(path, str | Path) else stream_name(path)
    name = f"{whole}#{sheet}" if sheet else whole
    return replace(recording, files=FileSpans.joined([name], [recording.samples], [recording.start_time]))


def read_leniently(
    path: str | Path,
    channels: Sequence[str] | None,
    raster: float | None,
    units: Mapping[str, str],
    databases: tuple[DatabaseFile, ...] = (),
) -> Dataset:
    """Read a file as `read` does, but ignore units of columns that it lacks, since other files may have them."""
    with _readable(path, None, databases) as source:
        return _read(source, channels, raster, units, strict=False)


def _read(
    source: MeasurementFile,
    channels: Sequence[str] | None,
    raster: float | None,
    units: Mapping[str, str],
    *,
    strict: bool,
) -> Dataset:
    selection = Selection(None if channels is None else tuple(dict.fromkeys(channels)), dict(units))
    tables = [table.with_units(units) for table in _read_tables(source, selection)]
    if strict:
        _check_stated(source, tables, selection)
    if not source.reader.rasters:
        tables = split_timelines(_single_table(source, tables), selection)
    # after the split, as each timeline has a clock of its own
    tables = with_fine_clocks(tables, selection)
    if not source.reader.rasters and len(tables) == 1:
        return assemble(tables[0], source.stem, selection, raster)
    return join_groups(source.location, tables, source.stem, selection, raster)


def _check_stated(source: MeasurementFile, tables: Sequence[Table], selection: Selection) -> None:
    """Refuse units for columns that are not there."""
    names = dict.fromkeys(name for table in tables for name in table.names if name)
    names |= dict.fromkeys(table.clock.name for table in tables if table.clock is not None)
    location = source.location.within("units")
    missing = [name for name in selection.units if name not in names]
    if missing:
        raise InputError(Finding(location, f"has no column {name}", nearest(name, names)) for name in missing)


def describe(path: str | Path, dbc: AnyDatabase | Iterable[AnyDatabase] = ()) -> Description:
    """Return the tables, channels, units, ranges and time of a measurement file; `dbc` as in `read`.

    >>> describe("bench.csv").tables[0].channels[0].unit
    'rpm'
    """
    with _readable(path, None, to_databases(dbc)) as source:
        return _describe(source)


def _describe(source: MeasurementFile) -> Description:
    if source.reader.rasters:
        descriptions = run_guarded(source.name, lambda: _descriptions_of(source))
        return Description(source.name, source.format.name, descriptions)
    tables = _read_tables(source, Selection())
    errors = [error for table in tables for error in table.errors]
    if errors:
        raise InputError(errors)
    parts = [p for table in tables for p in with_fine_clocks(split_timelines(table, Selection()), Selection())]
    return Description(source.name, source.format.name, tuple(describe_table(part) for part in parts))


def list_columns(path: str | Path) -> list[str] | None:
    """Return the names of the columns of a text file; None for other kinds, which must be read to list them.

    Raises:
        InputError: the file cannot be read or holds no table.
    """
    with _readable(path, None) as source:
        if not source.reader.columns:
            return None
        names: list[str] = run_guarded(source.name, lambda: call(source.reader.columns, source))
        return names


@contextmanager
def _readable(
    path: str | Path, sheet: str | None, databases: tuple[DatabaseFile, ...] = ()
) -> Iterator[MeasurementFile]:
    """Yield a file that a reader can open; raise `InputError` if there is none for its kind."""
    whole, head = locate_head(path, sheet)
    is_archive = whole.format is ZIP_ARCHIVE
    if not is_archive and (not head.packing or (whole.packed and whole.reader.unpacks)):
        _check(whole)
        yield replace(whole, databases=databases)
        return
    member = (whole.sheet or "") if is_archive else ""
    with unpacked(head, member, with_others=is_archive and _has_companions(head, member)) as (inner, label):
        source = locate(inner, None if is_archive else whole.sheet)
        source = replace(source, label=label, packed_size=head.path.stat().st_size, databases=databases)
        if source.packed or source.format is ZIP_ARCHIVE:
            message = f"{inner.name} in it is compressed as well"
            raise InputError.of(whole.location, message, "Unpack it first.")
        _check(source)
        yield source


def _has_companions(archive: FileHead, member: str) -> bool:
    """Return whether the values of the recording in an archive are in other files beside it."""
    reader = identify_head(archive.head_of(choose_member(archive, member)), Role.RECORDING).format.recording
    return reader is not None and bool(reader.companions)


def _check(source: MeasurementFile) -> None:
    """Raise `InputError` if a file is of a format that holds no recordings, or if it lacks the sheet."""
    known = source.format
    if known.recording is None:
        readable = ", ".join(each.name for each in recording_formats())
        tail = "" if known.remedy else ", which cannot be read as a measurement"
        remedy = known.remedy or f"Export it as MDF (.mf4) or CSV; {readable} can be read."
        raise InputError.of(source.location, f"this is {known.phrase}{tail}", remedy)
    if source.sheet is not None and not known.recording.has_sheets:
        message = f"sheet {source.sheet} is requested, but {known.phrase} has no sheets"
        raise InputError.of(source.location, message, "Omit the sheet.")


def _read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    tables: list[Table] = run_guarded(source.name, lambda: _tables_of(source, selection))
    tables = [with_word_warnings(without_infinite(table)) for table in tables]
    if source.databases and not source.reader.decodes and tables:
        tables[0] = replace(tables[0], findings=(*tables[0].findings, _undecoded(source)))
    if source.reader.may_lack_time:
        tables = [drop_untimed(table) for table in tables]
    if source.reader.rasters:
        return tables
    tables = [with_fractions(with_days(with_epochs(table, selection))) for table in tables]
    return [with_date_doubts(with_unread_time(table)) for table in tables]


def _undecoded(source: MeasurementFile) -> Finding:
    """Return that databases do not matter for a file, which may be a log in a form that is not known."""
    message = f"is not a log of bus frames but {source.format.phrase}, so no database decodes it"
    remedy = "Omit dbc if it holds measured channels, else export it as MF4, BLF or ASC."
    return Finding(source.location, message, remedy, severity="warning")


def _descriptions_of(source: MeasurementFile) -> tuple[TableDescription, ...]:
    if source.reader.descriptions:
        return tuple(call(source.reader.descriptions, source))
    return tuple(describe_table(table) for table in _tables_of(source, Selection()))


def _tables_of(source: MeasurementFile, selection: Selection) -> list[Table]:
    if source.reader.dataset:
        return [table_of(call(source.reader.dataset, source.path), source)]
    tables: list[Table] = call(source.reader.tables, source, selection)
    return tables


def _single_table(source: MeasurementFile, tables: Sequence[Table]) -> Table:
    """Return the single table; raise `InputError` with a list if there are several."""
    if len(tables) == 1:
        return tables[0]
    findings = []
    for table in tables:
        names = join_names([name for name in table.names if name], 6)
        sheet = dict(table.details).get("sheet", "")
        message = f"{table.rows.size} rows of {names}; several sheets hold tables and none is selected"
        findings.append(Finding(table.location, message, f"Write {source.name}#{sheet} to select it."))
    raise InputError(findings)
