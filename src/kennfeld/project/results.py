"""Writes the results folder of a calibration, completely or not at all."""

import csv
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.output_paths import below
from kennfeld.calfiles import unwritable
from kennfeld.calfiles import write as write_parameters
from kennfeld.calfiles.label_list import ENDING as LABEL_LIST
from kennfeld.calfiles.label_list import VALUES as CHANGED_VALUES
from kennfeld.calfiles.label_list import write_label_list
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.rbf import RBF
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.project.csv_cells import neutral_cell
from kennfeld.project.folder_replacement import LOCK, move, scratch_folder
from kennfeld.project.manifest import KEY, compute_digests
from kennfeld.project.simulation import Simulation
from kennfeld.project.simulation_files import save
from kennfeld.project.simulation_files import write_simulation as write_simulation

if TYPE_CHECKING:
    from kennfeld.optimize.fit.result import Result, TraceLine
    from kennfeld.optimize.trust.trust import Trust

COLUMNS = (
    *("parameter", *AXIS_LETTERS, "value", "unit", "deviation", "scatter"),
    *("samples", "leverage", "informed", "by_smoothness"),
)
MAX_LEVERAGE_VALUES = 2000  # the cost of the leverage grows with the third power

FOLDER = "results"  # beside the project file
RESULT = "result.json"
PROPOSALS = "proposals.json"  # of `kennfeld propose`
CHANGES = f"changed{LABEL_LIST}"
VALIDATION = "cross_validation"  # its key of a cross-validation
REMEDY, FILE_REMEDY = "Name another folder with -o.", "Name another file with -o."


def write_trust(trust: "Trust", parameters: ParameterSet, path: Path) -> None:
    """Write trust.csv: a line for each free value, breakpoints last; unknown cells are empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        leverage = affordable_leverage(trust)
        for name in trust.deviation:
            writer.writerows(_lines(trust, name, *_values(name, parameters), leverage.get(name)))


def affordable_leverage(trust: "Trust") -> Mapping[str, Float]:
    """Return the leverage of each value; nothing if there are too many values to compute it."""
    return trust.leverage if sum(a.size for a in trust.deviation.values()) <= MAX_LEVERAGE_VALUES else {}


def _values(name: str, parameters: ParameterSet) -> tuple[Float, str, list[list[float | str]]]:
    """Return the values of a parameter or axis, their unit, and its breakpoints (names, for an expansion)."""
    if name in parameters:
        table = parameters[name]
        if isinstance(table, RBF):
            return table.values, table.unit, [[table.value_name(i) for i in range(table.size)]]
        return table.values, table.unit, [axis.breakpoints.tolist() for axis in table.index_axes]
    place = next(axis.places[0] for key, axis in free_axes(parameters).items() if name in (str(key), f"axis {key}"))
    axis = parameters[place[0]].axes[place[1]]
    return axis.breakpoints, axis.unit, [np.arange(1.0, len(axis) + 1).tolist()]


def _lines(
    trust: "Trust",
    name: str,
    values: Float,
    unit: str,
    breakpoints: Sequence[list[float | str]],
    leverage: Float | None,
) -> Iterator[list[Any]]:
    for at in np.ndindex(values.shape):
        place = [_cell(points[i]) for points, i in zip(breakpoints, at, strict=True)]
        yield [
            neutral_cell(name),
            *(place + [""] * (len(AXIS_LETTERS) - len(place))),
            float(values[at]),
            neutral_cell(unit),
            *(_number(array[at]) for array in (trust.deviation[name], trust.scatter[name])),
            int(trust.samples[name][at]),
            "" if leverage is None else _number(leverage[at]),
            *(int(flags[name][at]) for flags in (trust.informed, trust.by_smoothness)),
        ]


def _cell(value: float | str) -> float | str:
    return neutral_cell(value) if isinstance(value, str) else value


def _number(value: Any) -> float | str:
    return "" if np.isnan(value) else float(f"{value:.6g}")


class ResultSource(Protocol):
    """The part of a project that results need."""

    @property
    def formats(self) -> Sequence[str]:
        """File extensions of the calibration formats to write, such as `.dcm`."""

    @property
    def further_results(self) -> Sequence[str]:
        """File extensions of further results: of simulations such as `.mf4`, or `.lab` of the changed labels."""

    @property
    def surrogates(self) -> Collection[str]:
        """Names of the surrogates, which have files of their own."""

    @property
    def is_partitioned(self) -> bool:
        """True if data are evaluated in partitions; their simulation is not a part of the results."""

    def change_of_function(self, parameters: ParameterSet, ending: str) -> ParameterSet:
        """Return parameters as a change of the function's file, if files with this ending are copies of it."""

    def simulation(
        self, parameters: ParameterSet | None = None, shifts: Mapping[str, Mapping[str, float]] | None = None
    ) -> Simulation:
        """Return nodes and targets over all datasets, to be computed part by part."""


