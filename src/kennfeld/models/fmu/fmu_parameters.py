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

from kennfeld.models.fmu.description import FmuVariable
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, parameter

_ELEMENT = re.compile(r"(.+)\[(\d{1,6}(?:,\s*\d{1,6}){0,3})\]")
_START = re.compile(r"^(.+?)((?:\[[\d, ]+\])?)$")
_MOST_AXES = 4


class ParameterValue(NamedTuple):
    """One value that the code takes: a scalar parameter, or the value of a table at these coordinates."""

    parameter: str
    coordinates: tuple[float, ...]


class FmuParameters(NamedTuple):
    """The parameters, and their values in the order of the FMU's variables."""

    parameters: ParameterSet
    values: tuple[ParameterValue, ...]


def parameters_of(variables: Sequence[FmuVariable], prefix: str = "") -> FmuParameters:
    """Return the parameters of variables; `prefix` precedes their names.

    >>> first, second = (FmuVariable(f"k[{i}]", i, "Real", "parameter", "fixed", (3.0 + i,)) for i in (1, 2))
    >>> parameters_of([second, first]).parameters["k"].values, parameters_of([second, first]).values[0].coordinates
    (array([4., 5.]), (2.0,))
    """
    families = _families(variables)
    parameters: list[Parameter] = []
    values: list[ParameterValue] = []
    done: set[str] = set()
    for variable in variables:
        name, index = families.get(variable.name, (variable.name, ()))
        if index:
            values.append(ParameterValue(prefix + name, tuple(map(float, index))))
            if name not in done:
                members = [v for v in variables if families.get(v.name, ("",))[0] == name]
                parameters.append(_table(prefix + name, members, [families[v.name][1] for v in members]))
                done.add(name)
        elif len(variable.shape) > _MOST_AXES:
            numbered = zip(variable.elements, variable.start, strict=True)
            parameters += [_scalar(prefix + element, variable, start) for element, start in numbered]
            values += [ParameterValue(prefix + element, ()) for element in variable.elements]
        else:
            parameters.append(_array(prefix + name, variable))
            values += [ParameterValue(prefix + name, each) for each in _coordinates(variable.shape)]
    return FmuParameters(ParameterSet(parameters), tuple(values))


def start_values_of(states: Sequence[FmuVariable], prefix: str = "") -> FmuParameters:
    """Return the start values of states as parameters `NAME.start`, which are locked.

    >>> states = [FmuVariable("x[1]", 1, "Real", "local", "continuous", (3.0,))]
    >>> (value,) = start_values_of(states).parameters.parameters
    >>> value.name, value.values, value.locked
    ('x.start', array([3.]), array([ True]))
    """
    renamed = [state._replace(name=_START.sub(r"\1.start\2", state.name)) for state in states]
    parameters, values = parameters_of(renamed, prefix)
    locked = [each.changed(locked=np.ones(each.values.shape, dtype=bool)) for each in parameters.parameters]
    return FmuParameters(ParameterSet(locked), values)


def _families(variables: Sequence[FmuVariable]) -> Mapping[str, tuple[str, tuple[int, ...]]]:
    """Return family and index of each variable that belongs to a complete family of numbers."""
    members: dict[str, dict[tuple[int, ...], FmuVariable]] = {}
    for variable in variables:
        match = None if variable.shape else _ELEMENT.fullmatch(variable.name)
        if match is not None:
            members.setdefault(match[1], {})[tuple(int(word) for word in match[2].split(","))] = variable
    names = {variable.name for variable in variables}
    return {
        variable.name: (family, index)
        for family, numbered in members.items()
        if family not in names and _is_complete(list(numbered))
        for index, variable in numbered.items()
    }


def _is_complete(indices: Sequence[tuple[int, ...]]) -> bool:
    lengths = {len(index) for index in indices}
    return len(lengths) == 1 and min(map(min, indices)) == 1 and len(indices) == math.prod(map(max, zip(*indices)))  # noqa: B905


def _coordinates(shape: Sequence[int]) -> Iterator[tuple[float, ...]]:
    return product(*(map(float, range(1, count + 1)) for count in shape))


def _axes(shape: Sequence[int]) -> list[Axis]:
    return [Axis(np.arange(1.0, count + 1)) for count in shape]


def _scalar(name: str, variable: FmuVariable, start: float) -> Parameter:
    return parameter(name, start, lower=variable.minimum, upper=variable.maximum, unit=variable.unit)


def _array(name: str, variable: FmuVariable) -> Parameter:
    if not variable.shape:
        return _scalar(name, variable, variable.start[0])
    values = np.reshape(variable.start, variable.shape)
    limits = {"lower": variable.minimum, "upper": variable.maximum}
    return parameter(name, values, _axes(variable.shape), unit=variable.unit, **limits)


def _table(name: str, members: Sequence[FmuVariable], indices: Sequence[tuple[int, ...]]) -> Parameter:
    shape = tuple(max(numbers) for numbers in zip(*indices, strict=True))
    values, lower, upper = (np.empty(shape) for _ in range(3))
    for member, index in zip(members, indices, strict=True):
        at = tuple(number - 1 for number in index)
        values[at], lower[at], upper[at] = member.start[0], member.minimum, member.maximum
    return parameter(name, values, _axes(shape), unit=members[0].unit, lower=lower, upper=upper)
