"""Reader of MDF files, versions 2 to 4: one table for each channel group."""

import gc
import logging
import math
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import join_names
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.mdf_blocks import check_links
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.unit_text import in_seconds, plain_unit

_TIME = "time"
_AT_ONCE = 50_000_000  # values in memory for a description
_MAX_VALUES = 500_000_000  # of all requested channels, 4 GB
_PACKING = 1100  # maximum compression ratio of deflate
_TEXT_3, _TEXT_4 = (11, 12), (7, 8)  # conversions from a number to a text
_ORIGINAL = 0  # the data are those of the file itself
_VARYING_4 = 1  # a channel whose samples lie outside the records
_VIRTUAL_4 = (3, 6)  # channels without bits in the record
_MARKED_4 = 2  # flag: the record says which values are invalid
_TEXTS_SAID = 12


@dataclass(frozen=True)
class _MdfChannel:
    """A channel of the file: its position and its unique name."""

    name: str
    forms: tuple[str, ...]  # the names that may mean it, from short to certain
    group: int
    index: int
    is_array: bool
    is_text_table: bool


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each channel group that holds a requested channel."""
    with _opened(source) as file:
        entries = _entries(source, file)
        chosen = _chosen(source, entries, selection)
        if sum(_samples(file, entry.group) for entry in chosen) > _MAX_VALUES:
            message = f"{len(chosen)} channels of this file hold more than {_MAX_VALUES} values"
            raise InputError.of(source.name, message, "Name the channels to read.")
        groups = dict.fromkeys(entry.group for entry in chosen)
        known = _names_by_group(entries)
        return [_table(source, file, [e for e in chosen if e.group == g], known[g]) for g in groups]


def describe_tables(source: MeasurementFile) -> Iterator[TableDescription]:
    """Return a description of each channel group, reading only some of its channels at a time."""
    with _opened(source) as file:
        entries = _entries(source, file)
        ambiguous = _ambiguous(entries)
        for group in dict.fromkeys(entry.group for entry in entries):
            own = [entry for entry in entries if entry.group == group]
            names = tuple(dict.fromkeys(entry.forms[0] for entry in own if entry.forms[0] in ambiguous))
            yield _description(source, file, own, names)


def _description(
    source: MeasurementFile, file: Any, own: Sequence[_MdfChannel], ambiguous: tuple[str, ...]
) -> TableDescription:
    size = max(_AT_ONCE // max(_samples(file, own[0].group), 1), 1)
    parts = []
    for k in range(0, len(own), size):
        some = own[k : k + size]
        parts.append(describe_table(_table(source, file, some, tuple(entry.name for entry in some))))
    first = parts[0]
    clock = first.time.channel if first.time else None
    more = [c for part in parts[1:] for c in part.channels if c.name != clock]
    left_out = tuple(name for part in parts for name in part.left_out)
    details = dict(first.details)
    if ambiguous:
        details["names that others have too"] = join_names(ambiguous, 6)
    remarks = tuple(dict.fromkeys(remark for part in parts for remark in part.remarks))
    return TableDescription(
        first.name, first.samples, (*first.channels, *more), first.time, left_out, details, ambiguous, remarks
    )


@contextmanager
def _opened(source: MeasurementFile) -> Iterator[Any]:
    """Yield the open file; all errors of the library for damaged files become an `InputError`."""
    check_links(source.path)
    # the library logs what is reported as a finding here
    logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)
    # it copies a file that was not closed properly, and does not remove the copy if that is damaged as well
    with (
        TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as folder,
        warnings.catch_warnings(),
        redirect_stdout(StringIO()),  # it prints errors as well
    ):
        warnings.simplefilter("ignore")
        try:
            from asammdf import MDF

            with MDF(source.path, temporary_folder=folder) as file:
                file.configure(raise_on_multiple_occurrences=False)
                _check_layout(source, file)
                yield file
        except InputError:
            raise
        except Exception as error:  # of many kinds: the library trusts what it reads
            said = " ".join(str(error).split())[:160] or type(error).__name__
            _discard(error)
        else:
            return
    message = f"the MDF file is damaged, cut off or encrypted ({said})"
    raise InputError.of(source.name, message, "Copy or export it again.")


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
        finalized = stream.read(3) == b"MDF"
    for index, group in enumerate(file.groups):
        samples = _samples(file, index)
        size, invalid = _record_sizes(group.channel_group)
        wrong = ""
        if max(samples, 1) * max(size + invalid, 1) > _PACKING * source.size:
            wrong = f"claims {samples} samples of {size + invalid} bytes, more than this file can hold"
        elif not all(
            _is_possible(block, finalized and group.data_location == _ORIGINAL, source)
            for block in group.get_data_blocks()
        ):
            wrong = "has data that this file cannot hold"
        elif samples:
            outside = (c.name for c in group.channels if not _lies_within(c, size, invalid, file.version))
            name = next(outside, None)
            wrong = "" if name is None else f"has a channel {name[:60]} that lies outside its records of {size} bytes"
        if wrong:
            message = f"the MDF file is damaged: {_label(file, index)} {wrong}"
            raise InputError.of(source.name, message, "Copy or export it again.")


def _is_possible(block: Any, own: bool, source: MeasurementFile) -> bool:
    """Return whether a block of data may have the size that it claims, and ends within the file."""
    if block.original_size > _PACKING * max(int(block.compressed_size), 1):
        return False
    # the library copies what it sorts or finalizes
    return not own or bool(block.address + block.compressed_size <= source.size)


def _record_sizes(group: Any) -> tuple[int, int]:
    """Return the bytes of a record and of its invalidation bits."""
    return int(group.samples_byte_nr), int(getattr(group, "invalidation_bytes_nr", 0))


def _lies_within(channel: Any, size: int, invalid: int, version: str) -> bool:
    """Return whether the bits of a channel are bits of the record."""
    if version < "4":
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
    found = file.groups[group].channel_group
    said = str(getattr(found, "acq_name", "") or found.comment or "").strip().split("\n")[0]
    said = "" if said.startswith("<") else " ".join(said.split())[:60]
    return said or f"group {group + 1}"


def _entries(source: MeasurementFile, file: Any) -> list[_MdfChannel]:
    """Return all channels that hold samples, each with a name of its own; there has to be one."""
    found = [entry for group in range(len(file.groups)) if _samples(file, group) for entry in _of_group(file, group)]
    if not found:
        raise InputError.of(source.name, "holds no samples", "Is it the right file?")
    texts = _TEXT_4 if file.version >= "4" else _TEXT_3
    forms = [_forms(file, group, index, channel) for group, index, channel, _ in found]
    return [
        _MdfChannel(name, own, group, index, array, getattr(channel.conversion, "conversion_type", -1) in texts)
        for name, own, (group, index, channel, array) in zip(_unique(forms), forms, found, strict=True)
    ]


def _of_group(file: Any, group: int) -> list[tuple[int, int, Any, bool]]:
    """Return the channels of a group beside its time: group, number, channel and whether it is an array."""
    own = file.groups[group]
    found = []
    arrays: set[str] = set()
    for index, channel in enumerate(own.channels):
        parts = own.channel_dependencies[index] if own.channel_dependencies else None
        if index == file.masters_db.get(group) or not channel.name or (parts and isinstance(parts[0], tuple)):
            continue  # of a structure, the members are channels of their own
        if parts:
            arrays.add(channel.name)
        found.append((group, index, channel, bool(parts)))
    # the library lists the elements as well; read with their array they cost one look at its samples
    return [f for f in found if f[3] or _without_indices(f[2].name) not in arrays]


def _forms(file: Any, group: int, index: int, channel: Any) -> tuple[str, ...]:
    r"""Return names from short to unique; the part after a backslash is the device, as in `Speed\ETKC:1`."""
    label, full = _label(file, group), str(channel.name)
    short = full.partition("\\")[0] or full
    origin = getattr(channel.source, "name", "") or getattr(channel.source, "path", "") or label
    return (short, full, f"{label}/{short}", f"{label}/{full}", f"{origin}/{full}", f"{group + 1}.{index}/{full}")


def _unique(candidates: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the first name of each that no other channel, nor the time, has.

    >>> _unique([("n", "10ms/n"), ("n", "100ms/n"), ("time", "10ms/time"), ("T", "10ms/T")])
    ['10ms/n', '100ms/n', '10ms/time', 'T']
    """
    names = [names[0] for names in candidates]
    for level in range(1, len(candidates[0]) if candidates else 0):
        count = Counter([*names, _TIME])
        names = [c[level] if count[name] > 1 else name for name, c in zip(names, candidates, strict=True)]
    return names


