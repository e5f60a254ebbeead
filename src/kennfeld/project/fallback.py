"""Writes results elsewhere if their folder cannot be written, so that a long search is not lost."""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.calfiles import write as write_parameters
from kennfeld.optimize.fit.result import Result
from kennfeld.project.results import ResultSource, write, write_validation

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate


def write_somewhere(
    result: Result,
    project: ResultSource,
    folder: str | Path,
    documents: Mapping[str, str],
    further: Mapping[str, Any] | None,
    findings: Findings,
) -> tuple[Path, ...]:
    """Write like `results.write`; if that fails, into a new temporary folder, or only the parameters there.

    Returns the paths of the files, none if nothing could be written. Adds the reasons to `findings` as errors.
    """
    try:
        return write(result, project, folder, documents, further, findings)
    except InputError as error:
        reasons = list(error.findings)
    except Exception as error:  # hours of search must not be lost because of a bug in a writer
        reasons = [Finding(Location.of_file(folder), f"cannot be written ({type(error).__name__}: {error})")]
    written = _write_temporary(
        lambda temporary: write(result, project, temporary, documents, further)
    ) or _write_temporary(lambda temporary: (_write_values(result, project, temporary),))
    findings.add(*_elsewhere(InputError(reasons), written))
    return written


def write_validation_somewhere(validation: Mapping[str, Any], folder: Path, findings: Findings) -> tuple[Path, ...]:
    """Write a cross-validation like `results.write_validation`; if that fails, into a new temporary folder.

    Returns the paths of the files, none if nothing could be written. Adds the reasons to `findings` as errors.
    """
    try:
        return (write_validation(validation, folder),)
    except InputError as error:
        written = _write_temporary(lambda temporary: (write_validation(validation, temporary),))
        findings.add(*_elsewhere(error, written))
        return written


def write_surrogate_somewhere(surrogate: "Surrogate", path: Path, findings: Findings) -> Path | None:
    """Write a surrogate; if that fails, into a new temporary folder.

    Returns the path, None if it could not be written. Adds the reasons to `findings` as errors.
    """
    from kennfeld.surrogate.surrogate_file import write_surrogate

    def attempt(temporary: Path) -> tuple[Path, ...]:
        write_surrogate(surrogate, temporary / path.name)
        return (temporary / path.name,)

    try:
        write_surrogate(surrogate, path)
    except InputError as error:
        written = _write_temporary(attempt)
        findings.add(*_elsewhere(error, written))
        return written[0] if written else None
    return path


def _elsewhere(error: InputError, written: tuple[Path, ...]) -> list[Finding]:
    """Return why something was not written where it should, and where it is."""
    remedy = f"Written to {written[0].parent} instead." if written else "A temporary folder cannot be written either."
    return [replace(reason, remedy=remedy) for reason in error.findings]


def _write_temporary(attempt: Callable[[Path], tuple[Path, ...]]) -> tuple[Path, ...]:
    """Return the paths that an attempt writes into a new temporary folder, none if it fails."""
    with suppress(Exception):
        temporary = Path(tempfile.mkdtemp(prefix="kennfeld-results-"))
        try:
            return attempt(temporary)
        # an empty folder would otherwise stay behind each failed attempt
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
    return ()


def _write_values(result: Result, project: ResultSource, folder: Path) -> Path:
    path = folder / "parameters.json"
    write_parameters(result.parameters.without(project.surrogates), path)
    return path
