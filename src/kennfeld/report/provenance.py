"""Provenance of a report: the settings of the project that differ from defaults, and its files with hashes."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.formatting import size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import map_in_order
from kennfeld.preprocessing.recording_sources import find_addresses, is_remote, size_in_store
from kennfeld.project import Project
from kennfeld.project.label_selection import listed_files
from kennfeld.project.value_forms import TargetEntry

Row = tuple[str, str, str]  # section, key, value

_HIDDEN = ("path", "name", "location", "lines")
_SINGULAR = {"criteria": "criterion", "equalities": "equality"}


def settings(project: Project) -> list[Row]:
    """Return the settings of a project file that differ from their defaults, by section."""
    sections = {field.name: getattr(project.file, field.name) for field in fields(project.file)}
    return [row for name, value in sections.items() if name not in _HIDDEN for row in _part(name, value)]


def _part(name: str, value: Any) -> Iterator[Row]:
    """Return the rows of a section, a table of sections, or a list of them."""
    if is_dataclass(value):
        yield from _entry(name, value, complete=name == "optimizer")
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            if is_dataclass(inner):
                yield from _entry(f"{name}.{key}", inner)
            else:
                yield name, key, format_setting(inner)
    elif isinstance(value, tuple):
        for number, inner in enumerate(value, 1):
            if is_dataclass(inner):
                title = getattr(inner, "name", "") or getattr(inner, "node", "") or str(number)
                yield from _entry(f"{_SINGULAR.get(name, name.removesuffix('s'))} {title}", inner)


def _entry(section: str, entry: Any, *, complete: bool = False) -> Iterator[Row]:
    for field in fields(entry):
        value = getattr(entry, field.name)
        if field.name in _HIDDEN or value is None:
            continue
        if complete or not _is_default(value, field):
            yield section, field.name, format_setting(value)


def _is_default(value: Any, field: Any) -> bool:
    if isinstance(value, np.ndarray):
        return False
    if isinstance(value, tuple | Mapping) and not value:
        return True
    # of one type: 1 and True are equal, and so are 0 and 0.0
    return field.default is not MISSING and type(field.default) is type(value) and bool(field.default == value)


def format_setting(value: Any) -> str:
    """Format a setting as short text.

    >>> format_setting((0.0, 600.0)), format_setting({"x": 0.1}), format_setting(np.zeros((20, 20)))
    ('0, 600', 'x 0.1', '20 x 20 values from 0 to 0')
    """
    # ahead of the numbers, as a bool is an int
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.8g}"
    if isinstance(value, np.ndarray):
        if value.size == 1:
            return f"{value.item():.8g}"
        return f"{size_text(value.shape)} values from {np.nanmin(value):.6g} to {np.nanmax(value):.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {format_setting(inner)}" for key, inner in value.items())
    if isinstance(value, TargetEntry):
        number = format_setting(value.value)
        return number if value.kind == "number" else f"{value.kind} {value.name}".removeprefix("name ")
    if is_dataclass(value):
        return ", ".join(f"{key} {text}" for _, key, text in _entry("", value) if text)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join([*map(format_setting, value[:40]), *([f"... {len(value)} in all"] if value[40:] else [])])
    return str(value)


@dataclass(frozen=True)
class SourceFile:
    """A file at the time of the report; `digest` is its SHA-256 in hex.

    It is empty if the file could not be read, or is a recording that workers read: a fleet takes too long.
    """

    role: str
    name: str
    size: int
    changed: str
    digest: str


def sources(project: Project) -> list[SourceFile]:
    """Return the project file and every file that it names, each once."""
    roles: dict[Path, str] = {}
    for role, path in _named(project):
        roles.setdefault(path, role)
    addresses: dict[str, str] = {}
    for role, address in _recordings(project):
        addresses.setdefault(address, role)
    # sheets of one file are listed once
    for address, role in addresses.items() if not project.is_partitioned else ():
        roles.setdefault(_file_of(address), role)
    files = list(map_in_order(partial(_source, folder=project.file.folder), list(roles.items())))
    return files + [
        _recording(address, role, project.file.folder) for address, role in addresses.items() if project.is_partitioned
    ]


def _recordings(project: Project) -> Iterator[tuple[str, str]]:
    for entry in project.file.datasets:
        for pattern in entry.files:
            yield from ((f"data, {entry.use}", at) for at in find_addresses(project.file.folder, pattern))


def _file_of(address: str) -> Path:
    """Return the file of an address; `file.xlsx#sheet` is a sheet of a file."""
    return Path(address if Path(address).is_file() else address.rpartition("#")[0])


def _named(project: Project) -> Iterator[tuple[str, Path]]:
    file = project.file
    yield "project", file.path
    model = file.folder / file.model.file
    # `module.py:function` is a function of a file
    yield "model", model if model.is_file() else model.with_name(model.name.partition(":")[0])
    patterns = (pattern for entry in file.datasets for pattern in entry.database_files)
    yield from (("CAN database", Path(path)) for each in patterns for path in find_addresses(file.folder, each))
    yield from (("values of the model", file.folder / name) for name in file.model.parameters)
    yield from (("surrogate", file.folder / name) for name in file.surrogates.values())
    lists = listed_files([*file.calibration.free, *(pattern for step in file.steps for pattern in step.free or ())])
    yield from (("label list", file.folder / name) for name in dict.fromkeys(lists))
    starts = (*file.calibration.files, *file.calibration.descriptions.values())
    yield from (("start", file.folder / name) for name in starts)
    if file.calibration.storage:
        yield "storage", file.folder / file.calibration.storage


def _source(file: tuple[Path, str], folder: Path) -> SourceFile:
    path, role = file
    try:
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        digest = ""
    return _state(path, role, folder, digest)


def _recording(address: str, role: str, folder: Path) -> SourceFile:
    """Return a recording without its digest."""
    if is_remote(address):
        return SourceFile(role, address, size_in_store(address), "", "")
    return _state(_file_of(address), role, folder, "")


def _state(path: Path, role: str, folder: Path, digest: str) -> SourceFile:
    name = str(path.relative_to(folder)) if path.is_relative_to(folder) else str(path)
    try:
        state = path.stat()
    except OSError:
        return SourceFile(role, name, 0, "", "")
    changed = datetime.fromtimestamp(state.st_mtime).astimezone().isoformat(" ", "seconds")
    return SourceFile(role, name, state.st_size, changed, digest)
