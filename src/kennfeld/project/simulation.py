"""Simulates a project's function over its datasets."""

from dataclasses import replace

from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.optimize import Problem
from kennfeld.optimize.scoring import Nodes
from kennfeld.parameters import ParameterSet
from kennfeld.project.initial import described

__all__ = ["replaced", "simulations"]


def simulations(problem: Problem, parameters: ParameterSet | None) -> list[Dataset]:
    """The named nodes and the target channels over every dataset; a target called like a node gets a suffix."""
    values = replaced(problem, parameters)
    compiled = Nodes(problem.model.graph, values)
    return [_one(problem, data, values, compiled) for data in problem.datasets]


def _one(problem: Problem, data: Dataset, values: ParameterSet, compiled: Nodes) -> Dataset:
    bound = problem.bind(data)
    nodes = compiled.dataset(bound, values)
    bound = bound.shown
    names = dict.fromkeys(c.target.name for c in problem.criteria if c.target.kind == "channel")
    targets = [
        Channel(f"{name} (target)" if name in nodes else name, bound.channel(name), data[name].unit)
        for name in names
        if name in data
    ]
    return replace(nodes.with_channels(*targets), use=data.use, weight=data.weight, scored=bound.scored)


def replaced(problem: Problem, parameters: ParameterSet | None) -> ParameterSet:
    """The project's parameters with others of the same names; they may have other axes, but as many.

    Raises `InputError` where one does not fit the function.
    """
    if parameters is None:
        return problem.parameters
    needed = problem.model.graph.parameters
    wrong = [
        Finding("parameters", f"{name} is {described(parameters[name])}; the function gives it {count} coordinates")
        for name, count in needed.items()
        if name in parameters and parameters[name].coordinates != count
    ]
    if wrong:
        raise InputError(wrong)
    try:
        return problem.parameters.merged(parameters)
    except ArgumentError as error:
        raise InputError.of("parameters", str(error)) from None
