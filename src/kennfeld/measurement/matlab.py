"""Reader of MATLAB files (versions 4 to 7.3) as measurements: vectors with a time, structs, matrices."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.errors import Findings, InputError
from kennfeld.base.formatting import join_names, size_text
from kennfeld.files.containers import HDF5
from kennfeld.matlab import mat_v4, mat_v5, mat_v73
from kennfeld.matlab.mat_nodes import MatFileError, Node
from kennfeld.matlab.mcos import resolve_objects
from kennfeld.measurement.channel_names import several_channels
from kennfeld.measurement.epochs import with_epochs
from kennfeld.measurement.header import unique_names
from kennfeld.measurement.matlab_signals import MatlabSignals, RecordedSignal, TimeBase, find_signals
from kennfeld.measurement.source import MeasurementFile, locate
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table

_TIME = "time"
_MAX_LISTED = 8  # variables in a message
_PLAIN = "In MATLAB, save its values as plain vectors, in a struct beside a vector `time`, or as a timetable."


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each time in the file that has a requested channel."""
    tables: list[Table] = _evaluated(tables_by_library, source, selection)
    return tables


def tables_by_library(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the same tables; for version 7.3, the process should be one that may crash or hang."""
    return _tables(source, _require_signals(source), selection)


def _evaluated(work: Callable[..., Any], source: MeasurementFile, *arguments: Any) -> Any:
    """Return `work(source, *arguments)`, evaluated in the process of the library if that reads the file."""
    return mat_v73.LIBRARY.call(work, source, *arguments) if _needs_library(source) else work(source, *arguments)


def _needs_library(source: MeasurementFile) -> bool:
    return source.format is HDF5 or source.start(9) == b"MATLAB 7."


def _tables(source: MeasurementFile, signals: MatlabSignals, selection: Selection) -> list[Table]:
    names = _unique_names(signals.clocks)
    chosen = _choose(source, signals, names, selection)
    tables = [_table(source, clock, chosen, names) for clock in signals.clocks]
    if len(tables) > 1:
        tables = [
            replace(table, location=source.location.within(clock.path), details=(("group", clock.path),))
            for table, clock in zip(tables, signals.clocks, strict=True)
        ]
    tables = [with_epochs(table, selection) for table in tables]
    # a time alone holds no requested channel
    return [table for table in tables if len(table.columns) > (table.clock is not None)] or tables[:1]


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each time base, with the names of skipped variables."""
    descriptions: list[TableDescription] = _evaluated(descriptions_by_library, source)
    return descriptions


def descriptions_by_library(source: MeasurementFile) -> list[TableDescription]:
    """Return the descriptions as `tables_by_library` does."""
    signals = _require_signals(source)
    first, *others = _tables(source, signals, Selection())
    skipped = (("only for MATLAB", signals.unreadable), ("left out", _sizes(signals)))
    more = tuple((word, _list(variables)) for word, variables in skipped if variables)
    return [describe_table(table) for table in (replace(first, details=(*first.details, *more)), *others)]


def holds_samples(path: str | Path) -> bool:
    """Return whether a MATLAB file holds channels over time, rather than parameters; `InputError` if it is damaged.

    >>> holds_samples("bench.mat")  # doctest: +SKIP
    True
    """
    return bool(_evaluated(_holds_samples, locate(path)))


def _holds_samples(source: MeasurementFile) -> bool:
    return any(clock.values is not None for clock in _find_signals(source).clocks)


def _find_signals(source: MeasurementFile) -> MatlabSignals:
    file = "HDF5 file" if source.format is HDF5 else "MATLAB file"
    try:
        return find_signals(_variables(source))
    except MatFileError as error:
        message = f"the {file} is damaged: {error}"
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library for version 7.3 trusts what it reads
        message = f"the {file} is damaged or cut off ({' '.join(str(error).split())[:160] or type(error).__name__})"
    raise InputError.of(source.location, message, "Save it again.")


def _variables(source: MeasurementFile) -> dict[str, Node]:
    if _needs_library(source):
        return resolve_objects(mat_v73.load_all(source.path)).whole().variables
    content = memoryview(np.memmap(source.path, np.uint8, mode="r"))  # type: ignore[arg-type]
    # version 5 begins with a text, version 4 without any signature
    if source.start(6) == b"MATLAB":
        return resolve_objects(mat_v5.load_all(content)).whole().variables
    return mat_v4.load(content)


def _require_signals(source: MeasurementFile) -> MatlabSignals:
    """Return the channels of the file; raise `InputError` if there are none."""
    signals = _find_signals(source)
    if signals.clocks:
        return signals
    if signals.loose:
        message = f"found neither a time vector nor vectors of equal length: {_list(_sizes(signals))}"
        raise InputError.of(source.location, message, "Save a vector `time`, in seconds, as long as the channels.")
    if signals.unreadable:
        message = f"only MATLAB can read its variables: {_list(signals.unreadable)}"
        raise InputError.of(source.location, message, _PLAIN)
    raise InputError.of(source.location, "holds no vectors", "Is it the right file?")


def _sizes(signals: MatlabSignals) -> dict[str, str]:
    return {path: size_text(shape) for path, shape in signals.loose.items()}


def _list(variables: dict[str, str]) -> str:
    return join_names([f"{path} ({text})" for path, text in variables.items()], _MAX_LISTED)


def _unique_names(clocks: Sequence[TimeBase]) -> dict[RecordedSignal, str]:
    """Return the name of each channel: its last part, or its path where others are called the same."""
    signals = [signal for clock in clocks for signal in clock.signals]
    count = Counter([_TIME, *(signal.name for signal in signals)])
    names = [signal.name if count[signal.name] == 1 else signal.path for signal in signals]
    return dict(zip(signals, unique_names([_TIME, *names])[1:], strict=True))


def _choose(
    source: MeasurementFile, signals: MatlabSignals, names: dict[RecordedSignal, str], selection: Selection
) -> dict[RecordedSignal, str]:
    """Return the requested channels, by their name or their path, with the name to give them."""
    if selection.channels is None:
        return names
    chosen: dict[RecordedSignal, str] = {}
    findings = Findings()
    sizes = _sizes(signals)
    for asked in selection.channels:
        named = [s for s, name in names.items() if name == asked] or [s for s in names if asked in (s.path, s.name)]
        if len(named) == 1:
            chosen[named[0]] = asked
        elif named:
            findings.add(several_channels(source.location, asked, [names[signal] for signal in named]))
        elif asked in signals.unreadable:
            message = f"{asked} ({signals.unreadable[asked]}) can only be read by MATLAB"
            findings.error(source.location, message, _PLAIN)
        elif asked in sizes:
            message = f"{asked} is of size {sizes[asked]}, but no time vector has that length"
            findings.error(source.location, message, "Save it with a vector `time` of its length.")
    findings.finish()
    return chosen


def _table(
    source: MeasurementFile, clock: TimeBase, chosen: dict[RecordedSignal, str], names: dict[RecordedSignal, str]
) -> Table:
    signals = {signal: chosen[signal] for signal in clock.signals if signal in chosen}
    time = [] if clock.values is None else [Column(_TIME, clock.unit, _TIME, clock.values)]
    columns = [Column(n, s.unit, n, s.values, held=s.held, description=s.description) for s, n in signals.items()]
    return Table(
        source.location,
        (*time, *columns),
        np.arange(1, clock.signals[0].values.size + 1),
        "sample",
        (*(c.name for c in time), *(chosen.get(s, names[s]) for s in clock.signals)),
        clock_index=0 if time else None,
    )
