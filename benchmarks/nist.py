"""Topic `nist`: 27 nonlinear regressions with certified answers, from two starts each."""

import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.nist_problem import DIGITS, Float, Regression, digits, read
from benchmarks.table import Table, seconds
from kennfeld.base.formatting import join_names

__all__ = ["run", "solve"]

ROOT = Path(__file__).parents[1]
FOLDERS = (Path(os.environ.get("NIST_STRD", "nist_strd")), ROOT.parent / "shared" / "data" / "nist_strd")
NAMESPACE = {name: getattr(np, name) for name in ("exp", "log", "sqrt", "sin", "cos", "arctan")} | {"pi": np.pi}
TOOLS = {
    "Kennfeld": ("kennfeld", ()),
    "scipy least_squares, defaults": ("scipy_trf", ("scipy",)),
    'scipy least_squares, method="lm"': ("scipy_lm", ("scipy",)),
    "scipy curve_fit, defaults": ("curve_fit", ("scipy",)),
    "lmfit minimize, defaults": ("lmfit", ("lmfit",)),
}


def run() -> list[Table]:
    """All tools that are there."""
    table = Table(
        "nist: 27 regressions from 2 starts", ("tool", "6 digits", "time", "threads", "final costs", "short of it")
    )
    folder = next((folder for folder in FOLDERS if folder.is_dir()), None)
    if folder is None:
        table.notes = ["Skipped: the files are not there; set NIST_STRD to the folder that holds them."]
        return [table]
    for name, (tool, packages) in TOOLS.items():
        if not installed(*packages):
            table.add(name, *["-"] * 4, "missing")
            continue
        outcome = apart("benchmarks.nist:solve", cores=1, tool=tool, folder=str(folder.resolve()))
        if "error" in outcome:
            table.add(name, *["-"] * 4, outcome["error"])
            continue
        short = [f"{case} {number:.1f}" for case, number in outcome["digits"].items() if number < DIGITS]
        reached = len(outcome["digits"]) - len(short)
        cells = (f"{reached} of {len(outcome['digits'])}", seconds(outcome["seconds"]), "1", outcome["costs"])
        table.add(name, *cells, join_names(short, 6))
    table.notes = [
        "A problem counts if every parameter agrees with the certified one to 6 digits. The others are listed as "
        "problem/start, with the digits reached.",
        "Final costs: from how many starts the certified sum of squares is met to 6 digits. Kennfeld compiles each "
        f"formula, which is in its time, and runs with max_iterations=2000, tolerance=1e-15. Load at the end {load()}.",
    ]
    return [table]


def solve(tool: str, folder: str) -> dict[str, Any]:
    """All problems with one tool, in a process of its own."""
    fit: Callable[[Regression, Float], Float] = {
        "kennfeld": _kennfeld,
        "scipy_trf": _least_squares("trf"),
        "scipy_lm": _least_squares("lm"),
        "curve_fit": _curve_fit,
        "lmfit": _lmfit,
    }[tool]
    problems = [read(file) for file in sorted(Path(folder).glob("*.dat"))]
    agreement, met = {}, 0
    began = 0.0
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        fit(problems[0], problems[0].certified)
        began = time.perf_counter()
        answers = {
            f"{problem.name}/{number + 1}": (problem, _attempt(fit, problem, start))
            for problem in problems
            for number, start in enumerate(problem.starts)
        }
        spent = time.perf_counter() - began
        for case, (problem, values) in answers.items():
            agreement[case] = digits(values, problem.certified)
            best = _cost(problem, problem.certified)
            met += bool(_cost(problem, values) <= best * (1 + 1e-6) + 1e-20)
    return {"digits": agreement, "seconds": spent, "costs": f"{met} of {len(agreement)}"}


def _attempt(fit: Callable[[Regression, Float], Float], problem: Regression, start: Float) -> Float:
    try:
        return fit(problem, start)
    except (ValueError, RuntimeError, np.linalg.LinAlgError):
        return np.full(start.size, np.nan)


def _predict(problem: Regression, values: Float) -> Float:
    """The model, from the text of NIST's own file."""
    names = dict(zip(problem.names, values, strict=True))
    result: Float = eval(problem.expression, {"__builtins__": {}}, NAMESPACE | problem.columns | names)
    return result


def _cost(problem: Regression, values: Float) -> float:
    return float(np.sum(np.square(_predict(problem, values) - problem.columns["y"])))


def _kennfeld(problem: Regression, start: Float) -> Float:
    from kennfeld.optimize import Options, calibrate

    names = problem.names
    begin = dict(zip(names, start.tolist(), strict=True))
    options = Options(max_iterations=2000, tolerance=1e-15)
    result = calibrate(problem.formula, problem.columns, begin, target="y", options=options)
    return np.array([float(result.parameters[name].values) for name in names])


def _least_squares(method: str) -> Callable[[Regression, Float], Float]:
    def fit(problem: Regression, start: Float) -> Float:
        from scipy.optimize import least_squares

        solution = least_squares(lambda b: _predict(problem, b) - problem.columns["y"], start, method=method)
        return np.asarray(solution.x)

    return fit


def _curve_fit(problem: Regression, start: Float) -> Float:
    from scipy.optimize import curve_fit

    values, _ = curve_fit(
        lambda _, *b: _predict(problem, np.array(b)), problem.columns["y"], problem.columns["y"], start
    )
    return np.asarray(values)


def _lmfit(problem: Regression, start: Float) -> Float:
    import lmfit

    parameters = lmfit.create_params(**dict(zip(problem.names, start.tolist(), strict=True)))
    solution = lmfit.minimize(
        lambda p: _predict(problem, np.array(list(p.valuesdict().values()))) - problem.columns["y"], parameters
    )
    return np.array(list(solution.params.valuesdict().values()))
