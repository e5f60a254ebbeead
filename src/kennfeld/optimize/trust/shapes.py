"""Changes of whole tables that have a name: scaled, raised, stretched, moved along an axis, or like another table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.graph import Graph
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.parameters import Axis, Parameter, ParameterSet

__all__ = ["Kind", "Shape", "shapes"]

Kind = Literal["scale", "offset", "stretch", "shift", "follow"]
FLAT = 1e-9  # relative spread of values from which a table counts as constant


@dataclass(frozen=True)
class Shape:
    """A named change of one table, per unit of its amount.

    `scale`: the values themselves; `offset`: ones; `stretch`: the distances from `about`, a value that is held;
    `shift`: what moving the table along axis `axis` by one unit does; `follow`: the values of the table `other`, which
    is looked up at the same place. `fed` are the tables from which the coordinate on a shifted axis comes.
    """

    kind: Kind
    table: str
    change: Float  # of the table's shape
    axis: int = 0
    about: float = 0.0
    other: str = ""
    fed: frozenset[str] = frozenset()


def shapes(graph: Graph, parameters: ParameterSet, held: Mapping[str, Bool]) -> list[Shape]:
    """The named changes of the tables in `held`, which marks values that cannot change; those that differ."""
    places = _places(graph)
    found = []
    fed = _fed(graph)
    tables = [name for name in held if parameters[name].kind != "rbf"]  # an expansion is no table
    for name in tables:
        found += _own(parameters[name], held[name], fed.get(name, []))
        for other in tables:
            if other != name and places.get(name) and places.get(name) == places.get(other):
                change = _resampled(parameters[other], parameters[name].index_axes)
                if np.ptp(change) > FLAT * np.abs(change).max():
                    found.append(Shape("follow", name, change, other=other))
    return found


def _places(graph: Graph) -> Mapping[str, set[tuple[int, ...]]]:
    """The coordinates that each table is looked up with."""
    found: dict[str, set[tuple[int, ...]]] = {}
    for node in graph.nodes:
        if node.op == "lookup" and node.args:
            found.setdefault(node.payload, set()).add(node.args)
    return found


def _fed(graph: Graph) -> Mapping[str, list[frozenset[str]]]:
    """For each axis of each table, the tables that its coordinate depends on within a step."""
    above: list[frozenset[str]] = []
    found: dict[str, list[frozenset[str]]] = {}
    for node in graph.nodes:
        reached = frozenset[str]().union(*(above[at] for at in node.args))
        if node.op == "lookup":
            axes = found.setdefault(node.payload, [frozenset()] * len(node.args))
            found[node.payload] = [a | above[at] for a, at in zip(axes, node.args, strict=True)]
            reached |= {node.payload}
        above.append(reached)
    return found


def _own(table: Parameter, held: Bool, fed: Sequence[frozenset[str]]) -> list[Shape]:
    values = np.nan_to_num(table.values)
    largest = float(np.abs(values).max())
    found = [Shape("scale", table.name, values)] if largest > 0 else []
    if not found or float(np.ptp(values)) > FLAT * largest:
        found.append(Shape("offset", table.name, np.ones(values.shape)))
    about = values[held]
    if about.size and about[0] != 0 and float(np.ptp(about)) <= FLAT * largest:
        found.append(Shape("stretch", table.name, values - about[0], about=float(about[0])))
    for i, axis in enumerate(table.index_axes):
        if len(axis) > 1:
            slope = np.gradient(values, axis.breakpoints, axis=i)
            if float(np.ptp(slope)) > FLAT * max(float(np.abs(slope).max()), 1e-300):
                found.append(Shape("shift", table.name, -slope, axis=i, fed=fed[i] if fed else frozenset()))
    return found


def _resampled(table: Parameter, axes: Sequence[Axis]) -> Float:
    """A table's values at the grid points of other axes."""
    values = np.nan_to_num(table.values)
    for i, (own, wanted) in enumerate(zip(table.index_axes, axes, strict=True)):
        weights, _ = cell_weights(position(wanted.breakpoints, own.breakpoints, table.extrapolation), len(own))
        values = np.moveaxis(np.tensordot(weights, values, axes=(1, i)), 0, i)
    return values
