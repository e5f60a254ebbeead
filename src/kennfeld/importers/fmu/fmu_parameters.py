"""Parameters of an FMU as scalars, curves and maps, and the order in which its code takes their values.

A family of numbers `table[1,1]`, `table[1,2]`, ... of FMI 2.0, and an array of FMI 3.0, is one table over the numbers
of its rows and columns: `values[i, j]` belongs to row i + 1 and column j + 1.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter, ParameterAttributes, parameter
from kennfeld.importers.fmu.description import FmuVariable

_ELEMENT = re.compile(r"(.+)\[(\d{1,6}(?:,\s*\d{1,6}){0,3})\]")
_START = re.compile(r"^(.+?)((?:\[[\d, ]+\])?)$")
_MOST_AXES = 4


class ParameterValue(NamedTuple):
    """One value that the code takes: a scalar parameter, or the value of a table at these coordinates."""

    parameter: str
    coordinates: tuple[float, ...]


class ParameterGroup(NamedTuple):
    """Variables that are one parameter: a scalar without shape, or values over the numbers of rows, columns, ..."""

    name: str
    shape: tuple[int, ...]
    values: Float | float
    unit: str
    lower: Float | float
    upper: Float | float


class FmuParameters(NamedTuple):
    """The parameters, and their values in the order of the FMU's variables."""

    parameters: ParameterSet
    values: tuple[ParameterValue, ...]


def parameters_of(variables: Sequence[FmuVariable], prefix: str = "") -> FmuParameters:
    """Group variables to parameters; `prefix` precedes their names.

    >>> first, second = (FmuVariable(f"k[{i}]", i, "Real", "parameter", "fixed", (3.0 + i,)) for i in (1, 2))
    >>> parameters_of([second, first]).parameters["k"].values, parameters_of([second, first]).values[0].coordinates
    (array([4., 5.]), (2.0,))
    """
    parameters: list[Parameter] = []
    values: list[ParameterValue] = []
    for group in parameter_groups(variables):
        limits: ParameterAttributes = {"lower": group.lower, "upper": group.upper, "unit": group.unit}
        parameters.append(parameter(prefix + group.name, group.values, _axes(group.shape), **limits))
    for variable, (name, index) in _named(variables):
        if index or not variable.shape:
            values.append(ParameterValue(prefix + name, tuple(map(float, index))))
        # a table has at most four axes: elements of larger arrays are numbers of their own
        elif len(variable.shape) > _MOST_AXES:
            values += [ParameterValue(prefix + element, ()) for element in variable.elements]
        else:
            values += [ParameterValue(prefix + name, each) for each in _coordinates(variable.shape)]
    return FmuParameters(ParameterSet(parameters), tuple(values))


def parameter_groups(variables: Sequence[FmuVariable]) -> Iterator[ParameterGroup]:
    """Yield what becomes a parameter each: a number, an array, or a family of numbers.

    >>> variables = [FmuVariable(f"k[{i}]", i, "Real", "parameter", "fixed", (3.0 + i,)) for i in (1, 2)]
    >>> [(group.name, group.shape) for group in parameter_groups(variables)]
    [('k', (2,))]
    """
    named = list(_named(variables))
    members: dict[str, list[tuple[FmuVariable, tuple[int, ...]]]] = {}
    for variable, (name, index) in named:
        if index:
            members.setdefault(name, []).append((variable, index))
    for variable, (name, index) in named:
        limits = variable.unit, variable.minimum, variable.maximum
        if index:
            # the table takes the place of its first member; the others find nothing left
            if family := members.pop(name, None):
                yield _family(name, family)
        elif len(variable.shape) > _MOST_AXES:
            numbered = zip(variable.elements, variable.start, strict=True)
            yield from (ParameterGroup(element, (), start, *limits) for element, start in numbered)
        elif variable.shape:
            yield ParameterGroup(name, variable.shape, np.reshape(variable.start, variable.shape), *limits)
        else:
            yield ParameterGroup(name, (), variable.start[0], *limits)


def start_values_of(states: Sequence[FmuVariable], prefix: str = "") -> FmuParameters:
    """Group the start values of states to parameters `NAME.start`, which are locked.

    >>> states = [FmuVariable("x[1]", 1, "Real", "local", "continuous", (3.0,))]
    >>> (value,) = start_values_of(states).parameters.parameters
    >>> value.name, value.values, value.locked
    ('x.start', array([3.]), array([ True]))
    """
    parameters, values = parameters_of(_renamed(states), prefix)
    locked = [each.changed(locked=np.ones(each.values.shape, dtype=bool)) for each in parameters.parameters]
    return FmuParameters(ParameterSet(locked), values)


def start_groups(states: Sequence[FmuVariable]) -> list[ParameterGroup]:
    """Group the start values of states."""
    return list(parameter_groups(_renamed(states)))


def _renamed(states: Sequence[FmuVariable]) -> list[FmuVariable]:
    # `x[1]` becomes `x.start[1]`, so that the start values of a family are a family as well
    return [state._replace(name=_START.sub(r"\1.start\2", state.name)) for state in states]


def _named(variables: Sequence[FmuVariable]) -> Iterator[tuple[FmuVariable, tuple[str, tuple[int, ...]]]]:
    """Yield variables with the name of their parameter, and the index of a number of a family."""
    families = _families(variables)
    return ((variable, families.get(variable.name, (variable.name, ()))) for variable in variables)


def _families(variables: Sequence[FmuVariable]) -> Mapping[str, tuple[str, tuple[int, ...]]]:
    """Return family and index of each variable that belongs to a complete family of numbers."""
    members: dict[str, dict[tuple[int, ...], FmuVariable]] = {}
    for variable in variables:
        match = None if variable.shape or not variable.name.endswith("]") else _ELEMENT.fullmatch(variable.name)
        if match is not None:
            members.setdefault(match[1], {})[tuple(int(word) for word in match[2].split(","))] = variable
    names = {variable.name for variable in variables}
    return {
        variable.name: (family, index)
        for family, numbered in members.items()
        # a number `k` beside `k[1]` already has the name that the table would have
        if family not in names and _is_complete(list(numbered))
        for index, variable in numbered.items()
    }


def _is_complete(indices: Sequence[tuple[int, ...]]) -> bool:
    lengths = {len(index) for index in indices}
    # the indices differ, so that as many as their largest numbers span leave no gap
    return len(lengths) == 1 and min(map(min, indices)) == 1 and len(indices) == math.prod(map(max, zip(*indices)))  # noqa: B905


def _coordinates(shape: Sequence[int]) -> Iterator[tuple[float, ...]]:
    return product(*(map(float, range(1, count + 1)) for count in shape))


def _axes(shape: Sequence[int]) -> list[Axis]:
    return [Axis(np.arange(1.0, count + 1)) for count in shape]


def _family(name: str, members: Sequence[tuple[FmuVariable, tuple[int, ...]]]) -> ParameterGroup:
    shape = tuple(max(numbers) for numbers in zip(*(index for _, index in members), strict=True))
    values, lower, upper = (np.empty(shape) for _ in range(3))
    for member, index in members:
        at = tuple(number - 1 for number in index)
        values[at], lower[at], upper[at] = member.start[0], member.minimum, member.maximum
    return ParameterGroup(name, shape, values, members[0][0].unit, lower, upper)
