"""Content of a control unit: rounded values, code of the function with them, and the files that are written."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kennfeld.app.folders import writable
from kennfeld.app.session.calibration_source import SourceName, initial_image, is_image
from kennfeld.app.session.rounding import SetRounding, round_set
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.app.session.taking import values_of
from kennfeld.base.errors import ArgumentError, Finding, Findings, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import losses
from kennfeld.calfiles import write as write_parameters
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import RoundingMethod, StorageRounding
from kennfeld.export.api import ExportContents, ExportSettings, project_contents, write_files
from kennfeld.export.comparison import CodeComparison

Applied = Literal["", "nearest", "joint"]  # empty: the values as they are
FOLDER = "export"
PARAMETERS = "parameters"  # name of calibration files
SIGNALS = "simulation.mf4"
Contents = Mapping[str, str | bytes]


@dataclass(frozen=True)
class UnitFiles:
    """Files with a set of values that are written together.

    Attributes:
        files: content by name.
        findings: remarks on them.
        comparison: of the compiled C code with the simulation; None without C code, data or compiler.
    """

    files: Contents
    findings: tuple[Finding, ...]
    comparison: CodeComparison | None


def rounding_of(session: Session) -> StorageRounding | None:
    """Return the rounding of the project, None if it has none or cannot be read."""
    return None if session.view is None else session.view.model.problem.rounding


def storage_keys(session: Session, changes: Mapping[str, float | None], storage: str | None) -> SetKeys:
    """Return the command that sets steps of parameters and the A2L file, with the keys that these require.

    Args:
        session: the open project.
        changes: the step by parameter, None to remove it.
        storage: the A2L file, empty to remove it, None to leave it as it is.
    """
    keys: list[tuple[tuple[str | int, ...], Any]] = [
        (("parameters", name, "step"), step) for name, step in changes.items()
    ]
    if storage is not None:
        keys.append((("calibration", "storage"), storage or None))
    calibration = _table(session.settings.get("calibration"))
    parameters = _table(session.settings.get("parameters"))
    steps = {**{name: _table(entry).get("step") for name, entry in parameters.items()}, **changes}
    file = calibration.get("storage") if storage is None else storage
    image = initial_image(session) is not None and "rounding" in calibration
    if file or image or any(step is not None for step in steps.values()):
        keys += [] if "rounding" in calibration else [(("calibration", "rounding"), "joint")]
    else:
        keys += [(("calibration", name), None) for name in ("rounding", "max_shift") if name in calibration]
    title = f"Storage: {storage or 'none'}" if storage is not None else f"Step of {', '.join(changes)}"
    return session.key_command(title, keys)


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def rounded_set(session: Session, source: SourceName, method: RoundingMethod) -> SetRounding:
    """Round a set of values, once for as long as values and project stay the same.

    In place of values that a run has rounded, its fit is rounded.

    Raises:
        ArgumentError: the project has no rounding, or the set does not exist.
        InputError: the project cannot be read.
    """
    key = (str(source.from_), source.file, method)
    kept = session.roundings.get(key)
    if kept is not None and kept[0] == session.revision:
        return kept[1]
    parameters, run = _fit_of(session, values_of(session, source))
    with session.evaluated() as project:
        problem = project.problem()
        if problem.rounding is None:
            raise ArgumentError("no step is known to round to; type one, or choose an A2L file")
        rounded = round_set(problem, parameters, method, run)
    for each in [each for each, (revision, _) in session.roundings.items() if revision != session.revision]:
        del session.roundings[each]
    session.roundings[key] = session.revision, rounded
    return rounded


def _fit_of(session: Session, parameters: ParameterSet) -> tuple[ParameterSet, int]:
    """Return the fit of the run that ended with these values and rounded them, and its number; else the values."""
    free = session.require_view().model.problem.free_names
    for run in reversed(session.runs):
        outcome = run.result.rounding
        if outcome is not None and outcome.fit is not None and _are_equal(run.result.parameters, parameters, free):
            fitted = {name: outcome.fit[name] for name in free}
            return parameters.with_parameters(*fitted.values()), run.number
    return parameters, 0


def _are_equal(first: ParameterSet, second: ParameterSet, names: Sequence[str]) -> bool:
    return all(
        name in first
        and first[name].has_grid_of(second[name])
        and np.array_equal(first[name].values, second[name].values)
        for name in names
    )


def applied_values(session: Session, source: SourceName, applied: Applied) -> ParameterSet:
    """Return a set of values as it is written."""
    return values_of(session, source) if applied == "" else rounded_set(session, source, applied).parameters


def code_of(session: Session, values: ParameterSet, settings: ExportSettings) -> ExportContents:
    """Return the function of the project with values as code; see `project_contents`."""
    session.require_view()
    with session.evaluated() as project:
        return project_contents(project, values, settings)


def unit_files(
    session: Session,
    values: ParameterSet,
    languages: Sequence[ExportSettings],
    endings: Sequence[str],
    *,
    signals: bool = False,
) -> UnitFiles:
    """Return the files with a set of values.

    Args:
        session: the open project.
        values: the set.
        languages: in which the function is written.
        endings: of calibration files.
        signals: write what the function calculates with the set over all data, as MDF.

    Raises:
        ArgumentError: nothing is chosen, or two files have the same name.
        InputError: a format cannot hold the function or its values.
    """
    files: dict[str, str | bytes] = {}
    findings: list[Finding] = []
    comparison = None
    for settings in languages:
        contents = code_of(session, values, settings)
        _add(files, contents.files)
        findings += contents.findings
        comparison = contents.comparison or comparison
    written, remarks = _calibration_files(session, values, endings)
    _add(files, written)
    findings += remarks
    if signals:
        own, remarks = _signals(session, values)
        _add(files, own)
        findings += remarks
    if not files:
        raise ArgumentError("no file is chosen")
    return UnitFiles(files, tuple(dict.fromkeys(findings)), comparison)


def _signals(session: Session, values: ParameterSet) -> tuple[dict[str, bytes], list[Finding]]:
    """Return all nodes, targets and errors over all recordings as an MDF file, as `kennfeld simulate` writes them."""
    from kennfeld.project.simulation_files import write_simulation

    findings = Findings()
    with session.evaluated() as project, tempfile.TemporaryDirectory(prefix="kennfeld-") as folder:
        path = write_simulation(project.simulation(values), Path(folder) / SIGNALS, findings=findings)
        return {SIGNALS: path.read_bytes()}, list(findings)


def _add(files: dict[str, str | bytes], further: Contents) -> None:
    if twice := files.keys() & further.keys():
        raise ArgumentError(f"two of the files would be called {min(twice)}; leave one of them out")
    files |= further


def _calibration_files(
    session: Session, values: ParameterSet, endings: Sequence[str]
) -> tuple[dict[str, bytes], list[Finding]]:
    files: dict[str, bytes] = {}
    findings: list[Finding] = []
    project = session.project
    assert project is not None
    values = values.without(project.surrogates)
    with tempfile.TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as name:
        for ending in endings:
            path = Path(name) / f"{PARAMETERS}{ending}"
            image, a2l = (initial_image(session) or (None, None)) if is_image(path.name) else (None, None)
            own = project.change_of_function(values, ending)
            for finding in (*write_parameters(own, path, image, a2l), *losses(own, path)):
                # the folder it is in does not last
                file = finding.location.file and Path(finding.location.file).name
                findings.append(replace(finding, location=replace(finding.location, file=file)))
            files[path.name] = path.read_bytes()
    return files, findings


def existing_files(session: Session, folder: str, files: Contents) -> list[str]:
    """Return the names of the files that exist with another content."""
    return [name for name, content in files.items() if _differs(_target(session, folder) / name, content)]


def _differs(path: Path, content: str | bytes) -> bool:
    raw = content.encode("utf-8") if isinstance(content, str) else content
    return path.exists() and not (path.is_file() and path.read_bytes() == raw)


def write_together(session: Session, folder: str, files: Contents) -> list[str]:
    """Write files into a folder of the project, all or none; return their paths relative to that of the project.

    Raises:
        InputError: one cannot be written; no file has changed then.
    """
    target = _target(session, folder)
    for name in files:
        writable(target, name)
    return [path.relative_to(session.path.parent).as_posix() for path in write_files(files, target)]


def _target(session: Session, folder: str) -> Path:
    name = folder.strip() or FOLDER
    target = writable(session.path.parent, name)
    if target.exists() and not target.is_dir():
        raise ArgumentError(f"{Location(name)} is a file, not a folder")
    return target
