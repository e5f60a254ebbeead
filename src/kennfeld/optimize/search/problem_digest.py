"""The digest of what decides where a search may end: a search that has converged has done so for one such problem."""

from dataclasses import fields
from typing import Any

from kennfeld.base.code_digest import code_digest
from kennfeld.base.content_digest import digest_of
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.partitions import Part, Partitions
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.recording_sources import version_of

_ELSEWHERE = {
    "workers",
    "cluster",
    "starts",
    "save_every",
    "max_seconds",
}  # options that do not change where a start ends
# attributes of a dataset that tell where it is from, not what is fitted
_ORIGIN = {"channels", "findings", "clock", "files", "start_time"}


def problem_digest(problem: Problem, options: Options) -> str:
    """Return the digest of a problem and the options of its search, without the values that the search changes.

    Samples count with their values: other data can have the same cost at the values where a search ended. Those in
    partitions count by the versions of their files. The digest of the code counts, because another version may prepare
    or evaluate the same data in another way.
    """
    # of the rounding, the grids alone: they bound the search
    storage = () if problem.rounding is None else sorted(problem.rounding.grids.items())
    tables = [
        _settings(problem.parameters[name], free=name in problem.free_names)
        for name in sorted(problem.graph.parameters)
        if name in problem.parameters
    ]
    rules = problem.criteria, problem.pins, problem.constraints, problem.limits, dict(problem.restraints), storage
    data = [_content(each) for each in problem.datasets]
    search = {each.name: getattr(options, each.name) for each in fields(options) if each.name not in _ELSEWHERE}
    texts = problem.free_names, dict(problem.smoothness), dict(problem.channels)
    function = problem.graph, problem.model.step
    return digest_of(code_digest(), *function, tables, *texts, *rules, data, _files(problem.partitions), search)


def _content(data: Dataset) -> list[Any]:
    """Return all that a search knows of a dataset."""
    settings = [getattr(data, each.name) for each in fields(data) if each.name not in _ORIGIN]
    return [settings, [(channel.name, channel.values) for channel in data.channels]]


def _files(partitions: Partitions | None) -> list[tuple[Part, str]]:
    """Return the parts of data in partitions, each with the version of its file."""
    if partitions is None:
        return []
    parts = [part for each in (*partitions.training, *partitions.test) for part in each.parts]
    versions = {source: version_of(source) for source in {part.source for part in parts}}
    return [(part, versions[part.source]) for part in parts]


def _settings(parameter: Parameter, *, free: bool) -> tuple[Any, ...]:
    """Return what is given of a parameter: of a free one its bounds and locked values, of another its values."""
    # the search changes the other values, and may begin anywhere
    values = parameter.values[parameter.locked] if free else parameter.values
    axes = [(axis.breakpoints, axis.free) for axis in parameter.axes]
    bounds = parameter.lower, parameter.upper, parameter.locked
    return parameter.kind, parameter.name, values, *bounds, axes, parameter.extrapolation
