"""Reader of MDF files, versions 2 to 4: one table for each channel group."""

import gc
import math
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from datetime import datetime
from importlib.util import find_spec
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import count_noun, join_names, reason_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.library_process import LibraryProcess
from kennfeld.base.optional_packages import optional_package
from kennfeld.base.quiet_loggers import quiet_loggers
from kennfeld.measurement.bus_decoding import NO_DATABASE, BusChannel, BusLog
from kennfeld.measurement.channel_names import TIME, choose, unique_forms, without_indices
from kennfeld.measurement.claimed_values import check_claimed
from kennfeld.measurement.library_conversions import conversion_of
from kennfeld.measurement.mdf_blocks import check_links
from kennfeld.measurement.mdf_bus import event_of, is_of_event, read_frames
from kennfeld.measurement.mdf_conversions import ConversionKind, MdfConversion, UnsupportedConversionError
from kennfeld.measurement.mdf_start_time import HeaderTime, start_time_of_texts
from kennfeld.measurement.sorted_mdf import SortedFile, UnusualLayoutError
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.unit_text import in_seconds, plain_unit

_AT_ONCE = 50_000_000  # values in memory for a description
_MAX_VALUES = 500_000_000  # of all requested channels, 4 GB
_PACKING = 1100  # maximum compression ratio of deflate
_ORIGINAL = 0  # the data are those of the file itself
_VARYING_4 = 1  # a channel whose samples lie outside the records
_VARYING_GROUP_4 = 1  # flag of a group with records of varying length
_VIRTUAL_4 = (3, 6)  # channels without bits in the record
_MARKED_4 = 2  # flag: the record says which values are invalid
_MAX_TEXTS = 12  # of an enumeration in a description
_MAX_LISTED = 6  # channels in a message
_PACKAGE = "asammdf"
_LIBRARY = LibraryProcess("MDF")


@dataclass(frozen=True)
class _MdfChannel:
    """A channel of the file: its position and its unique name."""

    name: str
    forms: tuple[str, ...]  # the names that may mean it, from short to certain
    group: int
    index: int
    is_array: bool
    conversion: MdfConversion | None = field(default=None, compare=False)
    enumerated: bool = False  # its numbers stand for texts

    def named(self, name: str) -> "_MdfChannel":
        """Return the channel under another name."""
        return replace(self, name=name)


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each channel group that holds a requested channel."""
    try:
        with SortedFile(source.path) as plain:
            return _read(source, plain, selection)
    except UnusualLayoutError:
        tables: list[Table] = _use_library(source, read_by_library, selection)
        return tables


def read_by_library(source: MeasurementFile, temporary: str, selection: Selection) -> list[Table]:
    """Return the tables of any file; the process should be one that may crash.

    Args:
        source: the file.
        temporary: a folder for copies of the file.
        selection: the requested channels.
    """
    with _open(source, temporary) as file:
        return _read(source, file, selection)


def library_is_loaded() -> bool:
    """Return whether a file has needed the library already; loading it takes longer than reading most files."""
    return _LIBRARY.is_running


def _use_library(source: MeasurementFile, work: Callable[..., Any], *arguments: Any) -> Any:
    """Return `work(source, folder, *arguments)`, evaluated by the process of the library."""
    check_links(source.path)
    with optional_package(source.location, "mdf"):
        # looked up here, as the process of the library is the one that imports it
        if find_spec(_PACKAGE) is None:
            raise ModuleNotFoundError(name=_PACKAGE)
    # it copies a file that was not closed properly, and does not remove the copy if that is damaged as well
    with TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as folder:
        return _LIBRARY.call(work, source, folder, *arguments)


def _read(source: MeasurementFile, file: Any, selection: Selection) -> list[Table]:
    log = _bus_log(source, file)
    entries = _entries(source, file, log)
    chosen = choose(source, entries, selection, None if log is None else log.explain)
    own = [entry for entry in chosen if isinstance(entry, _MdfChannel)]
    if sum(_samples(file, entry.group) for entry in own) > _MAX_VALUES:
        message = f"{len(own)} channels of this file hold more than {_MAX_VALUES} values"
        raise InputError.of(source.location, message, "Name the channels to read.")
    check_claimed(source, sum(_samples(file, entry.group) for entry in own))
    names: dict[int, list[str]] = {}
    for entry in entries:
        if isinstance(entry, _MdfChannel):
            names.setdefault(entry.group, []).append(entry.name)
    groups = dict.fromkeys(entry.group for entry in own)
    tables = [_table(source, file, [e for e in own if e.group == g], names[g]) for g in groups]
    decoded = [entry for entry in chosen if isinstance(entry, BusChannel)]
    if log is None or not decoded:
        return tables
    begin = _start_time(file)
    return [*tables, *(replace(table, start_time=begin) for table in log.tables(decoded))]


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each channel group."""
    descriptions: list[TableDescription] = _use_library(source, describe_by_library)
    return descriptions


