"""The digest of what decides where a search may end: a search that has converged has done so for one such problem."""

from dataclasses import fields
from typing import Any

from kennfeld.content_digest import digest_of
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.parameters import Parameter

_ELSEWHERE = {"workers", "cluster", "starts", "save_every"}  # options that do not change where a start ends


def problem_digest(problem: Problem, options: Options) -> str:
    """Return the digest of a problem and the options of its search, without the values that the search changes.

    Of the data it takes names, weights and lengths: that their samples are others shows in the cost.
    """
    tables = [
        _settings(problem.parameters[name], free=name in problem.free_names)
        for name in sorted(problem.graph.parameters)
        if name in problem.parameters
    ]
    rules = problem.criteria, problem.pins, problem.constraints, problem.limits
    data = [(each.name, each.use, each.weight, each.samples) for each in problem.datasets]
    search = {each.name: getattr(options, each.name) for each in fields(options) if each.name not in _ELSEWHERE}
    texts = problem.free_names, dict(problem.smoothness), dict(problem.channels)
    return digest_of(problem.graph, tables, *texts, *rules, data, search)


def _settings(parameter: Parameter, *, free: bool) -> tuple[Any, ...]:
    """Return what is given of a parameter: of a free one its bounds and locked values, of another its values."""
    values = parameter.values[parameter.locked] if free else parameter.values
    axes = [(axis.breakpoints, axis.free) for axis in parameter.axes]
    bounds = parameter.lower, parameter.upper, parameter.locked
    return parameter.kind, parameter.name, values, *bounds, axes, parameter.extrapolation