def write(
    result: "Result",
    project: ResultSource,
    folder: str | Path,
    documents: Mapping[str, str] | None = None,
    further: Mapping[str, Any] | None = None,
    findings: Findings | None = None,
) -> tuple[Path, ...]:
    """Write a result into a folder and return the paths of its files.

    Existing files of these names are replaced, all of them or none. `result.json` comes last and lists the SHA-256 of
    the others except `documents`, which can be regenerated. An image that cannot hold the values is skipped, and so are
    parameters whose name a format cannot represent; `parameters.json` has all of them.

    Args:
        result: the calibration.
        project: the project that was calibrated.
        folder: the results folder.
        documents: texts of further files, by name.
        further: additional keys of `result.json`.
        findings: collects the findings about the calibration files.

    Raises:
        InputError: the folder cannot be written.
    """
    target = Path(folder)
    simulation = None if project.is_partitioned else project.simulation(result.parameters, result.shifts)
    with _scratch(target) as scratch:
        for ending in dict.fromkeys((".json", *project.formats)):
            values = project.change_of_function(result.parameters.without(project.surrogates), ending)
            remarks = _write_values(values, scratch / f"parameters{ending}")
            if findings is not None:
                findings.add(*remarks)
        _write_trace(result.trace, scratch / "trace.csv")
        write_trust(result.trust, result.parameters, scratch / "trust.csv")
        if simulation is not None:
            others = [ending for ending in project.further_results if ending not in (LABEL_LIST, CHANGED_VALUES)]
            for ending in dict.fromkeys((".parquet", *others)):
                remarks = _write_simulation(simulation, scratch / f"simulation{ending}")
                if findings is not None:
                    findings.add(*remarks)
        if LABEL_LIST in project.further_results:
            remarks = _write_changes(result, project.surrogates, scratch / CHANGES)
            if findings is not None:
                findings.add(*remarks)
        if CHANGED_VALUES in project.further_results:
            remarks = _write_changed_values(result, project, scratch)
            if findings is not None:
                findings.add(*remarks)
        names = sorted(path.name for path in scratch.iterdir() if path.name != LOCK)
        content = result.as_json() | dict(further or {}) | {KEY: compute_digests(scratch, names)}
        for name, text in (documents or {}).items():
            (scratch / name).write_text(text, encoding="utf-8", newline="\n")
        (scratch / RESULT).write_text(_json_text(content), encoding="utf-8", newline="\n")
        names += [*(documents or {}), RESULT]
        move(names, scratch, target)
    for ending in project.formats:
        # an old image beside new results would be flashed as if it were theirs
        if ending in IMAGE_ENDINGS and f"parameters{ending}" not in names:
            (target / f"parameters{ending}").unlink(missing_ok=True)  # of an earlier run
    return tuple(target / name for name in names)


def write_validation(validation: Mapping[str, Any], folder: Path) -> Path:
    """Write `cross_validation.json`, and the same as a key of the `result.json` of the run, if that is in the folder.

    Raises:
        InputError: the folder cannot be written.
    """
    written = write_text(_json_text(validation), folder / "cross_validation.json")
    path = folder / RESULT
    if path.is_file():
        content = json.loads(path.read_text(encoding="utf-8"))
        # the manifest stays the last key
        files = {KEY: content.pop(KEY)} if KEY in content else {}
        write_text(_json_text(content | {VALIDATION: validation} | files), path)
    return written


def _json_text(content: Mapping[str, Any]) -> str:
    return f"{json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)}\n"


def read_shifts(folder: Path) -> dict[str, dict[str, float]]:
    """Return the estimated shifts of the result in a folder, by dataset and channel; empty if it has no result.

    Raises:
        InputError: its `result.json` is damaged.
    """
    path = folder / RESULT
    if not path.is_file():
        return {}
    try:
        shifts = json.loads(path.read_text(encoding="utf-8")).get("shifts", {})
        return {
            name: {channel: float(shift) for channel, shift in channels.items()} for name, channels in shifts.items()
        }
    except (OSError, ValueError, TypeError, AttributeError) as error:
        message = f"its shifts cannot be read ({error})"
        raise InputError.of(
            Location.of_file(path), message, "Calibrate again, or move the calibration file."
        ) from error


