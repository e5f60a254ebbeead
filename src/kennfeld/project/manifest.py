"""The manifest of a run, `files` in its `result.json`: which files belong together, each with its SHA-256."""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.calfiles import endings
from kennfeld.errors import Finding, InputError

__all__ = ["KEY", "digests", "require_one_run", "warnings_of_others"]

KEY = "files"
RUN_AGAIN = "Run kennfeld calibrate again."


def digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of each file, by name."""
    return {name: _digest(folder / name) for name in names}


def require_one_run(folder: Path, result: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise `InputError` if files are missing, or not those that were written together with the `result.json`.

    Args:
        folder: the results folder.
        result: the contents of its `result.json`; those of older versions have no manifest, and nothing is checked.
        names: the files that are going to be read. One that the manifest does not list is not checked.
    """
    manifest = result.get(KEY, {})
    listed = [name for name in names if name in manifest]
    findings = [Finding(str(folder / name), "is missing", RUN_AGAIN) for name in listed if not (folder / name).exists()]
    other = [name for name in listed if (folder / name).exists() and _digest(folder / name) != manifest[name]]
    if other:
        findings.append(Finding(str(folder), _sentence(other), RUN_AGAIN))
    if findings:
        raise InputError(findings)


def warnings_of_others(folder: Path, result: Mapping[str, Any], read: Collection[str]) -> list[Finding]:
    """Return a warning if files of other runs are beside those in `read`, or changed ones: calibration files above all.

    Files that are missing, and files of another name than those of a run, are none of its business.
    """
    manifest = result.get(KEY)
    if not manifest:
        return []
    names = dict.fromkeys([*manifest, *(f"parameters{ending}" for ending in endings())])
    there = [name for name in names if name not in read and (folder / name).is_file()]
    other = [name for name in there if _digest(folder / name) != manifest.get(name)]
    return [Finding(str(folder), _sentence(other), severity="warning")] if other else []


def _sentence(names: Sequence[str]) -> str:
    verb = "do" if len(names) > 1 else "does"
    return f"{', '.join(names)} {verb} not belong to result.json: written by another run, or changed since"


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, or nothing if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
