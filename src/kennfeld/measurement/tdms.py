"""Reader of TDMS files of National Instruments: LabVIEW, FlexLogger, VeriStand."""

import logging
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import InputError
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, tables_of
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.unit_text import split_name
from kennfeld.optional_packages import optional_package

_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_UNITS = ("unit_string", "NI_UnitDescription", "unit")


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each raster that holds a requested channel.

    The channels of a group with equal length, increment and start have one raster. Channels with an increment have time
    stamps of their own; these count from the earliest start in the file.
    """
    with optional_package(source.location, "tdms"):
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    log_manager.set_level(logging.CRITICAL)  # it logs what is reported as a finding here
    try:
        with source.path.open("rb") as stream, TdmsFile.open(stream) as file:
            groups = list(_groups(file))
            return tables_of(source.location, groups, selection)
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "TDMS", error) from None


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each raster."""
    return [describe_table(table) for table in read_tables(source, Selection())]


def _groups(file: Any) -> Iterator[RecordedGroup]:
    channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
    starts = [channel.properties[_START] for channel in channels if _is_even(channel)]
    dates = [date for channel in channels if _is_dated(channel) and not np.isnat(date := channel[0])]
    first = min(starts or dates, default=None)
    several = len(file.groups()) > 1
    for group in file.groups():
        rasters: dict[tuple[int, float, float], list[Any]] = defaultdict(list)
        for channel in group.channels():
            if len(channel):
                rasters[(len(channel), *_raster(channel, first))].append(channel)
        for (samples, step, start), members in rasters.items():
            path = group.name if len(rasters) == 1 else f"{group.name}, {samples} samples"
            yield RecordedGroup(
                path if several or len(rasters) > 1 else "",
                samples,
                [_channel(channel, first) for channel in members],
                partial(_stamps, samples, step, start) if step > 0 else None,
            )


def _is_even(channel: Any) -> bool:
    return _step(channel) > 0 and isinstance(channel.properties.get(_START), np.datetime64)


def _step(channel: Any) -> float:
    step = channel.properties.get(_STEP, 0.0)
    return float(step) if isinstance(step, int | float) and np.isfinite(step) else 0.0


def _raster(channel: Any, first: Any) -> tuple[float, float]:
    """Return step and start of the time stamps in s; step 0 if the channel has none."""
    step = _step(channel)
    if step <= 0:
        return 0.0, 0.0
    offset = float(channel.properties.get(_OFFSET, 0.0))
    if _is_even(channel):
        offset += float((channel.properties[_START] - first) / np.timedelta64(1, "ns")) * 1e-9
    return step, offset


def _stamps(samples: int, step: float, start: float) -> Float:
    return np.asarray(start + step * np.arange(samples), dtype=np.float64)


def _channel(channel: Any, first: Any) -> RecordedChannel:
    notes = channel.properties
    name, unit = split_name(channel.name)
    unit = next((str(notes[key]) for key in _UNITS if notes.get(key)), unit)
    dated = _is_dated(channel)
    content = (
        "" if dated or channel.dtype.kind in "fiub" else "a text" if channel.dtype.kind in "OSU" else "a complex number"
    )
    path = f"{channel.group_name}/{channel.name}"
    load = partial(_dates, channel, first) if dated else partial(_numbers, channel)
    return RecordedChannel(name, path, unit, load, str(notes.get("description", "")), dated, content)


def _numbers(channel: Any) -> Float:
    return np.asarray(channel[:], dtype=np.float64)


def _is_dated(channel: Any) -> bool:
    return bool(channel.dtype.kind == "M")


def _dates(channel: Any, first: Any) -> Float:
    stamps = channel[:].astype("datetime64[ns]")
    origin = stamps[0] if first is None else first.astype("datetime64[ns]")
    elapsed = (stamps - origin).astype(np.float64) * 1e-9
    return np.asarray(np.where(np.isnat(stamps), np.nan, elapsed), dtype=np.float64)
