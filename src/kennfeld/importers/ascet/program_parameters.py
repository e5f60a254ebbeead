"""Parameters of a program: characteristics and tables with their values, units and ranges."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Parameter, Scalar, parameter
from kennfeld.graph import GraphBuilder
from kennfeld.importers.ascet.instances import Program, ProgramVariable, TableElement
from kennfeld.importers.ascet.resolved_types import NumberType
from kennfeld.models.imperative.node_arrays import Nodes


class ProgramParameters:
    """The parameters of a program by label.

    Args:
        program: the program.
        names: names of the parameters by label; `axis_names` those of shared axes.
        values: values that replace those of the program where a constant is required.
    """

    def __init__(
        self, program: Program, names: Mapping[str, str], axis_names: Mapping[str, str], values: ParameterSet
    ) -> None:
        self.program, self.names, self.axis_names = program, names, axis_names
        self.by_name: dict[str, Parameter] = {}
        for label, name in names.items():
            own = self._table(name, program.tables[label]) if label in program.tables else None
            self.by_name[name] = own if own is not None else _number(name, program.variables[label])
        self._values = values

    def _table(self, name: str, table: TableElement) -> Parameter:
        axes = []
        for at, (kind, points) in enumerate(zip(table.type.axes, table.values.axes, strict=True)):
            shared = self.axis_names.get(table.shared[at], "") if table.shared else ""
            axes.append(Axis(points, unit=kind.unit, name=shared))
        # a table that is no characteristic is part of the program: its lookup needs a parameter, no fit may move it
        attributes = _attributes(table.type.value, table.description) | {"locked": np.array(table.is_constant)}
        return parameter(name, table.values.values, axes, **attributes)

    def nodes(self, builder: GraphBuilder, label: str) -> Nodes:
        """Return the nodes that look up a characteristic, Int[rows, columns]."""
        own = self.by_name[self.names[label]]
        if own.kind == "scalar":
            return np.array([[builder.lookup(own.name)]], dtype=np.int64)
        # an array is a block, whose numbers are looked up by their indices from 0
        nodes = np.empty(own.values.shape, dtype=np.int64)
        for place in np.ndindex(*own.values.shape):
            nodes[place] = builder.lookup(own.name, *(builder.const(float(index)) for index in place))
        return nodes.reshape(-1, 1) if nodes.ndim == 1 else nodes

    def number(self, name: str, place: tuple[int, ...]) -> float | None:
        """Return a number of a parameter where a constant is required; None for a table."""
        own = self.by_name.get(name)
        # a size or a number of passes is a number or an element of an array, never one of a table
        if own is None or own.axes:
            return None
        other = self._values.get(name)
        values = other.values if other is not None and other.values.shape == own.values.shape else own.values
        return float(values[place]) if len(place) == values.ndim else None


def _number(name: str, variable: ProgramVariable) -> Parameter:
    """Return the parameter of a characteristic; integers, enumerations and truth values are locked."""
    attributes = _attributes(variable.type, variable.description)
    attributes["locked"] = np.array(variable.type.kind != "real")
    if variable.initial.ndim == 0:
        return Scalar(name, float(variable.initial), **attributes)
    return Block(name, variable.initial, **attributes)


def _attributes(kind: NumberType, description: str) -> dict[str, Any]:
    limits = (kind.low, kind.high) if kind.kind == "real" else (-np.inf, np.inf)
    return {
        "unit": kind.unit,
        "description": description,
        "lower": np.array(limits[0]),
        "upper": np.array(limits[1]),
    }
