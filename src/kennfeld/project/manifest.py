"""Manifest of a run, `files` in its `result.json`: the SHA-256 of the files that belong together."""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.calfiles import endings

KEY = "files"
RUN_AGAIN = "Run kennfeld calibrate again."


def compute_digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of each file, by name."""
    return {name: _digest(folder / name) for name in names}


def require_one_run(folder: Path, result: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise `InputError` if files are missing or were not written together with `result.json`.

    Args:
        folder: the results folder.
        result: the contents of its `result.json`; without a manifest (older versions), nothing is checked.
        names: the files to be read; those that the manifest does not list are not checked.
    """
    manifest = result.get(KEY, {})
    listed = [name for name in names if name in manifest]
    findings = [
        Finding(Location.of_file(folder / name), "the file is missing", RUN_AGAIN)
        for name in listed
        if not (folder / name).exists()
    ]
    other = [name for name in listed if (folder / name).exists() and _digest(folder / name) != manifest[name]]
    if other:
        findings.append(Finding(Location.of_file(folder), _mismatch(other), RUN_AGAIN))
    if findings:
        raise InputError(findings)


def check_other_files(folder: Path, result: Mapping[str, Any], read: Collection[str]) -> list[Finding]:
    """Return a warning if result files other than those in `read` are from another run or changed since.

    Missing files, and files with names that no run writes, are ignored.
    """
    manifest = result.get(KEY)
    if not manifest:
        return []
    # also formats that this run did not write: those of an earlier run may still be there
    names = dict.fromkeys([*manifest, *(f"parameters{ending}" for ending in endings())])
    there = [name for name in names if name not in read and (folder / name).is_file()]
    other = [name for name in there if _digest(folder / name) != manifest.get(name)]
    return [Finding(Location.of_file(folder), _mismatch(other), severity="warning")] if other else []


def _mismatch(names: Sequence[str]) -> str:
    verb = "do" if len(names) > 1 else "does"
    return f"{', '.join(names)} {verb} not belong to result.json: written by another run, or changed since"


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, or nothing if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
