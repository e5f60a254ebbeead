"""The parameters that a model looks up, collected while its graph is built."""

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.variables.scopes import Array, Variable
from kennfeld.parameters import Axis, Block, Parameter, ParameterSet, Scalar, parameter

__all__ = ["Declared"]


class Declared:
    """Parameters by name. `promoted` are fields of blocks, "Torque/Gain1:Gain", whose literals are parameters too."""

    def __init__(self, promoted: Collection[str] = ()) -> None:
        self.promoted = frozenset(promoted)
        self.parameters: dict[str, Parameter] = {}
        self.sources: dict[str, str] = {}
        self._axes: dict[str, Axis] = {}

    def array(self, loom: Loom, name: str, variable: Variable) -> Nodes:
        """The nodes that look up each element of a variable, Int[rows, columns]."""
        numbers = np.asarray(variable.value, dtype=np.float64)
        if numbers.size == 0:
            return np.zeros((0, 0), dtype=np.int64)
        shape = np.atleast_2d(numbers).shape
        known = self.parameters.get(name)
        if known is not None and known.axes:  # a table that is used as numbers as well stays as it is
            return _constants(loom, np.atleast_2d(numbers))
        if numbers.size == 1:
            self._add(Scalar(name, float(numbers.ravel()[0]), **_said(variable, ())), variable)
            return np.full(shape, loom.lookup(name), dtype=np.int64)
        if not np.all(np.isfinite(numbers)):
            return _constants(loom, np.atleast_2d(numbers))
        return self._block(loom, name, numbers, variable).reshape(shape)

    def _block(self, loom: Loom, name: str, numbers: Array, variable: Variable) -> Nodes:
        flat = numbers.ravel() if 1 in np.atleast_2d(numbers).shape else numbers
        self._add(Block(name, flat, **_said(variable, flat.shape)), variable)
        made = np.empty(flat.shape, dtype=np.int64)
        for place in np.ndindex(*flat.shape):
            made[place] = loom.lookup(name, *(loom.const(float(index)) for index in place))
        return made

    def table(
        self, name: str, values: Array, axes: Collection[Axis], variable: Variable, locked: bool, beyond: str
    ) -> Parameter:
        """The curve, map or cube of a table; the one that is there already where it is the same."""
        axes = [self._group(axis) for axis in axes]
        said = _said(variable, values.shape)
        made = parameter(name, values, axes, locked=np.array(locked), extrapolation=beyond, **said)
        known = self.parameters.get(name)
        if known is not None and _same(known, made):
            return known
        if known is not None:
            made = made.changed(name=self._free(name))
        self._add(made, variable)
        return made

    def _group(self, axis: Axis) -> Axis:
        """The axis, without its name where another has that name already and other breakpoints."""
        if not axis.name:
            return axis
        known = self._axes.setdefault(axis.name, axis)
        return known if np.array_equal(known.breakpoints, axis.breakpoints) else axis.changed(name="")

    def _free(self, name: str) -> str:
        """A name like this one that is not taken."""
        number = 2
        while f"{name}_{number}" in self.parameters:
            number += 1
        return f"{name}_{number}"

    def _add(self, made: Parameter, variable: Variable) -> None:
        self.parameters.setdefault(made.name, made)
        self.sources.setdefault(made.name, variable.source)

    def values(self, used: Collection[str]) -> ParameterSet:
        """The parameters that are looked up, in the order in which they were met."""
        return ParameterSet(made for name, made in self.parameters.items() if name in used)


def _same(one: Parameter, other: Parameter) -> bool:
    """Whether two tables of one variable look up the same."""
    return (
        one.values.shape == other.values.shape
        and one.extrapolation == other.extrapolation
        and all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(one.axes, other.axes, strict=True))
    )


def _said(variable: Variable, shape: tuple[int, ...]) -> dict[str, Any]:
    """What a variable's source says beside its value, the limits for values of a shape."""
    bounds = {side: np.asarray(getattr(variable, side)) for side in ("lower", "upper")}
    size = math.prod(shape)
    fitting = {side: bound.reshape(shape) if bound.size == size else bound for side, bound in bounds.items()}
    known = {side: bound for side, bound in fitting.items() if bound.size in (1, size)}
    return {"unit": variable.unit, "description": variable.description, **known}


def _constants(loom: Loom, numbers: Array) -> Nodes:
    return np.array([loom.const(float(n)) for n in numbers.ravel()], dtype=np.int64).reshape(numbers.shape)
