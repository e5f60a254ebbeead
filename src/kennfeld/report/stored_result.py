"""Results of earlier runs, read back from their folders, and the summary of their uncertainty."""

import csv
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, fields
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles import read as read_parameters
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.fit.result import Result, Seconds, StartResult, TraceLine
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.quality.recording_quality import RecordingQuality, WorstStretch
from kennfeld.optimize.rounding.outcome import ERRORS, LabelRounding, RoundingResult
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.trust.trust import Trust
from kennfeld.project.csv_cells import original_cell
from kennfeld.project.folder_replacement import finish_interrupted
from kennfeld.project.manifest import KEY, require_one_run
from kennfeld.project.manifest import RUN_AGAIN as AGAIN
from kennfeld.project.results import VALIDATION, affordable_leverage

COLUMNS = {
    "samples": np.int64,
    "deviation": np.float64,
    "leverage": np.float64,
    "informed": bool,
    "by_smoothness": bool,
}
READ = ("parameters.json", "trace.csv", "trust.csv")  # in addition to result.json


@dataclass(frozen=True)
class RemedyText:
    """A sentence on undetermined values, and its remedy."""

    sentence: str
    remedy: str


@dataclass(frozen=True)
class TrustSummary:
    """Known parts of a trust, by parameter or axis with free breakpoints; unknown parts are empty."""

    informed: Mapping[str, Bool] = field(default_factory=dict)
    samples: Mapping[str, Int] = field(default_factory=dict)
    deviation: Mapping[str, Float] = field(default_factory=dict)
    leverage: Mapping[str, Float] = field(default_factory=dict)
    by_smoothness: Mapping[str, Bool] = field(default_factory=dict)
    directions: tuple[RemedyText, ...] = ()
    coupled: tuple[str, ...] = ()  # a sentence for each direction that is coupled, but determined
    null_space: RemedyText | None = None
    holdings: tuple[str, ...] = ()  # a sentence for each active limit
    remark: str = ""


def summarise_trust(trust: Trust) -> TrustSummary:
    """Return the summary of a trust, without the leverage if it has too many values."""
    null_space = trust.null_space
    return TrustSummary(
        informed=trust.informed,
        samples=trust.samples,
        deviation=trust.deviation,
        leverage=affordable_leverage(trust),
        by_smoothness=trust.by_smoothness,
        directions=tuple(RemedyText(each.sentence, each.remedy) for each in trust.directions if not each.determined),
        coupled=tuple(each.sentence for each in trust.directions if each.determined),
        null_space=RemedyText(null_space.sentence, null_space.advice) if null_space.sentence else None,
        holdings=tuple(map(str, trust.holdings)),
        remark=trust.remark,
    )


def read_trust(folder: Path, parameters: ParameterSet) -> TrustSummary:
    """Read the trust in `trust.csv` and `result.json`; empty if they are missing, damaged or of another result.

    Nothing is raised, since a report is correct without it.
    """
    try:
        return TrustSummary(**_sentences(folder / "result.json"), **_tables(folder, parameters))
    except (OSError, ValueError, KeyError, TypeError):
        return TrustSummary()


def _sentences(path: Path) -> dict[str, Any]:
    trust = json.loads(path.read_text(encoding="utf-8")).get("trust") or {}
    space = trust.get("null_space") or {}
    entries = trust.get("directions", [])
    return {
        "directions": tuple(RemedyText(e["sentence"], e["remedy"]) for e in entries if not e.get("determined")),
        "coupled": tuple(entry["sentence"] for entry in entries if entry.get("determined")),
        "null_space": RemedyText(space["sentence"], space["remedy"]) if space.get("sentence") else None,
        "holdings": tuple(entry["sentence"] for entry in trust.get("holdings", [])),
        "remark": trust.get("remark", ""),
    }


def _tables(folder: Path, parameters: ParameterSet) -> dict[str, Any]:
    """Return an array for each column and each parameter or axis whose rows are complete."""
    path = folder / "trust.csv"
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = [row | {"parameter": original_cell(row["parameter"])} for row in csv.DictReader(file)]
    arrays: dict[str, dict[str, Any]] = {column: {} for column in COLUMNS}
    for name, group in groupby(rows, key=lambda row: row["parameter"]):
        lines = list(group)
        shape = parameters[name].values.shape if name in parameters else (len(lines),)
        for column, kind in COLUMNS.items() if int(np.prod(shape)) == len(lines) else ():
            values = np.array([float(line[column] or "nan") for line in lines]).reshape(shape)
            if not np.isnan(values).all():
                arrays[column][name] = values.astype(kind)
    return arrays


def read_result(folder: Path, problem: Problem) -> tuple[Result, Mapping[str, Any]] | None:
    """Read the result in a folder and the contents of its `result.json`; None if there is no result.

    An interrupted replacement of the folder is completed first.

    Raises:
        InputError: files are missing, damaged, of another run or of another function; reports all of them.
    """
    finish_interrupted(folder)
    paths = {name: folder / name for name in ("result.json", "parameters.json", "trace.csv")}
    if not any(path.is_file() for path in paths.values()):
        return None
    if missing := [Location.of_file(path) for path in paths.values() if not path.is_file()]:
        message = "file not found, although other files of a run exist"
        raise InputError(Finding(location, message, AGAIN) for location in missing)
    with _refuse_damaged(paths["result.json"]):
        contents = json.loads(paths["result.json"].read_text(encoding="utf-8"))
        contents = {**contents, KEY: dict(contents.get(KEY, {}))}
    # first, since files of two runs can be read without an error
    require_one_run(folder, contents, READ)
    parameters = _parameters(paths["parameters.json"], problem)
    trace = _trace(paths["trace.csv"])
    with _refuse_damaged(paths["result.json"]):
        return _result(contents, problem.parameters, parameters, trace), contents