def _write_values(parameters: ParameterSet, path: Path) -> Sequence[Finding]:
    try:
        return write_parameters(parameters, path)
    except InputError as error:
        if path.suffix in IMAGE_ENDINGS:
            return error.findings
        skipped = unwritable(parameters, path.suffix) if path.suffix != ".json" else {}
        if not skipped:
            raise
        warnings = [replace(f, remedy="parameters.json has it.", severity="warning") for f in skipped.values()]
        return [*warnings, *write_parameters(parameters.without(skipped), path)]


def _write_changes(result: "Result", surrogates: Collection[str], path: Path) -> Sequence[Finding]:
    """Write the names of the parameters and group axes that a calibration has changed as a label list."""
    from kennfeld.calfiles.comparison import compare  # for label lists alone

    before, after = (parameters.without(surrogates) for parameters in (result.start, result.parameters))
    text, findings = write_label_list(compare(before, after).labels, path.name)
    path.write_text(text, encoding="utf-8", newline="")
    return findings


def _write_changed_values(result: "Result", project: ResultSource, folder: Path) -> Sequence[Finding]:
    """Write `changed` in the formats of the project: the parameters that a calibration has changed, and no others.

    Images, and formats whose files are copies of another one, always hold all values: these are left out.
    """
    from kennfeld.calfiles.comparison import changed

    before, after = (parameters.without(project.surrogates) for parameters in (result.start, result.parameters))
    values, findings = changed(after, before), Findings()
    for ending in project.formats:
        path = folder / f"{Path(CHANGES).stem}{ending}"
        if ending in IMAGE_ENDINGS:
            continue
        try:
            findings.add(*write_parameters(values.without(unwritable(values, ending)), path))
        except InputError as error:
            findings.remark(Location(path.name), f"is not written: {error.findings[0].message}")
    return list(findings)


def _write_simulation(simulation: Simulation, path: Path) -> Sequence[Finding]:
    """Write a simulation; a format that cannot hold it is left out, so that the other results are not lost."""
    findings = Findings()
    try:
        save(simulation, path, path, findings)
    except InputError as error:
        path.unlink(missing_ok=True)
        return error.findings
    return list(findings)


def results_folder(project: Path, folder: str | Path | None = None) -> Path:
    """Return the folder of the results of a project file: the one that the user names, or `results` beside the file.

    Raises:
        InputError: it is a symbolic link, or is reached by one within the folder of the project.
    """
    target = Path(folder) if folder else project.parent / FOLDER
    with convert_errors(target, "cannot be written", REMEDY):
        return below(project.parent, target)


def output_file(project: Path, file: Path) -> Path:
    """Return a file to write that the user named for a project file.

    Raises:
        InputError: it is within the folder of the project, and reached by a symbolic link.
    """
    with convert_errors(file, "cannot be written", FILE_REMEDY):
        return below(project.parent, file)


def require_room(folder: str | Path) -> None:
    """Raise `InputError` if a folder cannot be written; leaves no trace."""
    target = Path(folder)
    created = [path for path in (target, *target.parents) if not path.exists()]
    try:
        with _scratch(target) as scratch:
            (scratch / "result.json").write_bytes(b"{}")
    finally:
        # only empty folders can be removed this way
        for path in created:
            with suppress(OSError):
                path.rmdir()


def write_text(text: str, path: str | Path, *, follow: bool = False) -> Path:
    """Write a text file, completely or not at all; with `follow`, a symbolic link stays one, else it is replaced."""
    target = Path(path)
    with convert_errors(target, "cannot be written", FILE_REMEDY):
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, text, durable=True, follow=follow)
    return target


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder within `folder`, which is created if needed; remove it at the end in any case."""
    with convert_errors(folder, "cannot be written", REMEDY), scratch_folder(folder) as scratch:
        yield scratch


def _write_trace(trace: Sequence["TraceLine"], path: Path) -> None:
    from kennfeld.optimize.fit.result import TraceLine

    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(field.name for field in fields(TraceLine))
        writer.writerows([_cell(value) for value in astuple(line)] for line in trace)