def describe_by_library(source: MeasurementFile, temporary: str) -> list[TableDescription]:
    """Return the descriptions as `read_by_library` does, reading only some channels at a time."""
    with _open(source, temporary) as file:
        return list(_descriptions(source, file))


def _descriptions(source: MeasurementFile, file: Any) -> Iterator[TableDescription]:
    log = _bus_log(source, file)
    entries = _entries(source, file, log)
    count = Counter(entry.forms[0] for entry in entries)
    own = [entry for entry in entries if isinstance(entry, _MdfChannel)]
    remarks = tuple(_bus_remark(source, file)) if log is None else ()
    for group in dict.fromkeys(entry.group for entry in own):
        together = [entry for entry in own if entry.group == group]
        ambiguous = tuple(dict.fromkeys(entry.forms[0] for entry in together if count[entry.forms[0]] > 1))
        described = _description(source, file, together, ambiguous)
        yield replace(described, findings=(*described.findings, *remarks))
        remarks = ()
    if log is not None:
        yield from log.descriptions([entry for entry in entries if isinstance(entry, BusChannel)])


def _bus_log(source: MeasurementFile, file: Any) -> BusLog | None:
    """Return the decoded bus events of the file; None if it has none, or measured channels and no database."""
    groups = _bus_groups(file)
    has_channels = any(_group_entries(file, group) for group in range(len(file.groups)) if _samples(file, group))
    if not groups or (has_channels and not source.databases):
        return None
    frames = read_frames(file, groups)
    if source.databases and not frames and has_channels:
        return None
    return BusLog(source, frames, may_be_empty=has_channels)


def _bus_groups(file: Any) -> list[int]:
    return [group for group in range(len(file.groups)) if _samples(file, group) and event_of(file, group)]


def _bus_remark(source: MeasurementFile, file: Any) -> Iterator[Finding]:
    """Yield a remark on frames that are not decoded."""
    if groups := _bus_groups(file):
        count = count_noun(sum(_samples(file, group) for group in groups), "bus event")
        yield Finding(source.location, f"also holds {count}, which are not decoded", NO_DATABASE, severity="remark")