def read_validation(folder: Path, contents: Mapping[str, Any]) -> CrossValidation | None:
    """Return the cross-validation in the contents of a `result.json`, if there is one.

    Raises:
        InputError: it is damaged.
    """
    stored = contents.get(VALIDATION)
    if stored is None:
        return None
    with _refuse_damaged(folder / "result.json"):
        return CrossValidation.from_json(stored)


@contextmanager
def _refuse_damaged(path: Path) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"not a valid result file ({type(error).__name__}: {error})"
        raise InputError.of(Location.of_file(path), message, AGAIN) from None


def _parameters(path: Path, problem: Problem) -> ParameterSet:
    """Read the values of a run; bounds and locks stay those of the project."""
    stored = read_parameters(path)
    findings, parameters = Findings(), []
    location = Location.of_file(path)
    surrogates = {surrogate.name for surrogate in problem.model.surrogates}  # these have files of their own
    for name, count in problem.model.graph.parameters.items():
        if name in surrogates:
            continue
        own = problem.parameters[name]
        if name not in stored:
            findings.error(location, f"parameter {name} is missing, but the function uses it", AGAIN)
        elif stored[name].coordinates != count:
            message = f"{name} has {stored[name].coordinates} axes, but the function looks it up with {count}"
            findings.error(location, message, AGAIN)
        # values on another grid: one pair of bounds that contains those of all values
        elif stored[name].values.shape != own.values.shape:
            spread = {"lower": own.lower.min(), "upper": own.upper.max(), "locked": own.locked.all()}
            parameters.append(stored[name].changed(extrapolation=own.extrapolation, **spread))
        else:
            parameters.append(own.changed(values=stored[name].values, axes=stored[name].axes))
    findings.finish()
    return problem.parameters.merged(ParameterSet(parameters))


def _result(contents: Any, start: ParameterSet, parameters: ParameterSet, trace: tuple[TraceLine, ...]) -> Result:
    return Result(
        **_select(contents, "status", "message", "iterations", "evaluations"),
        parameters=parameters,
        start=start,
        quality=tuple(Quality(**_select(row, *_names(Quality))) for row in contents["quality"]),
        trace=trace,
        **_costs(contents),
        free_values=contents["values"]["free"],
        fixed_values=contents["values"]["fixed"],
        seconds=Seconds(**{name: contents["seconds"].get(name, 0.0) for name in _names(Seconds)}),
        starts=tuple(_start(row) for row in contents.get("starts", ())),
        smoothness=_by_name(contents, "smoothness"),
        shifts=_by_name(contents, "shifts"),
        warnings=tuple(
            Finding(Location(), row["sentence"].removesuffix("."), row["remedy"], severity="warning")
            for row in contents.get("warnings", ())
        ),
        recordings=tuple(_recording(row) for row in contents.get("recordings", ())),
        certificate=_certificate(contents.get("certificate")),
        rounding=_rounding(contents.get("rounding")),
    )


def _rounding(row: Any) -> RoundingResult | None:
    """Return the rounding of a result; None if it was not rounded."""
    if row is None:
        return None
    errors: dict[str, Any] = {key: {name: _known(error) for name, error in row[key].items()} for key in ERRORS}
    labels = (
        LabelRounding(name, **_select(label, *_names(LabelRounding)[1:])) for name, label in row["labels"].items()
    )
    return RoundingResult(row["method"], row["max_shift"], **errors, labels=tuple(labels), finer=row["finer"])


def _certificate(row: Any) -> Certificate | None:
    """Return the certificate of a result; those of older versions have none."""
    return None if row is None else Certificate(**_select(row, *Certificate._fields))


def _recording(row: Any) -> RecordingQuality:
    worst = row["worst"] and WorstStretch(**_select(row["worst"], *_names(WorstStretch)))
    plain = _select(row, *(name for name in _names(RecordingQuality) if name not in ("file", "worst")))
    return RecordingQuality(**plain, file=row["file"], worst=worst)


def _by_name(contents: Any, key: str) -> dict[str, dict[str, float]]:
    """Return automatic settings by table and axis or by dataset and channel; results of older versions have none."""
    settings = contents.get(key, {})
    return {name: {inner: float(number) for inner, number in row.items()} for name, row in settings.items()}


def _start(row: Any) -> StartResult:
    plain = _select(row, "start", "status", "message", "iterations", "evaluations", "distance")
    return StartResult(**plain, **_costs(row))


def _costs(row: Any) -> dict[str, Any]:
    return {f"cost_{name}": _known(row["cost"][name]) for name in ("before", "after")}


def _select(row: Any, *names: str) -> dict[str, Any]:
    return {name: _known(row[name]) for name in names}


def _known(value: Any) -> Any:
    # null stands for NaN
    return float("nan") if value is None else value


def _names(kind: type) -> list[str]:
    return [field.name for field in fields(kind)]


def _trace(path: Path) -> tuple[TraceLine, ...]:
    kinds = {field.name: field.type for field in fields(TraceLine)}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    try:
        cells = [{name: original_cell(row[name]) for name in kinds} for row in rows]
        return tuple(TraceLine(**{name: kind(row[name]) for name, kind in kinds.items()}) for row in cells)  # type: ignore[operator]
    except (ValueError, KeyError, TypeError):
        raise InputError.of(Location.of_file(path), "not a valid trace file", AGAIN) from None
