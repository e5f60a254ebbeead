"""The channels of a complete simulation: nodes, targets, errors and inputs, each with a description."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.binding import BoundDataset


def renamed_inputs(problem: Problem) -> set[str]:
    """Return the inputs of the function that are called otherwise in the recordings."""
    return {name for name in problem.model.graph.inputs if problem.channels.get(name, name) != name}


def complete(problem: Problem, shown: BoundDataset, nodes: Dataset, targets: Sequence[Channel]) -> Dataset:
    """Return nodes and targets with the errors of all criteria and the inputs of the function.

    An error is node minus target at each sample with a target, whether or not it is scored, in the unit of the node.

    Args:
        problem: the function, its channels and criteria.
        shown: the recorded samples, one for each point if points are held.
        nodes: the simulated nodes.
        targets: the recorded targets at the samples of the nodes.
    """
    described = [replace(channel, description=_place(problem, channel.name)) for channel in nodes.channels]
    described += [replace(c, description=_recorded(shown, c.name)) for c in targets]
    known = replace(nodes, channels=tuple(described))
    known = known.with_channels(*_errors(problem, shown, known))
    return known.with_channels(*(channel for channel in _inputs(problem, shown) if channel.name not in known))


def _place(problem: Problem, node: str) -> str:
    """Return the description of a node, or of the deviation of a surrogate."""
    if node not in problem.model.graph.names:
        return "predictive deviation"
    location = problem.model.locations.get(node)
    return "node" if location is None else f"node of the function, {location}"


def _recorded(shown: BoundDataset, name: str) -> str:
    """Return the description of a target, which has a suffix if it is called like a node."""
    dataset = shown.dataset
    channel = dataset[name if name in dataset else name.removesuffix(" (target)")]
    return _join("target" if channel.name == name else f"target, channel {channel.name}", channel.description)


def _join(*texts: str) -> str:
    return ": ".join(text for text in texts if text)


def _inputs(problem: Problem, shown: BoundDataset) -> Iterator[Channel]:
    for name in problem.model.graph.inputs:
        source = shown.dataset.get(problem.channels.get(name, name))
        if source is not None and name in shown.inputs:
            text = _join("input" if source.name == name else f"input, channel {source.name}", source.description)
            yield Channel(name, shown.at_kept(shown.inputs[name]), source.unit, text)


def _errors(problem: Problem, shown: BoundDataset, known: Dataset) -> Iterator[Channel]:
    """Yield node minus target of each criterion; one channel for criteria that differ in their weights alone."""
    criteria = [each for each in problem.criteria if not each.internal and each.node in known]
    taken = set(known)
    for criterion in {(each.node, each.target): each for each in criteria}.values():
        target = _target(problem, shown, known, criterion)
        if target is not None:
            several = sum(each.node == criterion.node and each.target != criterion.target for each in criteria) > 0
            name = _free(f"{criterion.node} (error{f', {criterion.target}' if several else ''})", taken)
            taken.add(name)
            values, text = known[criterion.node].values - target, f"{criterion.node} minus {criterion.target}"
            yield Channel(name, values, known[criterion.node].unit, text)


def _target(problem: Problem, shown: BoundDataset, known: Dataset, criterion: Criterion) -> np.ndarray | None:
    """Return the target of a criterion, Float[samples]; None if the dataset lacks it."""
    if criterion.target.kind == "number":
        return np.full(known.samples, criterion.target.value)
    node = problem.target_node(criterion)
    if node is not None:
        return known[node].values
    channel = shown.dataset.get(criterion.target.name)
    return None if channel is None else shown.at_kept(channel.values)


def _free(name: str, taken: Collection[str]) -> str:
    return name if name not in taken else _free(f"{name}'", taken)
