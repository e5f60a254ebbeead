"""The structure of a problem, on which its code depends besides the function: fits to other data share the code."""

from collections.abc import Mapping
from typing import Any

from kennfeld.domain.free_axes import AxisKey, FreeAxis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import RBF
from kennfeld.graph import Graph

Structure = tuple[Any, ...]  # of what `==` compares: numbers, texts, bytes, and tuples of these


def structure_of(graph: Graph, parameters: ParameterSet, movable: Mapping[AxisKey, FreeAxis]) -> Structure | None:
    """Return all that the code of a graph depends on in the parameters: their shapes and axes, but no values or bounds.

    None if the graph calls functions or networks, or looks up an expansion: their code may depend on more.

    Args:
        graph: the graph.
        parameters: its tables, perhaps among others.
        movable: the free axes of all of them; a group axis is free if it is so in any table.
    """
    used = graph.parameters
    if any(node.op in ("external", "dense") for node in graph.nodes) or not all(name in parameters for name in used):
        return None
    tables = [parameters[name] for name in used]
    if any(isinstance(table, RBF) for table in tables):
        return None
    return tuple(map(_structure_of_table, tables)), tuple((key, axis.places) for key, axis in movable.items())


def _structure_of_table(table: Parameter) -> Structure:
    # breakpoints by their bits: 0.0 and -0.0 are equal, but different constants
    axes = tuple((axis.name, axis.breakpoints.tobytes()) for axis in table.axes)
    return table.name, table.kind, table.values.shape, table.extrapolation, axes
