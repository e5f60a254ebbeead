"""The result of an earlier run, read back from its folder."""

import csv
import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from kennfeld.calfiles import read as read_parameters
from kennfeld.errors import Finding, InputError
from kennfeld.optimize import Problem, Quality, Result, Seconds, TraceLine
from kennfeld.optimize.result import StartResult
from kennfeld.parameters import ParameterSet
from kennfeld.project.manifest import KEY, require_one_run
from kennfeld.project.manifest import RUN_AGAIN as AGAIN
from kennfeld.project.replacement import finish_interrupted

__all__ = ["READ", "stored"]

READ = ("parameters.json", "trace.csv", "trust.csv")  # beside result.json
_NUMBER = float("nan")


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
