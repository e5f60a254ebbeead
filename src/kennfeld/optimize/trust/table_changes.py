"""Simple changes of a table: scaling, an offset, stretching, a shift along an axis, a multiple of another table.

A poorly determined direction is described by them, if it is a combination of few.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph import Graph
from kennfeld.graph.interpolation import regrid

Kind = Literal["scale", "offset", "stretch", "shift", "follow"]
EXACT = 1e-9  # ratio below which the data do not constrain a direction at all
FLAT = 1e-9  # relative spread of values up to which a table counts as constant
MAX_FOLLOWED = 8  # tables that one follows


@dataclass(frozen=True)
class TableChange:
    """A simple change of one table, per unit of its amount.

    The `change` is, for `scale`, the values; for `offset`, ones; for `stretch`, the differences from `about`, a fixed
    value; for `shift`, the effect of moving the table along `axis` by one unit; for `follow`, the values of the table
    `other`, which is looked up at the same coordinates. `fed` are the tables on which the coordinate of a shifted axis
    depends.
    """

    kind: Kind
    table: str
    change: Float  # of the table's shape
    axis: int = 0
    about: float = 0.0
    other: str = ""
    fed: frozenset[str] = frozenset()


def table_changes(
    graph: Graph, parameters: ParameterSet, held: Mapping[str, Bool], coupled: Mapping[str, Sequence[str]]
) -> list[TableChange]:
    """List the distinct simple changes of some tables; none of expansions and of layers of neural networks.

    Args:
        graph: the model.
        parameters: tables at the end of the fit.
        held: marks for each table the values that cannot change.
        coupled: for each table the others that act on the same data, those that do so most first.
    """
    places, fed = _lookups(graph)
    changes = []
    layers = graph.layers
    tables = [name for name in held if parameters[name].kind != "rbf" and name not in layers]
    for name in tables:
        changes += _own_changes(parameters[name], held[name], fed.get(name, []))
        # only tables that are always looked up at the same coordinates can take over each other's share
        others = [other for other in coupled[name] if other in tables and places.get(name) == places.get(other)]
        if places.get(name):
            for other in others[:MAX_FOLLOWED]:
                table = parameters[other]
                values, axes = np.nan_to_num(table.values), parameters[name].index_axes
                change = regrid(values, table.index_axes, axes, table.extrapolation)
                # a multiple of a constant table is an offset
                if np.ptp(change) > FLAT * np.abs(change).max():
                    changes.append(TableChange("follow", name, change, other=other))
    return changes


def _lookups(graph: Graph) -> tuple[Mapping[str, set[tuple[int, ...]]], Mapping[str, list[frozenset[str]]]]:
    """Return for each table the coordinates of its lookups, and the tables on which each depends within a step."""
    above: list[frozenset[str]] = []
    places: dict[str, set[tuple[int, ...]]] = {}
    fed: dict[str, list[frozenset[str]]] = {}
    for node in graph.nodes:
        # nodes come after their arguments, so that one pass collects what is above each
        reached = frozenset[str]().union(*(above[at] for at in node.args))
        if node.op == "lookup":
            if node.args:
                places.setdefault(node.payload, set()).add(node.args)
            axes = fed.get(node.payload, [frozenset()] * len(node.args))
            fed[node.payload] = [axis | above[at] for axis, at in zip(axes, node.args, strict=True)]
        if node.parameter is not None:
            reached |= {node.parameter}
        above.append(reached)
    return places, fed


def _own_changes(table: Parameter, held: Bool, fed: Sequence[frozenset[str]]) -> list[TableChange]:
    values = np.nan_to_num(table.values)
    largest = float(np.abs(values).max())
    changes = [TableChange("scale", table.name, values)] if largest > 0 else []
    # an offset of a constant table is a factor
    if not changes or float(np.ptp(values)) > FLAT * largest:
        changes.append(TableChange("offset", table.name, np.ones(values.shape)))
    about = values[held]
    # values that are held at one level, such as an efficiency pinned to 1 at its maximum, stay if the others are
    # stretched about it
    if about.size and about[0] != 0 and float(np.ptp(about)) <= FLAT * largest:
        changes.append(TableChange("stretch", table.name, values - about[0], about=float(about[0])))
    for i, axis in enumerate(table.index_axes):
        if len(axis) > 1:
            slope = np.gradient(values, axis.breakpoints, axis=i)
            # with the same slope everywhere, a shift is an offset
            if float(np.ptp(slope)) > FLAT * max(float(np.abs(slope).max()), 1e-300):
                changes.append(TableChange("shift", table.name, -slope, axis=i, fed=fed[i]))
    return changes


@dataclass(frozen=True)
class WeakDirection:
    """A poorly determined direction, as a change of all values.

    `weight` is the effect of the change of each value alone on the data. `amounts` are the table changes of which the
    direction consists; empty for other directions.
    """

    change: Float  # Float[values]
    weight: Float  # Float[values]
    ratio: float  # of data and smoothness together
    seen: float  # of the data alone
    deviation: float  # standard deviation along it, conditional on worse directions; inf if undetermined
    amounts: tuple[tuple[TableChange, float], ...]
    smoothed: bool = True  # any value has smoothness

    @property
    def exact(self) -> bool:
        """True if the data do not constrain the direction at all."""
        determined = np.isfinite(self.deviation) and not self.mainly_smooth
        return self.seen <= EXACT and not determined

    @property
    def mainly_smooth(self) -> bool:
        """True if smoothness determines the direction, or most of it."""
        return self.smoothed and self.seen <= 0.1 * self.ratio
