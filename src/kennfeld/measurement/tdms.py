"""Reader of TDMS files of National Instruments: LabVIEW, FlexLogger, VeriStand."""

import logging
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding, InputError
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, tables_of
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.unit_text import in_seconds, may_be_time, split_name
from kennfeld.optional_packages import optional_package

_STEP, _OFFSET, _START, _UNIT = "wf_increment", "wf_start_offset", "wf_start_time", "wf_xunit_string"
_COLUMNS = "wf_xcolumns"  # of a group: "One" if its first channel is the time, as LabVIEW writes it
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
            missing = _missing_values(file)
            tables = tables_of(source, list(_groups(file, missing)), selection)
            if missing is None:
                return tables
            message = "the last segment is incomplete: the recording was interrupted, or the file is cut off"
            warning = Finding(source.location, message, "The samples before are read.", severity="warning")
            return [replace(tables[0], findings=(*tables[0].findings, warning)), *tables[1:]]
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "TDMS", error) from None


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each raster."""
    return [describe_table(table) for table in read_tables(source, Selection())]


def _missing_values(file: Any) -> Mapping[str, int] | None:
    """Return how many values each channel lacks in the last segment; None if that is complete."""
    status = file.file_status
    if not status.incomplete_final_segment:
        return None
    channels = (status.channel_statuses or {}).items()
    return {path: int(channel.expected_length) - int(channel.read_length) for path, channel in channels}


def _groups(file: Any, missing: Mapping[str, int] | None) -> Iterator[RecordedGroup]:
    channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
    starts = [channel.properties[_START] for channel in channels if _is_even(channel)]
    dates = [date for channel in channels if _is_dated(channel) and not np.isnat(date := channel[0])]
    first = min(starts or dates, default=None)
    several = len(file.groups()) > 1
    for group in file.groups():
        rasters: dict[tuple[int, float, float], list[Any]] = defaultdict(list)
        even = not _has_time_channel(group)
        for channel in group.channels():
            if len(channel):
                # the length as it was meant: what is cut off is the end of some channels
                length = len(channel) + (missing or {}).get(channel.path, 0)
                rasters[(length, *(_raster(channel, first) if even else (0.0, 0.0)))].append(channel)
        for (_, step, start), members in rasters.items():
            samples = min(map(len, members))
            path = group.name if len(rasters) == 1 else f"{group.name}, {samples} samples"
            yield RecordedGroup(
                path if several or len(rasters) > 1 else "",
                samples,
                [_channel(channel, first, samples) for channel in members],
                partial(_stamps, samples, step, start) if step > 0 else None,
            )


def _has_time_channel(group: Any) -> bool:
    first = next(iter(group.channels()), None)
    if first is None or group.properties.get(_COLUMNS) != "One":
        return False
    name, unit = _name_and_unit(first)
    return _is_dated(first) or may_be_time(name, unit)


def _is_even(channel: Any) -> bool:
    return _step(channel) > 0 and isinstance(channel.properties.get(_START), np.datetime64)


def _step(channel: Any) -> float:
    """Return the distance of samples in s; 0 if there is none, or if it is not a time, as that of a spectrum."""
    unit = str(channel.properties.get(_UNIT) or "s")
    factor, divisor = in_seconds(unit) or (0.0, 1.0)
    return _number(channel, _STEP) * factor / divisor


def _number(channel: Any, key: str) -> float:
    value = channel.properties.get(key)
    return float(value) if isinstance(value, int | float | np.number) and np.isfinite(value) else 0.0


def _raster(channel: Any, first: Any) -> tuple[float, float]:
    """Return step and start of the time stamps in s; step 0 if the channel has none."""
    step = _step(channel)
    if step <= 0:
        return 0.0, 0.0
    offset = _number(channel, _OFFSET) * step / _number(channel, _STEP)  # in the same unit
    if _is_even(channel):
        offset += float((channel.properties[_START] - first) / np.timedelta64(1, "ns")) * 1e-9
    return step, offset


def _stamps(samples: int, step: float, start: float) -> Float:
    return np.asarray(start + step * np.arange(samples), dtype=np.float64)


def _channel(channel: Any, first: Any, samples: int) -> RecordedChannel:
    name, unit = _name_and_unit(channel)
    dated = _is_dated(channel)
    content = (
        "" if dated or channel.dtype.kind in "fiub" else "a text" if channel.dtype.kind in "OSU" else "a complex number"
    )
    path = f"{channel.group_name}/{channel.name}"
    load = partial(_dates, channel, first, samples) if dated else partial(_numbers, channel, samples)
    description = str(channel.properties.get("description", ""))
    return RecordedChannel(name, path, unit, load, description, dated, content)


def _name_and_unit(channel: Any) -> tuple[str, str]:
    name, unit = split_name(channel.name)
    return name, next((str(channel.properties[key]) for key in _UNITS if channel.properties.get(key)), unit)


def _numbers(channel: Any, samples: int) -> Float:
    return np.asarray(channel[:samples], dtype=np.float64)


def _is_dated(channel: Any) -> bool:
    return bool(channel.dtype.kind == "M")


def _dates(channel: Any, first: Any, samples: int) -> Float:
    stamps = channel[:samples].astype("datetime64[ns]")
    origin = stamps[0] if first is None else first.astype("datetime64[ns]")
    elapsed = (stamps - origin).astype(np.float64) * 1e-9
    return np.asarray(np.where(np.isnat(stamps), np.nan, elapsed), dtype=np.float64)
