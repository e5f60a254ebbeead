"""The contents of a file, as `kennfeld info` shows them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass

Table = Sequence[Sequence[str]]  # the heading first


@dataclass(frozen=True)
class FileInfo:
    """Contents of a file: a sentence, tables and notes for a person, `as_json` for a program."""

    summary: str
    tables: Sequence[Table]
    notes: Sequence[str]
    as_json: Mapping[str, Any]


@dataclass(frozen=True)
class DescribedFile:
    """A file to describe, and what the command line says about it.

    Attributes:
        path: the file.
        a2l: the description of an image; by default the A2L file of the same name.
        dbc: CAN databases of a bus log.
        choice: what follows the name of a file of functions and a colon.
        options: what to import of a model, as `models.importer.ImportOptions`.
    """

    path: Path
    a2l: str | Path | None = None
    dbc: Sequence[str] = ()
    choice: str = ""
    options: Any = None


def json_entry(content: str, path: Path, **entries: Any) -> dict[str, Any]:
    """Return what `--json` prints of a file."""
    return {"content": content, "file": path.name, **plain(entries)}


def plain(value: Any) -> Any:
    """Return containers and numbers that JSON can hold; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def without_empty(rows: Sequence[Sequence[str]], *optional: str) -> Table:
    """Leave out the optional columns that are empty throughout."""
    used = [i for i, heading in enumerate(rows[0]) if heading not in optional or any(row[i] for row in rows[1:])]
    return [[row[i] for i in used] for row in rows]
