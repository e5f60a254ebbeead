"""The parameters that a model looks up, collected while its graph is built."""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import count
from types import MappingProxyType
from typing import Any

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, Numbers
from kennfeld.models.simulink.variables.mask_scope import Variable, nested_field
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Scalar, parameter

__all__ = ["DeclaredParameters"]


class DeclaredParameters:
    """Parameters by name. `promoted` are fields of blocks, "Torque/Gain1:Gain", whose literals are parameters too.

    Variables of one name may hold other values in referenced models: each is a parameter of its own, the name itself
    that of the variable in `whole`, the variables of the model at the top.
    """

    def __init__(self, promoted: Collection[str] = ()) -> None:
        self.promoted = frozenset(promoted)
        self.whole: Mapping[str, Variable] = MappingProxyType({})
        self.parameters: dict[str, Parameter] = {}
        self.sources: dict[str, str] = {}
        self._axes: dict[str, Axis] = {}

    def array(self, builder: GraphBuilder, name: str, variable: Variable) -> Nodes:
        """The nodes that look up each element of a variable, Int[rows, columns]."""
        numbers = np.asarray(variable.value, dtype=np.float64)
        if numbers.size == 0:
            return np.zeros((0, 0), dtype=np.int64)
        shape = np.atleast_2d(numbers).shape
        known = self.parameters.get(name)
        if known is not None and known.axes:  # a table that is used as numbers as well stays as it is
            return _constants(builder, np.atleast_2d(numbers))
        if numbers.size == 1:
            scalar = self._kept(Scalar(name, float(numbers.ravel()[0]), **_said(variable, ())), variable)
            return np.full(shape, builder.lookup(scalar.name), dtype=np.int64)
        if not np.all(np.isfinite(numbers)):
            return _constants(builder, np.atleast_2d(numbers))
        return self._block(builder, name, numbers, variable).reshape(shape)

    def _block(self, builder: GraphBuilder, name: str, numbers: Numbers, variable: Variable) -> Nodes:
        flat = numbers.ravel() if 1 in np.atleast_2d(numbers).shape else numbers
        kept = self._kept(Block(name, flat, **_said(variable, flat.shape)), variable)
        made = np.empty(flat.shape, dtype=np.int64)
        for place in np.ndindex(*flat.shape):
            made[place] = builder.lookup(kept.name, *(builder.const(float(index)) for index in place))
        return made

    def table(
        self, name: str, values: Numbers, axes: Collection[Axis], variable: Variable, locked: bool, beyond: str
    ) -> Parameter:
        """The curve, map or cube of a table; the one that is there already where it is the same."""
        axes = [self._group(axis) for axis in axes]
        said = _said(variable, values.shape)
        return self._kept(
            parameter(name, values, axes, locked=np.array(locked), extrapolation=beyond, **said), variable
        )

    def _group(self, axis: Axis) -> Axis:
        """The axis, without its name where another has that name already and other breakpoints."""
        if not axis.name:
            return axis
        known = self._axes.setdefault(axis.name, axis)
        return known if np.array_equal(known.breakpoints, axis.breakpoints) else axis.changed(name="")

    def _kept(self, made: Parameter, variable: Variable) -> Parameter:
        """The parameter that holds this: the one that is there already, or a new one under a name that is free."""
        for name in self._names(made):
            known = self.parameters.get(name)
            if known is None:
                self.parameters[name] = made if name == made.name else made.changed(name=name)
                self.sources[name] = variable.source
            if known is None or _same(known, made):
                return self.parameters[name]
        raise AssertionError("names never end")

    def _names(self, made: Parameter) -> Iterator[str]:
        """The names that a parameter may have, the best first: its own, unless that means other values at the top."""
        top = self._at_the_top(made.name)
        if top is None or np.array_equal(np.ravel(top), made.values.ravel(), equal_nan=True):
            yield made.name
        yield from (f"{made.name}_{number}" for number in count(2))

    def _at_the_top(self, name: str) -> Numbers | None:
        """The numbers that a name stands for in the model at the top; None where it stands for none."""
        way = [name] if name in self.whole else name.split(".")
        if way[0] not in self.whole:
            return None
        try:
            value = nested_field(self.whole[way[0]].value, way)
        except EvaluationError:
            return None
        return value if isinstance(value, np.ndarray) else None

    def values(self, used: Collection[str]) -> ParameterSet:
        """The parameters that are looked up, in the order in which they were met."""
        return ParameterSet(made for name, made in self.parameters.items() if name in used)


def _same(one: Parameter, other: Parameter) -> bool:
    """Whether two parameters of one name look up the same."""
    axes = [axis.breakpoints for axis in one.axes], [axis.breakpoints for axis in other.axes]
    return (
        one.kind == other.kind
        and one.extrapolation == other.extrapolation
        and np.array_equal(one.values, other.values, equal_nan=True)
        and len(axes[0]) == len(axes[1])
        and all(map(np.array_equal, *axes))
    )


def _said(variable: Variable, shape: tuple[int, ...]) -> dict[str, Any]:
    """What a variable's source says beside its value, the limits for values of a shape."""
    bounds = {side: np.asarray(getattr(variable, side)) for side in ("lower", "upper")}
    size = math.prod(shape)
    fitting = {side: bound.reshape(shape) if bound.size == size else bound for side, bound in bounds.items()}
    known = {side: bound for side, bound in fitting.items() if bound.size in (1, size)}
    return {"unit": variable.unit, "description": variable.description, **known}


def _constants(builder: GraphBuilder, numbers: Numbers) -> Nodes:
    return np.array([builder.const(float(n)) for n in numbers.ravel()], dtype=np.int64).reshape(numbers.shape)
