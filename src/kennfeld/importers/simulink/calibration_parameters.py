"""Parameters that a model looks up, collected while its graph is built."""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import count
from types import MappingProxyType
from typing import Any

import numpy as np

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Parameter, Scalar, parameter
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.variables.mask_scope import Variable, nested_field, split_index
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, Numbers
from kennfeld.models.imperative.symbolic_values import constants


class DeclaredParameters:
    """Parameters by name.

    `promoted` are block fields such as "Torque/Gain1:Gain" whose literals become parameters. Variables of one name may
    have different values in referenced models. Each is then a parameter of its own; the plain name belongs to the
    variable in `whole`, the variables of the top model.
    """

    def __init__(self, promoted: Collection[str] = ()) -> None:
        self.promoted = frozenset(promoted)
        self.whole: Mapping[str, Variable] = MappingProxyType({})
        self.parameters: dict[str, Parameter] = {}
        self.sources: dict[str, str] = {}
        self._axes: dict[str, Axis] = {}

    def array(self, builder: GraphBuilder, name: str, variable: Variable) -> Nodes:
        """Return the nodes that look up each element of a variable, Int[rows, columns]."""
        numbers = np.asarray(variable.value, dtype=np.float64)
        if numbers.size == 0:
            return np.zeros((0, 0), dtype=np.int64)
        shape = np.atleast_2d(numbers).shape
        known = self.parameters.get(name)
        if known is not None and known.axes:  # a table also used as numbers stays unchanged
            return constants(builder, numbers)
        if numbers.size == 1:
            scalar = Scalar(name, float(numbers.ravel()[0]), **_source_attributes(variable, ()))
            return np.full(shape, builder.lookup(self._declare(scalar, variable).name), dtype=np.int64)
        # infinite limits and NaN as a mark are not values to calibrate
        if not np.all(np.isfinite(numbers)):
            return constants(builder, numbers)
        return self._block(builder, name, numbers, variable).reshape(shape)

    def _block(self, builder: GraphBuilder, name: str, numbers: Numbers, variable: Variable) -> Nodes:
        # a row or a column is a block of one dimension
        flat = numbers.ravel() if 1 in np.atleast_2d(numbers).shape else numbers
        kept = self._declare(Block(name, flat, **_source_attributes(variable, flat.shape)), variable)
        nodes = np.empty(flat.shape, dtype=np.int64)
        for place in np.ndindex(*flat.shape):
            nodes[place] = builder.lookup(kept.name, *(builder.const(float(index)) for index in place))
        return nodes

    def table(
        self, name: str, values: Numbers, axes: Collection[Axis], variable: Variable, locked: bool, beyond: str
    ) -> Parameter:
        """Return the curve, map or cube of a table, or the equal one that is already declared."""
        axes = [self._group_axis(axis) for axis in axes]
        attributes = _source_attributes(variable, values.shape) | {"locked": np.array(locked), "extrapolation": beyond}
        return self._declare(parameter(name, values, axes, **attributes), variable)

    def _group_axis(self, axis: Axis) -> Axis:
        """Return the axis, without its name if another axis of that name has other breakpoints."""
        if not axis.name:
            return axis
        # a set of parameters refuses two axes of one name
        known = self._axes.setdefault(axis.name, axis)
        return known if np.array_equal(known.breakpoints, axis.breakpoints) else axis.changed(name="")

    def _declare(self, parameter: Parameter, variable: Variable) -> Parameter:
        """Return the declared parameter that equals this one, or declare it under a free name."""
        for name in self._candidate_names(parameter):
            known = self.parameters.get(name)
            if known is None:
                self.parameters[name] = parameter if name == parameter.name else parameter.changed(name=name)
                self.sources[name] = variable.source
            if known is None or _is_equal(known, parameter):
                return self.parameters[name]
        raise AssertionError("names never end")

    def _candidate_names(self, parameter: Parameter) -> Iterator[str]:
        """Yield names for a parameter, preferred first: its own, unless the top model uses it for other values."""
        top = self._top_level_numbers(parameter.name)
        if top is not None and top.size == 1:  # one number may stand for all values of a table
            top = np.full(parameter.size, top.item())
        if top is None or np.array_equal(np.ravel(top), parameter.values.ravel(), equal_nan=True):
            yield parameter.name
        yield from (f"{parameter.name}_{number}" for number in count(2))

    def _top_level_numbers(self, name: str) -> Numbers | None:
        """Return the numbers that a name has in the top model, or None."""
        path = [name] if name in self.whole else name.split(".")
        whole = self.whole.get(split_index(path[0])[0]) if len(path) > 1 else self.whole.get(name)
        if whole is None:
            return None
        try:
            value = nested_field(whole.value, path)
        except EvaluationError:
            return None
        return value if isinstance(value, np.ndarray) else None

    def values(self, used: Collection[str]) -> ParameterSet:
        """Return the used parameters in order of declaration."""
        return ParameterSet(parameter for name, parameter in self.parameters.items() if name in used)


def _is_equal(parameter: Parameter, other: Parameter) -> bool:
    """Return True if two parameters of one name have equal values, axes and extrapolation."""
    axes = [axis.breakpoints for axis in parameter.axes], [axis.breakpoints for axis in other.axes]
    return (
        parameter.kind == other.kind
        and parameter.extrapolation == other.extrapolation
        and np.array_equal(parameter.values, other.values, equal_nan=True)
        and len(axes[0]) == len(axes[1])
        and all(map(np.array_equal, *axes))
    )


def _source_attributes(variable: Variable, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return unit, description and limits of a variable; limits must fit the shape of the value."""
    bounds = {side: np.asarray(getattr(variable, side)) for side in ("lower", "upper")}
    size = math.prod(shape)
    fitting = {side: bound.reshape(shape) if bound.size == size else bound for side, bound in bounds.items()}
    known = {side: bound for side, bound in fitting.items() if bound.size in (1, size)}
    return {"unit": variable.unit, "description": variable.description, **known}
