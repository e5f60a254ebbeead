"""Layout of all parameter values and free breakpoints in one vector p, as the native code reads it."""

from collections.abc import Collection, Mapping
from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.free_axes import AxisKey, free_axes, with_breakpoints
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.derivative import Linearization
from kennfeld.graph.lookup_lowering import Free


@dataclass(frozen=True)
class ValueLayout:
    """Position of each value in the vector p: values of free parameters first, in the order of the columns of J.

    Parameters that can influence a state come before the others; `reach` counts their values. `moving` holds the
    offsets of free axes; `places` gives a table and the dimension in which each such axis occurs.
    """

    offsets: dict[str, int]
    free: int
    reach: int
    total: int
    moving: Mapping[AxisKey, int] = field(default_factory=dict)
    places: Mapping[AxisKey, tuple[str, int]] = field(default_factory=dict)

    def pack(self, parameters: ParameterSet) -> Float:
        """Return the vector p of these parameters, shape (total,)."""
        flat = np.empty(self.total)
        for name, at in self.offsets.items():
            table = parameters[name]
            # what is not fitted may be stored in another form: expansions with reciprocals of their widths
            flat[at : at + table.size] = table.values.ravel() if at < self.free else table.packed
        for key, at in self.moving.items():
            points = self._points(key, parameters)
            flat[at : at + points.size] = points
        return flat

    def _points(self, key: AxisKey, parameters: ParameterSet) -> Float:
        table, which = self.places[key]
        return parameters[table].axes[which].breakpoints

    def unpack(self, flat: Float, parameters: ParameterSet) -> ParameterSet:
        """Return the parameters with the free values and breakpoints of the vector p, Float[total]."""
        changed = [
            parameters[name].with_values(flat[at : at + parameters[name].size])
            for name, at in self.offsets.items()
            if at < self.free
        ]
        moved = self.breakpoints(flat, parameters)
        return with_breakpoints(parameters.with_parameters(*changed), moved)

    def breakpoints(self, flat: Float, parameters: ParameterSet) -> dict[AxisKey, Float]:
        """Select the free breakpoints of each axis, Float[breakpoints], from the vector p, Float[total]."""
        free = {key: at for key, at in self.moving.items() if at < self.free}
        return {key: flat[at : at + self._points(key, parameters).size] for key, at in free.items()}


def order_values(line: Linearization, parameters: ParameterSet, used: Collection[str], free: Free) -> ValueLayout:
    """Assign offsets in the vector p to parameters and free axes."""
    # rows of next values and of first values
    states = [*line.slopes.reach[len(line.outputs) :], *line.start_slopes.reach]
    atoms = (line.nodes[at] for row in states for at in row if at not in line.seeds)
    reaching = {atom.payload.key if atom.op == "position" else atom.payload.name for atom in atoms}
    searched = (n.payload.key for n in line.nodes if n.op in ("position", "density"))
    axes = free_axes(parameters)
    sizes: dict[str | AxisKey, int] = {name: parameters[name].size for name in used}
    sizes |= {key: len(axes[key].axis) for key in searched if key is not None}
    # the order is that of the columns of J: those that need sensitivities of states come first
    groups = [
        [n for n in sizes if n in free and n in reaching],
        [n for n in sizes if n in free and n not in reaching],
        [n for n in sizes if n not in free],
    ]
    first: dict[str | AxisKey, int] = {}
    ends, at = [], 0
    for group in groups:
        for name in group:
            first[name] = at
            at += sizes[name]
        ends.append(at)
    offsets = {name: at for name, at in first.items() if isinstance(name, str)}
    moving = {key: at for key, at in first.items() if not isinstance(key, str)}
    places = {key: axes[key].places[0] for key in moving}
    return ValueLayout(offsets, free=ends[1], reach=ends[0], total=at, moving=moving, places=places)
