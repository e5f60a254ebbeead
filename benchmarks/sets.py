"""Topic `sets`: optimagic's `more_wild` and `cartis_roberts` problems, with one Jacobian for all solvers."""

import time
import warnings
from statistics import median
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.set_problem import SETS, CountedProblem, Exhausted, problems
from benchmarks.set_solvers import CAP, SOLVERS
from benchmarks.table import Table, seconds
from kennfeld.base.formatting import join_names

__all__ = ["run", "solve"]

TOLERANCE = 1e-8
NEAR = 1e-6  # how close a cost is to a least cost, relatively
ZERO = 1e-8  # the same absolutely, where the least cost is smaller
TOOLS = {
    "Kennfeld": ("kennfeld", ()),
    "scipy TRF": ("trf", ("scipy",)),
    'scipy TRF, x_scale="jac"': ("trf_scaled", ("scipy",)),
    "scipy LM": ("lm", ("scipy",)),
    "optimistix LM": ("optimistix", ("jax", "optimistix")),
    "pyceres, DENSE_QR": ("ceres", ("pyceres",)),
}
Ends = dict[str, dict[str, Any]]  # problem: its set, cost, stated cost, residuals, jacobians, seconds


def run() -> list[Table]:
    """All solvers that are there."""
    columns = ("solver", *SETS, "total", "of the best found", "median calls", "Jacobians", "time", "threads", "missed")
    table = Table("sets: optimagic's least-squares problems without bounds", columns)
    if not installed("optimagic"):
        table.notes = ["Skipped: optimagic is missing."]
        return [table]
    by_solver: dict[str, Ends] = {}
    for name, (tool, packages) in TOOLS.items():
        if not installed(*packages):
            table.add(name, *["-"] * 8, "missing")
            continue
        ends = apart("benchmarks.sets:solve", cores=1, timeout=1800.0, tool=tool)
        if "error" in ends:
            table.add(name, *["-"] * 8, ends["error"])
            continue
        by_solver[name] = ends
    if not by_solver:
        return [table]
    stated, best = _stated(by_solver), _best(by_solver)
    for name, ends in by_solver.items():
        table.add(name, *_row(ends, stated, best, by_solver))
    table.notes = _notes(by_solver, stated, best)
    return [table]


def solve(tool: str) -> Ends:
    """All problems with one solver, in a process of its own."""
    ends: Ends = {}
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for name in SETS:
            for problem in problems(name):
                counted = CountedProblem(problem, CAP)
                began = time.perf_counter()
                try:
                    values = SOLVERS[tool](counted, TOLERANCE)
                except (Exhausted, ValueError, RuntimeError, np.linalg.LinAlgError):
                    values = counted.values
                residual = problem.residual(values)
                ends[problem.name] = {
                    "set": name,
                    "cost": float(residual @ residual),
                    "stated": problem.stated,
                    "calls": counted.residuals,
                    "jacobians": counted.jacobians,
                    "seconds": time.perf_counter() - began,
                }
    return ends


def _reached(cost: float, least: float) -> bool:
    return bool(cost <= least + max(NEAR * least, ZERO if least < ZERO else 0.0))


def _best(by_solver: dict[str, Ends]) -> dict[str, float]:
    """The least cost any solver found, by problem."""
    names = next(iter(by_solver.values()))
    return {name: float(np.nanmin([ends[name]["cost"] for ends in by_solver.values()])) for name in names}


def _stated(by_solver: dict[str, Ends]) -> dict[str, float]:
    """The least cost that optimagic states, and the best found if it states none."""
    best = _best(by_solver)
    ends = next(iter(by_solver.values()))
    return {name: best[name] if end["stated"] is None else end["stated"] for name, end in ends.items()}


def _row(ends: Ends, stated: dict[str, float], best: dict[str, float], by_solver: dict[str, Ends]) -> list[str]:
    def solved(least: dict[str, float], wanted: tuple[str, ...]) -> int:
        return sum(_reached(end["cost"], least[name]) for name, end in ends.items() if end["set"] in wanted)

    missed = [
        name
        for name, end in ends.items()
        if not _reached(end["cost"], stated[name])
        and any(_reached(other[name]["cost"], stated[name]) for other in by_solver.values())
    ]
    return [
        *(f"{solved(stated, (each,))} of {sum(end['set'] == each for end in ends.values())}" for each in SETS),
        f"{solved(stated, SETS)} of {len(ends)}",
        f"{solved(best, SETS)} of {len(ends)}",
        f"{median(end['calls'] for end in ends.values()):g}",
        f"{median(end['jacobians'] for end in ends.values()):g}",
        seconds(sum(end["seconds"] for end in ends.values())),
        "1",
        join_names(missed),
    ]


def _notes(by_solver: dict[str, Ends], stated: dict[str, float], best: dict[str, float]) -> list[str]:
    nobody = [name for name in stated if not _reached(best[name], stated[name])]
    ours = by_solver.get("Kennfeld", {})
    behind = [name for name, end in ours.items() if not _reached(end["cost"], best[name])]
    return [
        f"Solved: a final cost within {NEAR:g} of the least cost that optimagic states (absolutely within {ZERO:g} "
        "if that is smaller), and of the best any solver here found if it states none. Missed are problems that "
        "another solver here solved.",
        "Of the best found: the same rule against the best any solver here found. It differs where nobody reaches what "
        f"is stated: {', '.join(nobody) or 'nowhere'}.",
        f"Kennfeld ends above the best found on: {', '.join(behind) or 'none'}.",
        "The same start, residual function and exact Jacobian (complex steps) for all, no bounds; every tolerance a "
        f"solver has (of the cost, the step, the gradient) is {TOLERANCE:g}; at most {CAP} calls of the residual "
        "function, not counting repeated calls at the same values. A solver that raises an error or runs out of "
        "calls is credited with the best values it tried. semicon2 without bounds is semicn2u, "
        "brown_almost_linear_medium is brownale.",
        f"optimistix compiles each problem, which is in its time. Load at the end {load()}.",
    ]
