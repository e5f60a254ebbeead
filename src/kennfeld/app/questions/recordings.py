"""The recordings of the project: their files, channels, and what the function reads of them."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.proposal import Range, propose
from kennfeld.app.session.session import Session
from kennfeld.errors import InputError
from kennfeld.measurement.reader import describe
from kennfeld.preprocessing.recordings import find_recordings

MAX_CHANNELS = 2000  # of a file that the files of a project are listed with
MAX_SIGNALS = 20_000  # of a file that can be searched


def files(session: Session, given: Given) -> Answer:
    """Return the files of each dataset with their channels, and the inputs and targets of the function.

    The project may be incomplete: what its file says counts.
    """
    folder, entries = session.path.parent, _entries(session)
    rows = [
        {
            "number": number,
            "name": str(entry.get("name", "")),
            "use": str(entry.get("use", "training")),
            "files": [_listed(_file(folder, path)) for path in _paths(folder, entry)],
        }
        for number, entry in enumerate(entries, 1)
    ]
    return Answer({"datasets": rows, "inputs": _inputs(session)})


def _listed(file: dict[str, Any]) -> dict[str, Any]:
    return {**file, "channels": file["channels"][:MAX_CHANNELS]}


def _entries(session: Session) -> list[Mapping[str, Any]]:
    entries = session.settings.get("dataset", [])
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _paths(folder: Path, entry: Mapping[str, Any]) -> list[str]:
    patterns = entry.get("files", [])
    patterns = [patterns] if isinstance(patterns, str) else patterns
    return [path for pattern in patterns for path in find_recordings(folder, str(pattern))]


def recording_names(session: Session) -> list[str]:
    """Return the names of the files of all datasets."""
    folder = session.path.parent
    return [Path(path.partition("#")[0]).name for entry in _entries(session) for path in _paths(folder, entry)]


def channel_names(session: Session) -> list[str]:
    """Return the names of the channels of all files, each once."""
    folder = session.path.parent
    files = (_file(folder, path) for entry in _entries(session) for path in _paths(folder, entry))
    return list(dict.fromkeys(channel["name"] for file in files for channel in file["channels"]))


def channel_ranges(session: Session) -> dict[str, Range]:
    """Return the range of every channel of the training files."""
    ranges: dict[str, Range] = {}
    folder = session.path.parent
    training = [entry for entry in _entries(session) if entry.get("use", "training") == "training"]
    for path in (path for entry in training for path in _paths(folder, entry)):
        for channel in _file(folder, path)["channels"]:
            if channel["least"] is not None:
                known = ranges.get(channel["name"], Range(channel["least"], channel["greatest"]))
                low, high = min(known.least, channel["least"]), max(known.greatest, channel["greatest"])
                ranges[channel["name"]] = Range(low, high)
    return ranges


def recorded_channels(session: Session, number: int) -> dict[str, str]:
    """Return all channels of the files of a dataset, counted from 0, with their units."""
    entries = _entries(session)
    paths = _paths(session.path.parent, entries[number]) if number < len(entries) else []
    files = [_file(session.path.parent, path) for path in paths]
    return {channel["name"]: channel["unit"] for file in files for channel in file["channels"]}


def proposals(session: Session, given: Given) -> Answer:
    """Return what the function needs and the project lacks, with the keys that provide it."""
    function = session.function
    if function is None:
        return Answer({"proposals": []})
    known = session.initial_names
    return Answer(
        {
            "proposals": [
                {
                    "title": each.title,
                    "changes": each.changes,
                    "choice": None if each.choice is None else vars(each.choice),
                }
                for each in propose(function, session.settings, known, channel_ranges(session))
            ]
        }
    )


def _file(folder: Path, path: str) -> dict[str, Any]:
    plain = Path(path.partition("#")[0])
    try:
        state = plain.stat()
        return _described(str(folder), path, state.st_mtime_ns, state.st_size)
    except OSError as error:
        return {"name": plain.name, "error": error.strerror or str(error), "channels": []}


@lru_cache(maxsize=512)
def _described(folder: str, path: str, modified: int, size: int) -> dict[str, Any]:
    """Describe a file; `modified` and `size` tell whether it has changed."""
    shown = str(Path(path).relative_to(folder)) if Path(path).is_relative_to(folder) else path
    try:
        tables = describe(path).tables
    except InputError as error:
        return {"name": shown, "size": size, "error": str(error), "channels": []}
    channels = [channel for table in tables for channel in table.channels][:MAX_SIGNALS]
    time = next((table.time for table in tables if table.time is not None), None)
    return {
        "name": shown,
        "size": size,
        "samples": max((table.samples for table in tables), default=0),
        "step": None if time is None else time.step,
        "length": None if time is None else time.end - time.begin,
        "missing": max((channel.nan_share for channel in channels), default=0.0),
        "channels": [
            {
                "name": channel.name,
                "unit": channel.unit,
                "least": None if channel.minimum is None else finite(channel.minimum),
                "greatest": None if channel.maximum is None else finite(channel.maximum),
            }
            for channel in channels
        ],
    }


def _inputs(session: Session) -> list[dict[str, Any]]:
    """Return the inputs of the function and the targets of its criteria, each with its channel."""
    function, settings = session.function, session.settings
    if function is None:
        return []
    graph, mapped = function.graph, settings.get("channels", {})
    scalars = {*session.initial_names, *settings.get("parameters", {})}
    rows: list[dict[str, Any]] = [
        {"name": name, "role": "input", "unit": graph.units.get(name, ""), "channel": str(mapped.get(name, name))}
        for name in graph.inputs
        if name not in scalars
    ]
    for number, entry in enumerate(settings.get("criterion", []), 1):
        target = entry.get("target")
        channel = target.get("channel") if isinstance(target, dict) else target
        node = str(entry.get("node", ""))
        if isinstance(channel, str):
            unit = graph.units.get(node, "")
            rows.append({"name": node, "role": "target", "number": number, "unit": unit, "channel": channel})
    return rows
