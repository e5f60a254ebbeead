"""The trust in each value, read back from the folder of an earlier run.

What a result says about its trust, whatever form that has.

The result of an earlier run, read back from its folder.
"""

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
from kennfeld.optimize import Problem, Quality, Result, Seconds, TraceLine
from kennfeld.optimize.result import StartResult
from kennfeld.parameter_set import ParameterSet
from kennfeld.project.folder_replacement import finish_interrupted
from kennfeld.project.manifest import KEY, require_one_run
from kennfeld.project.manifest import RUN_AGAIN as AGAIN

__all__ = ["READ", "TrustSummary", "stored", "stored_trust", "view"]

MANY = 2000  # values up to which leverage is asked for: computing it costs their third power

COLUMNS = ("samples", "deviation", "leverage", "informed", "by_smoothness")
FLAGS = ("informed", "by_smoothness")

READ = ("parameters.json", "trace.csv", "trust.csv")  # beside result.json
_NUMBER = float("nan")


@dataclass(frozen=True)
class RemedyText:
    """A change of values that the data cannot tell from none, in words, and what settles it."""

    sentence: str
    remedy: str


@dataclass(frozen=True)
class TrustSummary:
    """The parts of a trust that are known, by parameter or axis of free breakpoints; what is not known is empty."""

    informed: Mapping[str, Bool] = field(default_factory=dict)
    samples: Mapping[str, Int] = field(default_factory=dict)
    deviation: Mapping[str, Float] = field(default_factory=dict)
    leverage: Mapping[str, Float] = field(default_factory=dict)
    by_smoothness: Mapping[str, Bool] = field(default_factory=dict)
    directions: tuple[RemedyText, ...] = ()
    null_space: RemedyText | None = None  # all changes that nothing determines, counted
    holdings: tuple[str, ...] = ()  # limits that are met and what they hold, a sentence each
    remark: str = ""


def view(trust: Any) -> TrustSummary:
    """The trust of a result: an object with these attributes, or a mapping of the informed values alone."""
    if trust is None:
        return TrustSummary()
    if isinstance(trust, Mapping):
        return TrustSummary(informed=trust)
    found = getattr(trust, "directions", ())
    directions = tuple(RemedyText(str(d.sentence), str(getattr(d, "remedy", ""))) for d in found)
    whole = getattr(trust, "null_space", None)
    null_space = RemedyText(str(whole.sentence), str(whole.advice)) if whole is not None and whole.sentence else None
    holdings = tuple(str(holding) for holding in getattr(trust, "holdings", ()))
    remark = str(getattr(trust, "remark", ""))
    values = sum(np.size(array) for array in (getattr(trust, "deviation", None) or {}).values())
    parts = ["informed", "samples", "deviation", "by_smoothness", *(["leverage"] if values <= MANY else [])]
    known = {name: getattr(trust, name, None) for name in parts}
    arrays: dict[str, Any] = {name: value for name, value in known.items() if isinstance(value, Mapping)}
    return TrustSummary(directions=directions, null_space=null_space, holdings=holdings, remark=remark, **arrays)


def stored_trust(folder: Path, parameters: ParameterSet) -> TrustSummary:
    """The parts of a trust that stand in `trust.csv` and `result.json`; empty where there are none, or others' tables.

    What a report says without them is right all the same, so nothing is raised.
    """
    try:
        return TrustSummary(**_said(folder / "result.json"), **_tables(folder, parameters))
    except (OSError, ValueError, KeyError, TypeError):
        return TrustSummary()


def _said(path: Path) -> dict[str, Any]:
    """What stands there in words."""
    trust = json.loads(path.read_text(encoding="utf-8")).get("trust") or {}
    whole = trust.get("null_space") or {}
    return {
        "directions": tuple(RemedyText(entry["sentence"], entry["remedy"]) for entry in trust.get("directions", [])),
        "null_space": RemedyText(whole["sentence"], whole["remedy"]) if whole.get("sentence") else None,
        "holdings": tuple(entry["sentence"] for entry in trust.get("holdings", [])),
        "remark": trust.get("remark", ""),
    }


def _tables(folder: Path, parameters: ParameterSet) -> dict[str, Any]:
    """An array for each column and parameter that the table is complete for, and for each axis in it."""
    path = folder / "trust.csv"
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found: dict[str, dict[str, Any]] = {column: {} for column in COLUMNS}
    for name, group in groupby(rows, key=lambda row: row["parameter"]):
        lines = list(group)
        shape = parameters[name].values.shape if name in parameters else (len(lines),)
        if int(np.prod(shape)) == len(lines):
            for column in COLUMNS:
                values = _column(lines, column).reshape(shape)
                if not np.isnan(values).all():
                    found[column][name] = _typed(column, values)
    return found


def _column(lines: Sequence[Mapping[str, str]], column: str) -> Float:
    return np.array([float(line[column] or "nan") for line in lines])


