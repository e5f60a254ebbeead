"""A result is not lost because its folder cannot be written."""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from kennfeld.calfiles import write as write_parameters
from kennfeld.errors import Finding, InputError
from kennfeld.optimize import Result
from kennfeld.project.results import ResultSource, write

__all__ = ["write_somewhere"]


def write_somewhere(
    result: Result,
    project: ResultSource,
    folder: str | Path,
    documents: Mapping[str, str],
    further: Mapping[str, Any] | None,
    told: list[Finding],
) -> tuple[Path, ...]:
    """Write like `results.write`; if that fails, into a new folder for temporary files, or the parameters alone.

    The reason and the place are added to `told` as errors. No path is returned if nothing could be written anywhere.
    """
    try:
        return write(result, project, folder, documents, further, told)
    except InputError as error:
        reasons = list(error.findings)
    except Exception as error:  # hours of search must not be lost to a fault in a writer
        reasons = [Finding(str(folder), f"cannot be written ({type(error).__name__}: {error})")]
    written = _elsewhere(lambda other: write(result, project, other, documents, further)) or _elsewhere(
        lambda other: (_write_values(result, project, other),)
    )
    place = f"Written to {written[0].parent} instead." if written else "Nor can a temporary folder."
    told += [replace(reason, remedy=place) for reason in reasons]
    return written


def _elsewhere(attempt: Callable[[Path], tuple[Path, ...]]) -> tuple[Path, ...]:
    """Return what an attempt writes into a new temporary folder, nothing if it fails."""
    with suppress(Exception):
        other = Path(tempfile.mkdtemp(prefix="kennfeld-results-"))
        try:
            return attempt(other)
        except BaseException:
            shutil.rmtree(other, ignore_errors=True)
            raise
    return ()


def _write_values(result: Result, project: ResultSource, folder: Path) -> Path:
    path = folder / "parameters.json"
    write_parameters(result.parameters.without(project.surrogates), path)
    return path
