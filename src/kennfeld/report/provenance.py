"""Provenance of a report: the settings of the project that differ from defaults, and its files with hashes."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.preprocessing.recordings import find_recordings
from kennfeld.project import Project
from kennfeld.project.schema import TargetEntry

Row = tuple[str, str, str]  # section, key, value

_HIDDEN = ("path", "name", "place", "findings")
_SINGULAR = {"criteria": "criterion", "equalities": "equality"}


def settings(project: Project) -> list[Row]:
    """Return the settings of a project file that differ from their defaults, by section."""
    rows: list[Row] = []
    for field in fields(project.file):
        value = getattr(project.file, field.name)
        if field.name not in _HIDDEN:
            rows += _part(field.name, value)
    return rows


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
    return field.default is not MISSING and type(field.default) is type(value) and bool(field.default == value)


def format_setting(value: Any) -> str:
    """Format a setting as short text.

    >>> format_setting((0.0, 600.0)), format_setting({"x": 0.1}), format_setting(np.zeros((20, 20)))
    ('0, 600', 'x 0.1', '20 x 20 values from 0 to 0')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.8g}"
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {format_setting(inner)}" for key, inner in value.items())
    if isinstance(value, TargetEntry):
        return (
            format_setting(value.value)
            if value.kind == "number"
            else f"{value.kind} {value.name}".removeprefix("name ")
        )
    if hasattr(value, "__dataclass_fields__"):
        return ", ".join(f"{key} {text}" for _, key, text in _entry("", value) if text)
    if isinstance(value, Sequence) and not isinstance(value, str):
        shown = [format_setting(inner) for inner in value[:40]]
        return ", ".join([*shown, f"... {len(value)} in all"] if len(value) > 40 else shown)
    return str(value)


def _array(value: Any) -> str:
    if value.size == 1:
        return f"{value.item():.8g}"
    shape = " x ".join(map(str, value.shape))
    return f"{shape} values from {np.nanmin(value):.6g} to {np.nanmax(value):.6g}"


@dataclass(frozen=True)
class SourceFile:
    """A file at the time of the report; `digest` is its SHA-256 in hex, empty if it could not be read."""

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
    return [_source(role, path, project.file.folder) for path, role in roles.items()]


def _named(project: Project) -> Iterator[tuple[str, Path]]:
    file = project.file
    yield "project", file.path
    yield "model", _without_function(file.folder / file.model.file)
    for name in file.model.parameters:
        yield "values of the model", file.folder / name
    for name in file.surrogates.values():
        yield "surrogate", file.folder / name
    for name in file.calibration.initial:
        yield "start", file.folder / name
    for name in file.calibration.descriptions.values():
        yield "start", file.folder / name
    for entry in file.datasets:
        for pattern in entry.files:
            for path in find_recordings(file.folder, pattern):
                yield f"data, {entry.use}", _without_sheet(path)


def _without_function(path: Path) -> Path:
    """Return the file of `module.py:function`."""
    return path if path.is_file() else path.with_name(path.name.partition(":")[0])


def _without_sheet(path: str) -> Path:
    """Return the file of `file.xlsx#sheet`."""
    whole = Path(path)
    return whole if whole.is_file() else Path(path.rpartition("#")[0])


def _source(role: str, path: Path, folder: Path) -> SourceFile:
    name = str(path.relative_to(folder)) if path.is_relative_to(folder) else str(path)
    try:
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        state = path.stat()
    except OSError:
        return SourceFile(role, name, 0, "", "")
    changed = datetime.fromtimestamp(state.st_mtime).astimezone().isoformat(" ", "seconds")
    return SourceFile(role, name, state.st_size, changed, digest)