def _ambiguous(entries: Sequence[_MdfChannel]) -> set[str]:
    return {name for name, count in Counter(entry.forms[0] for entry in entries).items() if count > 1}


def _names_by_group(entries: Sequence[_MdfChannel]) -> dict[int, tuple[str, ...]]:
    names: dict[int, list[str]] = {}
    for entry in entries:
        names.setdefault(entry.group, []).append(entry.name)
    return {group: tuple(own) for group, own in names.items()}


def _chosen(source: MeasurementFile, entries: Sequence[_MdfChannel], selection: Selection) -> list[_MdfChannel]:
    """Return the requested channels, by their name or, for an element of an array, by that of the array."""
    if selection.channels is None:
        return list(entries)
    meant = _meanings(entries)
    found: dict[_MdfChannel, None] = {}
    findings = []
    for asked in selection.channels:
        arrays = [entry for entry in meant.get(_without_indices(asked), ()) if entry.is_array]
        several = meant.get(asked, ())
        if len(several) == 1:
            found[replace(several[0], name=asked)] = None
        elif len(several) > 1:
            named = ", ".join(entry.name for entry in several[:6])
            message = f"{len(several)} channels are named {asked}"
            findings.append(Finding(source.name, message, f"Name one of them: {named}."))
        elif len(arrays) == 1:
            found[replace(arrays[0], name=_without_indices(asked))] = None
    if findings:
        raise InputError(findings)
    # if no channel matches, the group that is read lets the message list the available ones
    return list(found) or [entries[0]]


