"""Writer of MATLAB files (version 5): a struct for each recording, with a column vector for each channel.

`drive.time` are the time stamps, `drive.TorquePredict` is a channel, `drive.units.TorquePredict` its unit. A name that
MATLAB cannot have becomes a similar one; `drive.names` has all true names.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.errors import InputError, Location
from kennfeld.matlab.variable_names import KEYWORDS, variable_name
from kennfeld.measurement.writable_recording import WritableRecording

_FIELDS = ("info", "time", "piece", "names", "units", "comments")
_MOST_BYTES = 2**31 - 2**20  # of a variable, with what its fields take beyond their numbers


def write_matlab(recordings: Iterable[WritableRecording], path: Path, name: str) -> None:
    """Write recordings into a file, one after the other.

    Args:
        recordings: each becomes a variable.
        path: the file to write, of any name.
        name: how messages name the file.

    Raises:
        OSError: the file cannot be written.
        InputError: a recording is larger than a variable of MATLAB 5 may be.
    """
    from scipy.io import savemat

    used = {*KEYWORDS}
    with path.open("wb") as stream:
        savemat(stream, {})  # what follows on the stream is appended
        for recording in recordings:
            _check_size(recording, name)
            variables = {_name(recording.name, used): _struct(recording)}
            savemat(stream, variables, long_field_names=True, oned_as="column")


def _check_size(recording: WritableRecording, name: str) -> None:
    size = 8 * recording.samples * (len(recording.channels) + 2)
    if size > _MOST_BYTES:
        message = f"{recording.name} takes {size / 1e9:.1f} GB, and a variable of MATLAB 5 holds less than 2.1 GB"
        raise InputError.of(Location(name), message, "Write .mf4 or .parquet, or fewer files at a time.")


def _name(name: str, used: set[str]) -> str:
    """Return a name of a variable: `y_error` of `y (error)`."""
    return variable_name("_".join(re.findall(r"[A-Za-z0-9_]+", name)), used)


def _struct(recording: WritableRecording) -> dict[str, Any]:
    used = {*KEYWORDS, *_FIELDS}
    names = {_name(channel.name, used): channel for channel in recording.channels}
    begin = recording.start_time
    info = {
        "dataset": recording.dataset,
        "use": recording.use,
        "file": recording.file,
        "start_time": "" if begin is None else begin.isoformat(),
    }
    return {
        "info": info,
        **({"time": recording.time()} if recording.is_timed else {}),
        "piece": np.concatenate(recording.pieces).astype(np.float64),
        **{field: recording.values(channel.name) for field, channel in names.items()},
        "names": {field: channel.name for field, channel in names.items()},
        "units": {field: channel.unit for field, channel in names.items()},
        "comments": {field: channel.description for field, channel in names.items()},
    }
