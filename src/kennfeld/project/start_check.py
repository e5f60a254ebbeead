"""Whether a calibration can move from its initial values."""

from collections.abc import Iterator

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.graph.factors import factors
from kennfeld.optimize import Problem
from kennfeld.optimize.limits.limiting import limits_of
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem import Compiled
from kennfeld.optimize.zero_slopes import departure
from kennfeld.project.schema import ProjectFile

__all__ = ["start_warning"]


def start_warning(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """A warning for each parameter that keeps others, or itself, at 0, with an initial value that does not.

    Nothing is compiled unless the formula has factors that are 0 at the start.
    """
    suspects = factors(problem.graph) & {name for name in problem.free_names if _at_zero(problem, name)}
    if not suspects or file.optimizer.method == "global" or not any(bound.count for bound in problem.training):
        return
    try:
        compiled = Compiled(problem)
        limits = limits_of(problem, compiled.values)
    except InputError:  # told by other checks
        return
    start, _ = project(compiled.start[: compiled.values.free], limits)
    off = None if start is None else departure(compiled, start, limits)
    if off is None:
        return
    for name in off.changed:
        others = " and ".join(other for other in off.stuck if other != name) or name
        what = f"the initial value is 0, and so all slopes of {others} are zero: no step could move from there"
        mend = f"Write initial = {off.levels[name]:g}, or all values; a calibration starts there on its own."
        yield Finding(file.place(f"[parameters.{name}] initial"), what, mend, severity="warning")


def _at_zero(problem: Problem, name: str) -> bool:
    return not np.any(problem.parameters[name].values)
