"""Reader of MATLAB files (versions 4 to 7.3) as measurements: vectors with a time, structs, matrices."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.formatting import join_names
from kennfeld.matlab import mat_v4, mat_v5, mat_v73
from kennfeld.matlab.mat_nodes import MatFileError, Node
from kennfeld.measurement.file_kind import FileKind, MeasurementFile, locate
from kennfeld.measurement.matlab_signals import MatlabSignals, RecordedSignal, TimeBase, find_signals
from kennfeld.measurement.table import Column, Selection, Table, unique_names
from kennfeld.measurement.table_conversion import TableDescription, describe_table

_TIME = "time"
_MAX_LISTED = 8  # variables in a message
_PLAIN = (
    "In MATLAB, save its values as plain vectors or in a struct, beside a vector `time`; "
    "table2struct(T, ToScalar=true) makes one of a table."
)


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each time in the file that has a requested channel."""
    return _tables(source, _found(source), selection)


def _tables(source: MeasurementFile, found: MatlabSignals, selection: Selection) -> list[Table]:
    names = _names(found.clocks)
    chosen = _chosen(source.name, found, names, selection)
    tables = [_table(source, clock, chosen, found, names) for clock in found.clocks]
    wanted = [table for table in tables if len(table.columns) > (table.clock is not None)]
    return wanted or tables[:1]


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each time base, with the names of skipped variables."""
    found = _found(source)
    first, *others = _tables(source, found, Selection())
    return [describe_table(table) for table in (_remarked(first, found), *others)]


def holds_samples(path: str | Path) -> bool:
    """Return whether a MATLAB file holds channels over time, rather than parameters; `InputError` where it is damaged.

    >>> holds_samples("bench.mat")  # doctest: +SKIP
    True
    """
    return any(clock.values is not None for clock in _all(locate(path)).clocks)


def _all(source: MeasurementFile) -> MatlabSignals:
    file = "HDF5 file" if source.kind is FileKind.HDF5 else "MATLAB file"
    try:
        return find_signals(_variables(source))
    except MatFileError as error:
        message = f"the {file} is damaged: {error}"
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library for version 7.3 trusts what it reads
        message = f"the {file} is damaged or cut off ({' '.join(str(error).split())[:160] or type(error).__name__})"
    raise InputError.of(source.name, message, "Save it again.")


def _variables(source: MeasurementFile) -> dict[str, Node]:
    with source.open() as stream:
        start = stream.read(9)
    if source.kind is FileKind.HDF5 and not mat_v73.is_matlab(source.path):
        message = "this is an HDF5 file, but not one of MATLAB"
        raise InputError.of(source.name, message, "Export it as MDF, CSV or Parquet.")
    if source.kind is FileKind.HDF5 or start == b"MATLAB 7.":
        return mat_v73.load(source.path)
    content = memoryview(np.memmap(source.path, np.uint8, mode="r"))  # type: ignore[arg-type]
    return mat_v5.load(content) if start.startswith(b"MATLAB") else mat_v4.load(content)


def _found(source: MeasurementFile) -> MatlabSignals:
    """Return the channels of the file; a finding where there are none."""
    found = _all(source)
    if found.clocks:
        return found
    if found.unreadable and not found.loose:
        message = f"only MATLAB can read its variables: {_listed(found.unreadable)}"
        raise InputError.of(source.name, message, _PLAIN)
    if found.loose:
        sizes = {path: " x ".join(map(str, shape)) for path, shape in found.loose.items()}
        message = f"found neither a time vector nor vectors of equal length: {_listed(sizes)}"
        raise InputError.of(source.name, message, "Save a vector `time`, in seconds, as long as the channels.")
    raise InputError.of(source.name, "holds no vectors", "Is it the right file?")


def _listed(said: dict[str, str]) -> str:
    return join_names([f"{path} ({message})" for path, message in said.items()], _MAX_LISTED)


def _names(clocks: Sequence[TimeBase]) -> dict[RecordedSignal, str]:
    """Return the name of each channel: its last part, or its path where others are called the same."""
    signals = [signal for clock in clocks for signal in clock.signals]
    count = Counter([_TIME, *(signal.name for signal in signals)])
    names = [signal.name if count[signal.name] == 1 else signal.path for signal in signals]
    return dict(zip(signals, unique_names([_TIME, *names])[1:], strict=True))


def _chosen(
    place: str, found: MatlabSignals, names: dict[RecordedSignal, str], selection: Selection
) -> dict[RecordedSignal, str]:
    """Return the requested channels, by their name or their path, with the name to give them."""
    if selection.channels is None:
        return names
    chosen: dict[RecordedSignal, str] = {}
    findings = []
    for asked in selection.channels:
        meant = [s for s, name in names.items() if name == asked] or [s for s in names if asked in (s.path, s.name)]
        if len(meant) == 1:
            chosen[meant[0]] = asked
        elif meant:
            listed = ", ".join(names[signal] for signal in meant[:_MAX_LISTED])
            findings.append(Finding(place, f"{len(meant)} channels are named {asked}", f"Name one of them: {listed}."))
        elif asked in found.unreadable:
            findings.append(Finding(place, f"{asked} ({found.unreadable[asked]}) can only be read by MATLAB", _PLAIN))
        elif asked in found.loose:
            size = " x ".join(map(str, found.loose[asked]))
            remedy = "Save it with a vector `time` of its length."
            findings.append(Finding(place, f"{asked} is of size {size}, but no time vector has that length", remedy))
    if findings:
        raise InputError(findings)
    return chosen


def _table(
    source: MeasurementFile,
    clock: TimeBase,
    chosen: dict[RecordedSignal, str],
    found: MatlabSignals,
    names: dict[RecordedSignal, str],
) -> Table:
    own = [signal for signal in clock.signals if signal in chosen]
    columns = [Column(chosen[s], s.unit, chosen[s], s.values, held=s.held, description=s.description) for s in own]
    time = None if clock.values is None else Column(_TIME, clock.unit, _TIME, clock.values)
    several = len(found.clocks) > 1
    return Table(
        f"{source.name} {clock.path}" if several else source.name,
        (*(() if time is None else (time,)), *columns),
        np.arange(1, clock.signals[0].values.size + 1),
        "sample",
        (*(() if time is None else (_TIME,)), *(chosen.get(s, names[s]) for s in clock.signals)),
        details=(("group", clock.path),) if several else (),
        clock=time,
    )


def _remarked(table: Table, found: MatlabSignals) -> Table:
    sizes = {path: " x ".join(map(str, shape)) for path, shape in found.loose.items()}
    more = [
        (word, _listed(message))
        for word, message in (("only for MATLAB", found.unreadable), ("left out", sizes))
        if message
    ]
    return replace(table, details=(*table.details, *more))