def _meanings(entries: Sequence[_MdfChannel]) -> dict[str, list[_MdfChannel]]:
    """Return the channels that each name may mean; the name under which a channel is listed means no other."""
    meant: dict[str, list[_MdfChannel]] = {}
    for entry in entries:
        for form in dict.fromkeys(entry.forms):
            meant.setdefault(form, []).append(entry)
    return meant | {entry.name: [entry] for entry in entries} | {_TIME: []}


def _without_indices(name: str) -> str:
    while name.endswith("]") and name.rpartition("[")[2][:-1].isdecimal():
        name = name.rpartition("[")[0]
    return name


def _table(source: MeasurementFile, file: Any, own: Sequence[_MdfChannel], names: tuple[str, ...]) -> Table:
    group = own[0].group
    channels = file.groups[group].channels
    fixed = [entry for entry in own if not _varies_in_length(file, entry)]
    signals = _signals(file, fixed)
    stamps = signals[fixed[0]].timestamps if fixed else file.get_master(group)
    count = len(stamps)
    clock = _clock(file, group, _valid(stamps, None))
    columns = [
        column
        for entry in own
        for column in (
            _columns(entry, channels[entry.index], signals[entry])
            if entry in signals
            else (_text(entry, count, "text or bytes of varying length"),)
        )
    ]
    spread = {entry.name for entry in own if entry.is_array}
    known = dict.fromkeys([*(n for n in names if n not in spread), *(column.name for column in columns)])
    times = () if clock is None else (clock,)
    label = _label(file, group)
    return Table(
        f"{source.name} group {label}" if not label.startswith("group ") else f"{source.name} {label}",
        (*times, *columns),
        np.arange(1, count + 1),
        "sample",
        (*(c.name for c in times), *known),
        details=(("group", label),),
        clock=clock,
    )


def _varies_in_length(file: Any, entry: _MdfChannel) -> bool:
    """Return whether samples are stored elsewhere; they are never numbers, so their links need not be followed."""
    return bool(file.version >= "4" and file.groups[entry.group].channels[entry.index].channel_type == _VARYING_4)


def _signals(file: Any, own: Sequence[_MdfChannel]) -> dict[_MdfChannel, Any]:
    """Return the samples of channels of one group, texts of enumerations left as the numbers they stand for."""
    found: dict[_MdfChannel, Any] = {}
    for raw in (False, True):
        # in version 3 the library has no other way to leave texts alone
        some = [entry for entry in own if (entry.is_text_table and file.version < "4") == raw]
        if some:
            asked = [(None, entry.group, entry.index) for entry in some]
            signals = file.select(asked, raw=raw, copy_master=False, ignore_value2text_conversions=True)
            found |= dict(zip(some, signals, strict=True))
    return found


