"""Finds test data that are training data too: the same files, or the same samples."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from kennfeld.base.errors import Finding, Location
from kennfeld.optimize.problem.overlap import HOLD_BACK, overlap_findings
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.preprocessing.recording_sources import find_addresses
from kennfeld.project.schema import ProjectFile


def seen_test_data(file: ProjectFile, problem: Problem, locations: Mapping[str, Location]) -> list[Finding]:
    """Return a warning for each test dataset with files or samples that are training data too.

    Args:
        file: the project.
        problem: its problem.
        locations: locations of the datasets, by name.
    """
    of_files = list(_shared_files(file))
    known = {str(finding.location) for finding in of_files}
    of_samples = overlap_findings(problem, lambda data: locations[data.name])
    return [*of_files, *(finding for finding in of_samples if str(finding.location).partition(" (")[0] not in known)]


def _shared_files(file: ProjectFile) -> Iterator[Finding]:
    """Yield test files with the content of training files, unless conditions select different samples."""
    training = [entry for entry in file.datasets if entry.is_fitted]
    for test in (entry for entry in file.datasets if entry.use == "test"):
        others = [entry for entry in training if entry.where == test.where and entry.steady == test.steady]
        fitted = {path: None for entry in others for path in _paths(file, entry)}
        pairs = [(path, other) for path in _paths(file, test) for other in fitted if _is_same(path, other)]
        first: dict[str, str] = {}
        for path, other in pairs:
            first.setdefault(path, other)
        if first:
            yield Finding(
                test.location, "; ".join(_sentence(*pair) for pair in first.items()), HOLD_BACK, severity="warning"
            )


def _paths(file: ProjectFile, entry: DatasetEntry) -> list[str]:
    return list(dict.fromkeys(path for pattern in entry.files for path in find_addresses(file.folder, pattern)))


def _sentence(path: str, other: str) -> str:
    name, same = Path(path).name, Path(other).name
    if path == other:
        return f"the test file {name} is also a training file"
    return f"the test file {name} has the same content as the training file {same if same != name else other}"


def _is_same(path: str, other: str) -> bool:
    """Return whether two files, or sheets of workbooks, have the same content; reads only files of the same size."""
    if path == other:
        return True
    (first, sheet), (second, other_sheet) = _split_sheet(path), _split_sheet(other)
    try:
        return (
            sheet == other_sheet and first.stat().st_size == second.stat().st_size and _digest(first) == _digest(second)
        )
    except OSError:
        return False


def _split_sheet(path: str) -> tuple[Path, str]:
    """Return file and sheet of `file.xlsx#sheet`."""
    whole = Path(path)
    if whole.is_file():
        return whole, ""
    name, _, sheet = path.rpartition("#")
    return Path(name), sheet


def _digest(path: Path) -> bytes:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()
