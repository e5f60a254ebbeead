"""Results of earlier runs, read back from their folders, and the summary of their uncertainty."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.calfiles import read as read_parameters
from kennfeld.errors import Finding, InputError
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import Quality
from kennfeld.optimize.result import Result, Seconds, StartResult, TraceLine
from kennfeld.parameter_set import ParameterSet
from kennfeld.project.folder_replacement import finish_interrupted
from kennfeld.project.manifest import KEY, require_one_run
from kennfeld.project.manifest import RUN_AGAIN as AGAIN

MAX_LEVERAGE_VALUES = 2000  # computing the leverage costs the third power of the number of values

COLUMNS = ("samples", "deviation", "leverage", "informed", "by_smoothness")
FLAGS = ("informed", "by_smoothness")

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
    null_space: RemedyText | None = None
    holdings: tuple[str, ...] = ()  # a sentence for each active limit
    remark: str = ""


def summarise_trust(trust: Any) -> TrustSummary:
    """Return the summary of a trust: an object with these attributes, or a mapping of the informed values alone."""
    if trust is None:
        return TrustSummary()
    if isinstance(trust, Mapping):
        return TrustSummary(informed=trust)
    directions = tuple(
        RemedyText(str(d.sentence), str(getattr(d, "remedy", ""))) for d in getattr(trust, "directions", ())
    )
    space = getattr(trust, "null_space", None)
    null_space = RemedyText(str(space.sentence), str(space.advice)) if space is not None and space.sentence else None
    holdings = tuple(str(holding) for holding in getattr(trust, "holdings", ()))
    remark = str(getattr(trust, "remark", ""))
    values = sum(np.size(array) for array in (getattr(trust, "deviation", None) or {}).values())
    parts = [
        "informed",
        "samples",
        "deviation",
        "by_smoothness",
        *(["leverage"] if values <= MAX_LEVERAGE_VALUES else []),
    ]
    known = {name: getattr(trust, name, None) for name in parts}
    arrays: dict[str, Any] = {name: value for name, value in known.items() if isinstance(value, Mapping)}
    return TrustSummary(directions=directions, null_space=null_space, holdings=holdings, remark=remark, **arrays)


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
    return {
        "directions": tuple(RemedyText(entry["sentence"], entry["remedy"]) for entry in trust.get("directions", [])),
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
        rows = list(csv.DictReader(file))
    arrays: dict[str, dict[str, Any]] = {column: {} for column in COLUMNS}
    for name, group in groupby(rows, key=lambda row: row["parameter"]):
        lines = list(group)
        shape = parameters[name].values.shape if name in parameters else (len(lines),)
        if int(np.prod(shape)) == len(lines):
            for column in COLUMNS:
                values = _column(lines, column).reshape(shape)
                if not np.isnan(values).all():
                    arrays[column][name] = _typed(column, values)
    return arrays


def _column(lines: Sequence[Mapping[str, str]], column: str) -> Float:
    return np.array([float(line[column] or "nan") for line in lines])


def _typed(column: str, values: Float) -> Any:
    if column in FLAGS:
        return values != 0
    return values.astype(np.int64) if column == "samples" else values


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
    missing = [
        Finding(str(path), "file not found, although other files of a run exist", AGAIN)
        for path in paths.values()
        if not path.is_file()
    ]
    if missing:
        raise InputError(missing)
    contents = _contents(paths["result.json"])
    require_one_run(folder, contents, READ)
    parameters = _parameters(paths["parameters.json"], problem)
    trace = _trace(paths["trace.csv"])
    try:
        return _result(contents, problem.parameters, parameters, trace), contents
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise _invalid_result(paths["result.json"], error) from None


def _contents(path: Path) -> dict[str, Any]:
    try:
        contents = json.loads(path.read_text(encoding="utf-8"))
        return {**contents, KEY: dict(contents.get(KEY, {}))}
    except (ValueError, TypeError, AttributeError) as error:
        raise _invalid_result(path, error) from None


def _invalid_result(path: Path, error: Exception) -> InputError:
    return InputError.of(str(path), f"not a valid result file ({type(error).__name__}: {error})", AGAIN)


def _parameters(path: Path, problem: Problem) -> ParameterSet:
    """Read the values of a run; bounds and locks stay those of the project."""
    stored = read_parameters(path)
    findings, parameters = [], []
    surrogates = {surrogate.name for surrogate in problem.model.surrogates}  # these have files of their own
    for name, count in problem.model.graph.parameters.items():
        if name in surrogates:
            continue
        own = problem.parameters[name]
        if name not in stored:
            findings.append(Finding(str(path), f"parameter {name} is missing, but the function uses it", AGAIN))
        elif stored[name].coordinates != count:
            message = f"{name} has {stored[name].coordinates} axes, but the function looks it up with {count}"
            findings.append(Finding(str(path), message, AGAIN))
        elif stored[name].values.shape != own.values.shape:
            spread = {"lower": own.lower.min(), "upper": own.upper.max(), "locked": own.locked.all()}
            parameters.append(stored[name].changed(extrapolation=own.extrapolation, **spread))
        else:
            parameters.append(own.changed(values=stored[name].values, axes=stored[name].axes))
    if findings:
        raise InputError(findings)
    return problem.parameters.merged(ParameterSet(parameters))


def _result(contents: Any, start: ParameterSet, parameters: ParameterSet, trace: tuple[TraceLine, ...]) -> Result:
    columns = [field.name for field in fields(Quality)]
    rows = [Quality(**{name: _known(row[name]) for name in columns}) for row in contents["quality"]]
    return Result(
        status=contents["status"],
        message=contents["message"],
        parameters=parameters,
        start=start,
        quality=tuple(rows),
        trace=trace,
        iterations=contents["iterations"],
        evaluations=contents["evaluations"],
        cost_before=_known(contents["cost"]["before"]),
        cost_after=_known(contents["cost"]["after"]),
        free_values=contents["values"]["free"],
        fixed_values=contents["values"]["fixed"],
        seconds=Seconds(**{field.name: contents["seconds"].get(field.name, 0.0) for field in fields(Seconds)}),
        starts=tuple(_start(row) for row in contents.get("starts", ())),
        smoothness=_by_name(contents, "smoothness"),
        shifts=_by_name(contents, "shifts"),
        warnings=tuple(_warning(row) for row in contents.get("warnings", ())),
    )


def _warning(row: Any) -> Finding:
    return Finding("", row["sentence"].removesuffix("."), row["remedy"], severity="warning")


def _by_name(contents: Any, key: str) -> dict[str, dict[str, float]]:
    """Return automatic settings by table and axis or by dataset and channel; results of older versions have none."""
    settings = contents.get(key, {})
    return {name: {inner: float(number) for inner, number in row.items()} for name, row in settings.items()}


def _start(row: Any) -> StartResult:
    plain = {
        name: _known(row[name]) for name in ("start", "status", "message", "iterations", "evaluations", "distance")
    }
    return StartResult(**plain, cost_before=_known(row["cost"]["before"]), cost_after=_known(row["cost"]["after"]))


def _known(value: Any) -> Any:
    return float("nan") if value is None else value


def _trace(path: Path) -> tuple[TraceLine, ...]:
    kinds = {field.name: field.type for field in fields(TraceLine)}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    try:
        return tuple(TraceLine(**{name: kind(row[name]) for name, kind in kinds.items()}) for row in rows)  # type: ignore[operator]
    except (ValueError, KeyError, TypeError):
        raise InputError.of(str(path), "not a valid trace file", AGAIN) from None
