"""A problem at the end of its fit, as terms are scored and fitted on it."""

from dataclasses import replace

from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.problem import Problem, bound_time_constants
from kennfeld.optimize.tuning.shift_estimation import apply_shifts


def settled_problem(problem: Problem, result: Result) -> Problem:
    """Return a problem at the end of its fit, with automatic settings as they were chosen."""
    problem = apply_shifts(problem, result.shifts)
    factors = {name: tuple(own.values()) for name, own in result.smoothness.items()}
    problem = replace(problem, smoothness={**problem.smoothness, **factors}, unknown_shifts={})
    return bound_time_constants(replace(problem, parameters=result.parameters))
