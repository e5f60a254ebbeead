"""Which files a report rests on, so that it can be told later whether these are still the same."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from kennfeld.project import Project
from kennfeld.project.files import matching

__all__ = ["SourceFile", "sources"]


@dataclass(frozen=True)
class SourceFile:
    """A file as it was when the report was made; `digest` is its SHA-256, empty where it could not be read."""

    role: str
    name: str
    size: int
    changed: str
    digest: str


def sources(project: Project) -> list[SourceFile]:
    """The project file and every file that it names, each once."""
    found: dict[Path, str] = {}
    for role, path in _named(project):
        found.setdefault(path, role)
    return [_source(role, path, project.file.folder) for path, role in found.items()]


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
            for path in matching(file.folder, pattern):
                yield f"data, {entry.use}", _without_sheet(path)


def _without_function(path: Path) -> Path:
    """The file of `module.py:function`."""
    return path if path.is_file() else path.with_name(path.name.partition(":")[0])


def _without_sheet(path: str) -> Path:
    """The file of `file.xlsx#sheet`."""
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
