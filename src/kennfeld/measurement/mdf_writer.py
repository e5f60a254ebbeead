"""Writer of MDF 4 files: one channel group for each recording, with its time stamps as they are.

Missing values are marked by invalidation bits, and are NaN as well, for tools that ignore these.
"""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from importlib.util import find_spec
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.errors import Location
from kennfeld.base.optional_packages import optional_package
from kennfeld.base.quiet_loggers import quiet_loggers
from kennfeld.domain.dataset import Dataset
from kennfeld.measurement.mdf_start_time import HeaderTime
from kennfeld.measurement.writable_recording import WritableRecording

_PACKAGE = "asammdf"
_VERSION = "4.10"  # that all tools of the field read
_AT_ONCE = 1 << 18  # samples, which the library copies
_BY_INDEX = 4  # what kind of master channel numbers samples without time
_CLOCKS = ("time", "timestamps", "recording time")
_POINTS = ("sample", "number of sample")
_PIECES = ("piece", "number of piece")

Block = tuple[NDArray[Any], NDArray[np.bool_] | None]  # samples, and which of them are invalid


def require_library(path: Path) -> None:
    """Raise `InputError` if the library that writes MDF is not installed."""
    with optional_package(Location(path.name), "mdf"):
        if find_spec(_PACKAGE) is None:
            raise ModuleNotFoundError(name=_PACKAGE)


def write_mdf(recordings: Iterable[WritableRecording], path: Path, comment: str) -> list[str]:
    """Write recordings into a file, one after the other.

    The header states the start time of the first recording that has one, 1970 if none has. Time stamps are not
    changed, so that they align with those of each recording by itself; the comment of a group has its own start time.

    Args:
        recordings: each becomes a channel group.
        path: the file to write, of any name.
        comment: what the file is.

    Returns:
        The different start times of the recordings, as texts.

    Raises:
        OSError: the file cannot be written.
        InputError: the library is not installed.
    """
    with optional_package(Location(path.name), "mdf"):
        from asammdf import MDF
    begins: dict[datetime, None] = {}
    with (
        quiet_loggers("asammdf"),
        TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as folder,
        MDF(version=_VERSION, temporary_folder=folder) as file,
        path.open("w+b") as stream,
    ):
        for recording in recordings:
            begins |= {} if recording.start_time is None else {recording.start_time: None}
            _append(file, recording)
        header: Any = file.header
        begin = next(iter(begins), None)
        times = HeaderTime(0) if begin is None else HeaderTime.of(begin)
        header.abs_time, header.tz_offset, header.daylight_save_time, header.time_flags = times
        header.comment = comment
        file.save(stream)
    return [begin.isoformat(" ") for begin in begins]


def _append(file: Any, recording: WritableRecording) -> None:
    """Add a channel group, block by block."""
    from asammdf import Signal

    channels = recording.channels
    # the first block decides for the whole group which channels have invalidation bits
    gaps = [any(np.isnan(part[c.name].values).any() for part in recording.parts) for c in channels]
    # numbers of pieces rise, so the ends of each part show whether there are several
    numbered = len({int(n) for pieces in recording.pieces for n in (pieces[0], pieces[-1])}) > 1
    names = {channel.name for channel in channels}
    blocks = _blocks(recording, gaps, numbered)
    (master, _), *columns = next(blocks)
    clock = (_free(_CLOCKS, names), 1) if recording.is_timed else (_free(_POINTS, names), _BY_INDEX)
    texts = [(c.name, c.unit, c.description) for c in channels]
    texts += [(_free(_PIECES, names), "", "number of the piece; the function starts anew with each")] * numbered
    signals = [
        Signal(
            values,
            master,
            name=name,
            unit=unit,
            comment=text,
            master_metadata=clock,
            invalidation_bits=invalid,
        )
        for (name, unit, text), (values, invalid) in zip(texts, columns, strict=True)
    ]
    file.append(signals, acq_name=recording.name, comment=recording.description, common_timebase=True)
    for block in blocks:
        file.extend(len(file.groups) - 1, block)


def _blocks(recording: WritableRecording, gaps: list[bool], numbered: bool) -> Iterator[list[Block]]:
    """Yield the master channel, all channels, and the numbers of pieces if they differ, of blocks of samples."""
    before = 0
    for part, here, pieces in recording.blocks(_AT_ONCE):
        time = np.arange(before, before + pieces.size, dtype=np.float64) if part.time is None else part.time[here]
        before += pieces.size
        columns = (_block(part, channel.name, here, gap) for channel, gap in zip(recording.channels, gaps, strict=True))
        own = [(pieces.astype(np.uint32), None)] if numbered else []
        yield list(chain([(time, None)], columns, own))


def _block(part: Dataset, name: str, here: slice, gap: bool) -> Block:
    values = part[name].values[here]
    return values, np.isnan(values) if gap else None


def _free(names: Sequence[str], taken: set[str]) -> str:
    numbered = (f"{names[0]} {number}" for number in count(2))
    return next(name for name in chain(names, numbered) if name not in taken)
