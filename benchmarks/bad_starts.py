"""Topic `starts`: 1000 fits from bad starts, each with one truth, beside scipy's solvers.

An end is false if it is called converged though the cost is not the truth's and either its gradient is not zero or it
is worse than the mean, without a warning.
"""

import time
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.bad_start_problems import KINDS, BadStart, Float, problem
from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.table import Table, seconds

__all__ = ["run", "solve"]

FITS = 1008  # of all kinds together
EVALUATIONS = 1000  # at most, of one fit
NEAR = 1e-3  # how close a cost is to that of the truth, relatively
EXACT = 1e-10  # the same, as a share of the target's variance
STATIONARY = 1e-4  # cosine between residuals and a column of the Jacobian: the cost could fall by a share of 1e-8
AGREEMENT = 1e-9  # of the two forms of a function, relative to the largest output
TOOLS = {
    "Kennfeld": ("kennfeld", ()),
    'scipy TRF, x_scale="jac"': ("trf", ("scipy",)),
    'scipy LM, x_scale="jac"': ("lm", ("scipy",)),
}


class End(NamedTuple):
    """How a tool ended: its values, whether it says that they are the optimum, and whether it warns of them."""

    values: Float
    converged: bool
    warned: bool


def run() -> list[Table]:
    """All tools that are there."""
    table = Table(
        "starts: fits from starts within two decades of the truth", ("tool", "solved", "false", "time", *KINDS)
    )
    for name, (tool, packages) in TOOLS.items():
        if not installed(*packages):
            table.add(name, "missing")
            continue
        outcome = apart("benchmarks.bad_starts:solve", cores=1, timeout=3000.0, tool=tool)
        if "error" in outcome:
            table.add(name, outcome["error"])
            continue
        solved, false = outcome["solved"], outcome["false"]
        cells = (f"{sum(solved.values())} of {FITS}", str(sum(false.values())), seconds(outcome["seconds"]))
        table.add(name, *cells, *(f"{solved.get(kind, 0)}" for kind in KINDS))
    each = FITS // len(KINDS)
    table.notes = [
        f"{each} fits a kind, every second one with 1 % noise. Every start is the truth times 10^u, u uniform between "
        "-2 and 2 for each value.",
        f"Solved: a cost within {NEAR:g} of that of the truth. False: reported as converged but not solved, and the "
        f"gradient is not zero (a cosine above {STATIONARY:g} between the residuals and a column of the Jacobian), or "
        "the cost is above that of the mean and no warning says so.",
        f"At most {EVALUATIONS} evaluations or iterations a fit; the peers have the exact Jacobian and tolerances of "
        f"1e-8. Kennfeld compiles each formula, which is in its time. Load at the end {load()}.",
    ]
    return [table]


def solve(tool: str) -> dict[str, Any]:
    """All problems with one tool, in a process of its own."""
    fit: Callable[[BadStart], End] = {"kennfeld": _kennfeld, "trf": _scipy("trf"), "lm": _scipy("lm")}[tool]
    solved: Counter[str] = Counter()
    false: Counter[str] = Counter()
    spent = 0.0
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for name in KINDS:
            _check_agreement(problem(name, 0))
            for number in range(FITS // len(KINDS)):
                case = problem(name, number)
                began = time.perf_counter()
                end = fit(case)
                spent += time.perf_counter() - began
                solved[name] += is_solved(case, end)
                false[name] += is_false(case, end)
    return {"solved": dict(solved), "false": dict(false), "seconds": spent}


def is_solved(case: BadStart, end: End) -> bool:
    """Return if the cost is that of the truth, or below."""
    spread = float(np.sum(np.square(case.target - case.target.mean())))
    return bool(case.cost(end.values) <= case.cost(case.truth) * (1 + NEAR) + EXACT * spread)


def is_false(case: BadStart, end: End) -> bool:
    """Return if the end is said to be an optimum and is none, or explains less than the mean without a warning."""
    if not end.converged or is_solved(case, end):
        return False
    spread = float(np.sum(np.square(case.target - case.target.mean())))
    return case.gradient_angle(end.values) > STATIONARY or (case.cost(end.values) > spread and not end.warned)


def _kennfeld(case: BadStart) -> End:
    from kennfeld import Options, calibrate

    data = {**case.inputs, "target": case.target}
    options = Options(max_iterations=EVALUATIONS)
    result = calibrate(case.kind.formula, data, _start_of(case), target="target", options=options)
    values = np.concatenate([np.ravel(result.parameters[name].values) for name in case.kind.ranges])
    return End(values, result.status == "converged", bool(result.warnings))


def _check_agreement(case: BadStart) -> None:
    """Raise an error if the function in numpy, which judges the ends, is not that of the formula."""
    from kennfeld import simulate

    output = simulate(case.kind.formula, dict(case.inputs), _start_of(case, case.truth))["y"].values
    expected = case.residual(case.truth) + case.target
    if not np.allclose(output, expected, rtol=AGREEMENT, atol=AGREEMENT * np.abs(expected).max()):
        raise RuntimeError(f"{case.kind.formula}: the forms in numpy and in formula text disagree")


def _start_of(case: BadStart, values: Float | None = None) -> dict[str, Any]:
    """Return the start, or other values, as parameters of Kennfeld."""
    from kennfeld import Axis, Curve, Map, Scalar

    start: dict[str, Any] = {}
    flat, first = case.start if values is None else values, 0
    for name in case.kind.ranges:
        axes = [Axis(points) for points in case.kind.axes.get(name, ())]
        shape = tuple(len(axis.breakpoints) for axis in axes)
        own = flat[first : first + int(np.prod(shape))].reshape(shape)
        first += own.size
        start[name] = [Scalar, Curve, Map][len(axes)](name, *axes, own)
    return start


def _scipy(method: str) -> Callable[[BadStart], End]:
    def fit(case: BadStart) -> End:
        from scipy.optimize import least_squares

        try:
            end = least_squares(
                case.residual, case.start, jac=case.jacobian, method=method, x_scale="jac", max_nfev=EVALUATIONS
            )
        except (ValueError, np.linalg.LinAlgError):  # not finite at the start, or on the way
            return End(case.start, converged=False, warned=False)
        return End(np.asarray(end.x), converged=end.status > 0, warned=False)

    return fit
