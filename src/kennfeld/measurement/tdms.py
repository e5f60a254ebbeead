"""Reader of TDMS files of National Instruments: LabVIEW, FlexLogger, VeriStand."""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.optional_packages import optional_package
from kennfeld.base.quiet_loggers import quiet_loggers
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, UnreadableChannel, tables_of
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.unit_text import in_seconds, may_be_time, split_name

_STEP, _OFFSET, _START, _UNIT = "wf_increment", "wf_start_offset", "wf_start_time", "wf_xunit_string"
_COLUMNS = "wf_xcolumns"  # of a group: "One" if its first channel is the time, as LabVIEW writes it
_SCALES = frozenset(
    ["Linear", "Polynomial", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract", "AdvancedAPI"]
)  # that the library applies
_MOST_SCALES = 1000
_UNITS = ("unit_string", "NI_UnitDescription", "unit")


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each raster that holds a requested channel.

    The channels of a group with equal length, increment and start have one raster. Channels with an increment have time
    stamps of their own; these count from the earliest start in the file.
    """
    with optional_package(source.location, "tdms"):
        from nptdms import TdmsFile
    try:
        with quiet_loggers("nptdms"), source.path.open("rb") as stream, TdmsFile.open(stream) as file:
            missing = _missing_values(file)
            unscaled = dict(_unknown_scales(file))
            groups = list(_groups(file, missing, unscaled))
            tables = tables_of(source, groups, selection, list(unscaled.values()))
            if missing is None:
                return tables
            message = "the last segment is incomplete: the recording was interrupted, or the file is cut off"
            warning = Finding(source.location, message, "The samples before are read.", severity="warning")
            return [replace(tables[0], findings=(*tables[0].findings, warning)), *tables[1:]]
    except InputError:
        raise
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "TDMS", error) from None


def _missing_values(file: Any) -> Mapping[str, int] | None:
    """Return how many values each channel lacks in the last segment; None if that is complete."""
    status = file.file_status
    if not status.incomplete_final_segment:
        return None
    channels = (status.channel_statuses or {}).items()
    return {path: int(channel.expected_length) - int(channel.read_length) for path, channel in channels}


def _unknown_scales(file: Any) -> Iterator[tuple[str, UnreadableChannel]]:
    """Yield the paths of channels whose scale the library does not know, so that it would return raw values."""
    for group in file.groups():
        for channel in group.channels():
            levels = (channel.properties, group.properties, file.properties)
            unknown = next((scale for scale in map(_unknown_scale, levels) if scale is not None), "")
            if unknown:
                problem = f"has a scale of the unknown type {unknown[:60]} and is skipped: its values are raw"
                remedy = "Export it with scaled values."
                yield channel.path, UnreadableChannel(split_name(channel.name)[0], problem, remedy)


def _unknown_scale(properties: Mapping[str, Any]) -> str | None:
    """Return the type of a scale that the library does not know; empty if it knows all, None if there is none."""
    count = properties.get("NI_Number_Of_Scales")
    if not isinstance(count, int | float | np.number) or properties.get("NI_Scaling_Status") == "scaled":
        return None
    types = [properties.get(f"NI_Scale[{k}]_Scale_Type") for k in range(min(int(count), _MOST_SCALES))]
    stated = [str(kind) for kind in types if kind is not None]
    return next((kind for kind in stated if kind not in _SCALES), "") if stated else None


def _groups(file: Any, missing: Mapping[str, int] | None, skipped: Collection[str] = ()) -> Iterator[RecordedGroup]:
    """Yield the rasters of the file; channels with the paths `skipped` are left out."""
    channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
    starts = [channel.properties[_START] for channel in channels if _is_even(channel)]
    dates = [date for channel in channels if _is_dated(channel) and not np.isnat(date := channel[0])]
    first = min(starts or dates, default=None)
    several = len(file.groups()) > 1
    for group in file.groups():
        rasters: dict[tuple[int, float, float], list[Any]] = defaultdict(list)
        # beside a channel of time, the increments of the others do not count
        even = not _has_time_channel(group)
        for channel in group.channels():
            if len(channel) and channel.path not in skipped:
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
                None if first is None else _instant(first),
            )


def _instant(stamp: np.datetime64) -> datetime | None:
    """Return a stamp, which is in UTC, to the microsecond; None if Python has no such date."""
    instant = stamp.astype("datetime64[us]").item()
    return instant.replace(tzinfo=UTC) if isinstance(instant, datetime) else None


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