def _clock(file: Any, group: int, stamps: Float) -> Column | None:
    """Return the time of a group, in the unit that the file states; None if it is an angle, distance or index."""
    index = file.masters_db.get(group)
    if index is None:
        return None
    master = file.groups[group].channels[index]
    if file.version >= "4" and getattr(master, "sync_type", 1) not in (0, 1):
        return None
    conversion = getattr(master, "conversion", None)
    unit = plain_unit(str(master.unit or getattr(conversion, "unit", "") or ""))
    return Column(_TIME, unit if not unit or in_seconds(unit) else "s", _TIME, stamps)


def _columns(entry: _MdfChannel, channel: Any, signal: Any) -> Iterator[Column]:
    """Return the column of a channel, or one for each element of an array; text gives a column of no numbers."""
    samples = signal.samples
    if samples.dtype.names:
        samples = samples[samples.dtype.names[0]]
    unit = _unit(entry, channel, signal)
    held = entry.is_text_table or samples.dtype.kind in "bui"
    said = _description_of(entry, channel)
    if samples.dtype.kind not in "buif" or (samples.ndim > 1 and not entry.is_array):
        sample = samples[0] if len(samples) else ""
        shown = sample.decode(errors="replace") if isinstance(sample, bytes) else str(sample)
        yield _text(entry, len(samples), shown.strip("\0 ")[:40])
        return
    for place in np.ndindex(samples.shape[1:]):
        name = entry.name + "".join(f"[{i}]" for i in place)
        values = _valid(samples[(slice(None), *place)], signal.invalidation_bits)
        yield Column(name, unit, name, values, held=held, description=said)


def _text(entry: _MdfChannel, count: int, sample: str) -> Column:
    """Return a channel that holds no numbers; it is kept so that a message can show what it holds."""
    return Column(entry.name, "", entry.name, np.full(count, np.nan), ((0, sample),), max(count, 1))


def _unit(entry: _MdfChannel, channel: Any, signal: Any) -> str:
    """Return the unit; of an enumeration, where the library takes a text for one, none."""
    if not entry.is_text_table:
        return plain_unit(str(signal.unit or ""))
    blocks = (getattr(channel.conversion, "referenced_blocks", None) or {}).values()
    texts = {block.decode("utf-8", errors="replace").strip("\0 ") for block in blocks if isinstance(block, bytes)}
    unit = plain_unit(str(channel.unit or ""))
    return "" if unit in texts else unit


def _valid(samples: Any, invalid: Any) -> Float:
    """Return the samples as float64, NaN if the logger marked them as invalid."""
    values = np.array(samples, dtype=np.float64)
    if invalid is not None:
        values[np.asarray(invalid, dtype=bool)] = np.nan
    values[np.isnan(values)] = np.nan  # a NaN that signals would set off warnings later
    return values


def _description_of(entry: _MdfChannel, channel: Any) -> str:
    """Return the comment, and of an enumeration the texts of its numbers."""
    comment = " ".join(str(channel.comment or "").split())
    comment = "" if comment.startswith("<") else comment[:200]
    if not entry.is_text_table:
        return comment
    pairs = list(_texts(channel.conversion))
    more = ", ..." if len(pairs) > _TEXTS_SAID else ""
    said = ", ".join(f"{number} = {text}" for number, text in pairs[:_TEXTS_SAID]) + more
    return f"{comment}: {said}" if comment else said


def _texts(conversion: Any) -> Iterator[tuple[str, str]]:
    """Return the numbers of an enumeration, as a message shows them, with their texts."""
    referenced = getattr(conversion, "referenced_blocks", None) or {}
    for i in range(10_000):
        text = referenced.get(f"text_{i}", getattr(conversion, f"text_{i}", None))
        low = getattr(
            conversion, f"val_{i}", getattr(conversion, f"param_val_{i}", getattr(conversion, f"lower_{i}", None))
        )
        if low is None:
            return
        if isinstance(text, bytes):
            high = getattr(conversion, f"upper_{i}", low)
            number = f"{low:g}" if math.isclose(low, high) else f"{low:g} to {high:g}"
            yield number, text.decode("utf-8", errors="replace").strip("\0 ")