def _description(
    source: MeasurementFile, file: Any, own: Sequence[_MdfChannel], ambiguous: tuple[str, ...]
) -> TableDescription:
    size = max(_AT_ONCE // max(_samples(file, own[0].group), 1), 1)
    blocks = [own[k : k + size] for k in range(0, len(own), size)]
    parts = [describe_table(_table(source, file, block, [entry.name for entry in block])) for block in blocks]
    first = parts[0]
    clock = first.time.channel if first.time else None
    more = [c for part in parts[1:] for c in part.channels if c.name != clock]
    return replace(
        first,
        channels=(*first.channels, *more),
        left_out=tuple(name for part in parts for name in part.left_out),
        details=first.details | ({"names that others have too": join_names(ambiguous, 6)} if ambiguous else {}),
        ambiguous=ambiguous,
        findings=tuple(dict.fromkeys(finding for part in parts for finding in part.findings)),
    )


@contextmanager
def _open(source: MeasurementFile, temporary: str) -> Iterator[Any]:
    """Yield the open file; all errors of the library for damaged files become an `InputError`."""
    # in a process of its own, but in a program without an interpreter, where this concerns all threads
    with warnings.catch_warnings(), quiet_loggers("asammdf"):
        warnings.simplefilter("ignore")
        try:
            from asammdf import MDF

            # without its own search for frames, which reads them all
            settings: dict[str, Any] = {"temporary_folder": temporary, "process_bus_logging": False}
            with MDF(source.path, **settings) as file:
                file.configure(raise_on_multiple_occurrences=False)
                _check_layout(source, file)
                yield file
        except (InputError, MemoryError):
            raise
        except Exception as error:  # of many kinds: the library trusts what it reads
            reason = reason_of(error)
            _discard(error)
        else:
            return
    # outside of the handler, or the error would keep the reader alive
    message = f"the MDF file is damaged, cut off or encrypted ({reason})"
    raise InputError.of(source.location, message, "Copy or export it again.")


def _discard(error: Exception) -> None:
    """Free the half-initialised reader that an error holds: its destructor fails where nobody can catch it."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        traceback.clear_frames(error.__traceback__)
        gc.collect()
    finally:
        sys.unraisablehook = hook


def _check_layout(source: MeasurementFile, file: Any) -> None:
    """Refuse more samples than a file of this size can hold, and channels that lie outside their records.

    The library would ask for that memory, and read beyond its own.
    """
    with source.open() as stream:
        # a file that was not finalized begins with `UnFinMF`
        finalized = stream.read(3) == b"MDF"
    for index, group in enumerate(file.groups):
        samples = _samples(file, index)
        size = int(group.channel_group.samples_byte_nr)
        invalid = int(getattr(group.channel_group, "invalidation_bytes_nr", 0))
        own = finalized and group.data_location == _ORIGINAL  # the library copies what it sorts or finalizes
        blocks = list(group.get_data_blocks())
        outside = (c.name for c in group.channels if not _lies_within(c, size, invalid, file.version))
        problem = ""
        if max(samples, 1) * max(size + invalid, 1) > _PACKING * source.size:
            problem = f"claims {samples} samples of {size + invalid} bytes, more than this file can hold"
        elif not all(_is_possible(block, own, source) for block in blocks):
            problem = "has data that this file cannot hold"
        elif samples * size > sum(block.original_size for block in blocks) and not _varies(group, file.version):
            problem = f"claims {samples} samples of {size} bytes, more than its data"
        elif samples and (name := next(outside, None)) is not None:
            problem = f"has a channel {name[:60]} that lies outside its records of {size} bytes"
        if problem:
            message = f"the MDF file is damaged: {_label(file, index)} {problem}"
            raise InputError.of(source.location, message, "Copy or export it again.")


def _varies(group: Any, version: str) -> bool:
    """Return whether the records of a group differ in length."""
    return version >= "4" and bool(group.channel_group.flags & _VARYING_GROUP_4)


def _is_possible(block: Any, own: bool, source: MeasurementFile) -> bool:
    """Return whether a block of data may have the size that it claims, and ends within the file if it is its own."""
    if block.original_size > _PACKING * max(int(block.compressed_size), 1):
        return False
    return not own or bool(block.address + block.compressed_size <= source.size)


def _lies_within(channel: Any, size: int, invalid: int, version: str) -> bool:
    """Return whether the bits of a channel are bits of the record."""
    if version < "4":
        # the offset in bits has 16 bits, so channels beyond 8 KB have one in bytes as well
        begin = channel.start_offset + 8 * getattr(channel, "additional_byte_offset", 0)
        return bool(begin + channel.bit_count <= 8 * size)
    if channel.channel_type in _VIRTUAL_4:
        return True
    if invalid and channel.flags & _MARKED_4 and channel.pos_invalidation_bit >= 8 * invalid:
        return False
    return bool(8 * channel.byte_offset + channel.bit_offset + channel.bit_count <= 8 * size)


def _samples(file: Any, group: int) -> int:
    return int(file.groups[group].channel_group.cycles_nr)


def _label(file: Any, group: int) -> str:
    """Return the label of a group: its name, else its comment, else its number."""
    block = file.groups[group].channel_group
    text = str(getattr(block, "acq_name", "") or block.comment or "").strip().split("\n")[0]
    # a comment of version 4 may be XML
    text = "" if text.startswith("<") else " ".join(text.split())[:60]
    return text or f"group {group + 1}"


def _entries(source: MeasurementFile, file: Any, log: BusLog | None) -> list[_MdfChannel | BusChannel]:
    """Return all channels that hold samples, each with a name of its own; there has to be one."""
    groups = [group for group in range(len(file.groups)) if _samples(file, group)]
    entries: list[_MdfChannel | BusChannel] = [entry for group in groups for entry in _group_entries(file, group)]
    entries += [] if log is None else log.channels()
    if not entries:
        raise InputError.of(source.location, "holds no samples", "Is it the right file?")
    names = unique_forms([entry.forms for entry in entries])
    return [entry.named(name) for entry, name in zip(entries, names, strict=True)]


def _group_entries(file: Any, group: int) -> list[_MdfChannel]:
    """Return the channels of a group beside its time and the parts of a bus event, each under its shortest name."""
    event = event_of(file, group)
    return [entry for entry in _channels(file, group) if not is_of_event(event, entry.forms[1])]


def _channels(file: Any, group: int) -> Iterator[_MdfChannel]:
    own = file.groups[group]
    parts = own.channel_dependencies or [None] * len(own.channels)
    indices = [
        i
        for i, channel in enumerate(own.channels)
        # of a structure, the members are channels of their own
        if i != file.masters_db.get(group) and channel.name and not (parts[i] and isinstance(parts[i][0], tuple))
    ]
    arrays = {own.channels[i].name for i in indices if parts[i]}
    for i in indices:
        channel = own.channels[i]
        # the library lists the elements as well; read with their array they cost one look at its samples
        if parts[i] or without_indices(channel.name) not in arrays:
            forms = _forms(file, group, i, channel)
            conversion = _conversion(file, channel)
            unit = _unit(channel, conversion)
            enumerated = conversion is not None and conversion.is_enumeration(unit)
            yield _MdfChannel(forms[0], forms, group, i, bool(parts[i]), conversion, enumerated)


def _conversion(file: Any, channel: Any) -> MdfConversion | None:
    block = channel.conversion
    return block if block is None or isinstance(block, MdfConversion) else conversion_of(block, file.version)


def _forms(file: Any, group: int, index: int, channel: Any) -> tuple[str, ...]:
    r"""Return names from short to unique; the part after a backslash is the device, as in `Speed\ETKC:1`."""
    label, full = _label(file, group), str(channel.name)
    short = full.partition("\\")[0] or full
    origin = getattr(channel.source, "name", "") or getattr(channel.source, "path", "") or label
    return (short, full, f"{label}/{short}", f"{label}/{full}", f"{origin}/{full}", f"{group + 1}.{index}/{full}")


def _table(source: MeasurementFile, file: Any, own: Sequence[_MdfChannel], names: Sequence[str]) -> Table:
    group = own[0].group
    channels = file.groups[group].channels
    # samples of varying length are stored elsewhere; they are never numbers, so their links need not be followed
    fixed = [e for e in own if _has_numbers(file, channels[e.index], e)]
    places = [(None, entry.group, entry.index) for entry in fixed]
    # raw, as the library computes some conversions wrongly
    signals = dict(zip(fixed, file.select(places, raw=True, copy_master=False) if places else (), strict=True))
    stamps = signals[fixed[0]].timestamps if fixed else file.get_master(group)
    count = len(stamps)
    clock = _clock(file, group, _to_float64(stamps, None))
    columns: list[Column] = []
    missing: list[str] = []
    for entry in own:
        if entry in signals:
            columns += _columns(entry, channels[entry.index], signals[entry])
            missing += _missing_texts(entry, signals[entry])
        else:
            columns.append(Column.without_numbers(entry.name, count, "text or bytes of varying length"))
    spread = {entry.name for entry in own if entry.is_array}
    known = dict.fromkeys([*(n for n in names if n not in spread), *(column.name for column in columns)])
    times = [] if clock is None else [clock]
    label = _label(file, group)
    return Table(
        source.location.within(label if label.startswith("group ") else f"group {label}"),
        (*times, *columns),
        np.arange(1, count + 1),
        "sample",
        (*(time.name for time in times), *known),
        findings=(*_text_remarks(source, missing), *_skipped_formulas(source, own, columns)),
        details=(("group", label),),
        clock_index=None if clock is None else 0,
        start_time=_start_time(file),
    )


def _start_time(file: Any) -> datetime | None:
    if isinstance(file, SortedFile):
        return file.start_time
    header = file.header
    if file.version < "4":
        return start_time_of_texts(header.date, header.time, int(getattr(header, "abs_time", 0)))
    times = header.abs_time, header.tz_offset, header.daylight_save_time, header.time_flags
    return HeaderTime(*map(int, times)).start_time


def _missing_texts(entry: _MdfChannel, signal: Any) -> Iterator[str]:
    """Yield how many samples of a channel of numbers hold a text, and which."""
    conversion, samples = entry.conversion, _plain(signal.samples)
    if conversion is None or entry.enumerated or not conversion.has_texts or samples.dtype.kind not in "buif":
        return
    if counts := conversion.text_counts(samples.ravel()):
        texts = join_names([text or "no value" for text in counts], _MAX_TEXTS)
        yield f"{entry.name} ({sum(counts.values())} of {samples.size}: {texts})"


def _skipped_formulas(
    source: MeasurementFile, own: Sequence[_MdfChannel], columns: Sequence[Column]
) -> Iterator[Finding]:
    """Yield a warning on channels whose conversion cannot be computed."""
    formulas = {entry.name for entry in own if entry.conversion and entry.conversion.kind is ConversionKind.FORMULA}
    skipped = [f"{c.name} ({c.texts[0][1]})" for c in columns if c.is_text and c.name in formulas]
    if skipped:
        message = f"{count_noun(len(skipped), 'channel')} skipped: {join_names(skipped, _MAX_LISTED)}"
        yield Finding(source.location, message, "Export the file with physical values.", severity="warning")


def _text_remarks(source: MeasurementFile, missing: Sequence[str]) -> Iterator[Finding]:
    if missing:
        message = f"samples that stand for a text are missing values: {join_names(missing, _MAX_LISTED)}"
        yield Finding(source.location, message, severity="remark")


def _has_numbers(file: Any, channel: Any, entry: _MdfChannel) -> bool:
    """Return whether the samples of a channel may be numbers: those of varying length are texts or bytes."""
    is_fixed = file.version < "4" or channel.channel_type != _VARYING_4
    return is_fixed or (entry.conversion is not None and entry.conversion.kind is ConversionKind.TEXT_VALUES)


def _clock(file: Any, group: int, stamps: Float) -> Column | None:
    """Return the time of a group, in the unit that the file states; None if it is an angle, distance or index."""
    index = file.masters_db.get(group)
    if index is None:
        return None
    master = file.groups[group].channels[index]
    # 1 is the time, 0 states no kind
    if file.version >= "4" and getattr(master, "sync_type", 1) not in (0, 1):
        return None
    conversion = getattr(master, "conversion", None)
    unit = plain_unit(str(master.unit or getattr(conversion, "unit", "") or ""))
    return Column(TIME, unit if not unit or in_seconds(unit) else "s", TIME, stamps)


def _columns(entry: _MdfChannel, channel: Any, signal: Any) -> Iterator[Column]:
    """Yield the column of a channel, or one for each element of an array; text gives a column of no numbers."""
    samples = _plain(signal.samples)
    try:
        physical = _physical(entry, samples)
    except UnsupportedConversionError as error:
        yield Column.without_numbers(entry.name, len(samples), str(error))
        return
    if physical.dtype.kind not in "buif" or (samples.ndim > 1 and not entry.is_array):
        sample = samples[0] if len(samples) else ""
        text = sample.decode(errors="replace") if isinstance(sample, bytes) else str(sample)
        yield Column.without_numbers(entry.name, len(samples), text.strip("\0 ")[:40])
        return
    unit, description = _unit(channel, entry.conversion), _description_of(entry, channel)
    held = entry.enumerated or physical.dtype.kind in "bui"
    for place in np.ndindex(samples.shape[1:]):
        name = entry.name + "".join(f"[{i}]" for i in place)
        values = _to_float64(physical[(slice(None), *place)], signal.invalidation_bits)
        yield Column(name, unit, name, values, held=held, description=description)


def _plain(samples: Any) -> Any:
    """Return the samples of a channel without the axes of an array."""
    return samples[samples.dtype.names[0]] if samples.dtype.names else samples


def _physical(entry: _MdfChannel, samples: Any) -> Any:
    """Return physical values, or the raw ones if they are equal, numbers of texts, or no numbers."""
    conversion = entry.conversion
    if conversion is None or entry.enumerated or conversion.is_identity:
        return samples
    from_text = conversion.kind in (ConversionKind.TEXT_VALUES, ConversionKind.TRANSLATION)
    # a table of text keys needs texts, all others need numbers
    if from_text != (samples.dtype.kind not in "buif") or conversion.kind is ConversionKind.TRANSLATION:
        return samples
    return conversion.convert(samples)


def _unit(channel: Any, conversion: MdfConversion | None) -> str:
    """Return the unit that a channel or its conversion states; of a table of texts, texts are not a unit."""
    own = plain_unit(str(getattr(channel, "unit", "") or ""))
    if conversion is None:
        return own
    texts = {text for _, _, text in conversion.texts()}
    stated = (plain_unit(unit) for unit in (conversion.unit, own) if unit)
    return next((unit for unit in stated if unit not in texts), "")


def _to_float64(samples: Any, invalid: Any) -> Float:
    """Return the samples as float64, NaN if the logger marked them as invalid."""
    with np.errstate(invalid="ignore"):  # a signalling NaN of a narrower type
        values = np.array(samples, dtype=np.float64)
    if invalid is not None:
        values[np.asarray(invalid, dtype=bool)] = np.nan
    missing = np.isnan(values)
    if missing.any():
        values[missing] = np.nan  # a NaN that signals would set off warnings later
    return values


def _description_of(entry: _MdfChannel, channel: Any) -> str:
    """Return the comment, and of an enumeration the texts of its numbers."""
    comment = " ".join(str(channel.comment or "").split())
    comment = "" if comment.startswith("<") else comment[:200]
    if entry.conversion is None or not entry.conversion.has_texts:
        return comment
    ranges = list(entry.conversion.texts())
    pairs = [f"{_span(low, high)} = {text}" for low, high, text in ranges[:_MAX_TEXTS]]
    texts = ", ".join(pairs) + (", ..." if len(ranges) > _MAX_TEXTS else "")
    return ": ".join(part for part in (comment, texts) if part)


def _span(low: float, high: float) -> str:
    return f"{low:g}" if math.isclose(low, high) else f"{low:g} to {high:g}"