def _typed(column: str, values: Float) -> Any:
    if column in FLAGS:
        return values != 0
    return values.astype(np.int64) if column == "samples" else values


def stored(folder: Path, problem: Problem) -> tuple[Result, Mapping[str, Any]] | None:
    """The result in a folder, and the contents of its `result.json`; None where no run has left one.

    A run that was killed while it put its files in place is put in place first. Raises `InputError` where a file is
    missing, damaged, of another run or about another function, every such file at once.
    """
    finish_interrupted(folder)
    paths = {name: folder / name for name in ("result.json", "parameters.json", "trace.csv")}
    if not any(path.is_file() for path in paths.values()):
        return None
    missing = [
        Finding(str(path), "there is no such file, but others of a run are there", AGAIN)
        for path in paths.values()
        if not path.is_file()
    ]
    if missing:
        raise InputError(missing)
    found = _contents(paths["result.json"])
    require_one_run(folder, found, READ)
    parameters = _parameters(paths["parameters.json"], problem)
    trace = _trace(paths["trace.csv"])
    try:
        return _result(found, problem.parameters, parameters, trace), found
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise _no_result(paths["result.json"], error) from None


def _contents(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return {**found, KEY: dict(found.get(KEY, {}))}
    except (ValueError, TypeError, AttributeError) as error:
        raise _no_result(path, error) from None


def _no_result(path: Path, error: Exception) -> InputError:
    return InputError.of(str(path), f"is no result of a run ({type(error).__name__}: {error})", AGAIN)


def _parameters(path: Path, problem: Problem) -> ParameterSet:
    """The project's parameters with the values of the run; bounds and locks stay those of the project."""
    given = read_parameters(path)
    wrong, taken = [], []
    carried = {surrogate.name for surrogate in problem.model.surrogates}  # these have files of their own
    for name, count in problem.model.graph.parameters.items():
        if name in carried:
            continue
        own = problem.parameters[name]
        if name not in given:
            wrong.append(Finding(str(path), f"there is no parameter {name}, which the function looks up", AGAIN))
        elif given[name].coordinates != count:
            has = given[name].coordinates
            wrong.append(Finding(str(path), f"{name} has {has} axes, but the function gives it {count}", AGAIN))
        elif given[name].values.shape != own.values.shape:
            spread = {"lower": own.lower.min(), "upper": own.upper.max(), "locked": own.locked.all()}
            taken.append(given[name].changed(extrapolation=own.extrapolation, **spread))
        else:
            taken.append(own.changed(values=given[name].values, axes=given[name].axes))
    if wrong:
        raise InputError(wrong)
    return problem.parameters.merged(ParameterSet(taken))


def _result(found: Any, start: ParameterSet, parameters: ParameterSet, trace: tuple[TraceLine, ...]) -> Result:
    rows = [Quality(**{field.name: _known(row[field.name]) for field in fields(Quality)}) for row in found["quality"]]
    return Result(
        status=found["status"],
        message=found["message"],
        parameters=parameters,
        start=start,
        quality=tuple(rows),
        trace=trace,
        iterations=found["iterations"],
        evaluations=found["evaluations"],
        cost_before=_known(found["cost"]["before"]),
        cost_after=_known(found["cost"]["after"]),
        free_values=found["values"]["free"],
        fixed_values=found["values"]["fixed"],
        seconds=Seconds(**{field.name: found["seconds"].get(field.name, 0.0) for field in fields(Seconds)}),
        starts=tuple(_start(row) for row in found.get("starts", ())),
        smoothness=_by_name(found, "smoothness"),
        shifts=_by_name(found, "shifts"),
        warnings=tuple(_warning(row) for row in found.get("warnings", ())),
    )


def _warning(row: Any) -> Finding:
    return Finding("", row["sentence"].removesuffix("."), row["remedy"], severity="warning")


def _by_name(found: Any, key: str) -> dict[str, dict[str, float]]:
    """What a run chose, by table and axis or by dataset and channel; results of older versions have none."""
    return {name: {inner: float(value) for inner, value in given.items()} for name, given in found.get(key, {}).items()}


def _start(row: Any) -> StartResult:
    plain = {
        name: _known(row[name]) for name in ("start", "status", "message", "iterations", "evaluations", "distance")
    }
    return StartResult(**plain, cost_before=_known(row["cost"]["before"]), cost_after=_known(row["cost"]["after"]))


def _known(value: Any) -> Any:
    return _NUMBER if value is None else value


def _trace(path: Path) -> tuple[TraceLine, ...]:
    kinds = {field.name: field.type for field in fields(TraceLine)}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    try:
        return tuple(TraceLine(**{name: kind(row[name]) for name, kind in kinds.items()}) for row in rows)  # type: ignore[operator]
    except (ValueError, KeyError, TypeError):
        raise InputError.of(str(path), "is no trace of a run", AGAIN) from None
