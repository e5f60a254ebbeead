"""The parameters of a model as values of code: variables stay parameters, structs are taken apart when used."""

from collections.abc import Callable, Mapping

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.values import Cells, Held, Later, Struct
from kennfeld.models.simulink.expressions import Expressions, NoValueError, way_of
from kennfeld.models.simulink.scopes import Coded, Masked, Scope, Value, Variable

__all__ = ["parameter", "parameter_number"]


def parameter(expressions: Expressions, scope: Scope, name: str) -> Held | None:
    """What a name means among the parameters of a model; None where it means nothing."""
    found = scope.find(name)
    if found is None:
        return None
    try:
        if isinstance(found, Masked):
            return _masked(expressions, scope, found, name)
        if isinstance(found, Coded):
            held = expressions.name(name, scope, True)
            return held if isinstance(held, np.ndarray) else _made(expressions, Variable(held), name)
        return _made(expressions, found, name)
    except (NoValueError, InputError) as error:
        raise CodeError(f"the parameter {name}: {error}", _GIVE) from None


def _masked(expressions: Expressions, scope: Scope, found: Masked, name: str) -> Held:
    """A parameter of a mask: a struct keeps the names that it has outside of the mask."""
    held = expressions.name(name, scope, True)
    if isinstance(held, np.ndarray | str):
        return held
    outside = way_of(parse_expression(found.text))
    if outside is not None and len(outside) == 1:
        whole = parameter(expressions, found.outside, outside[0])
        if whole is not None:
            return whole
    return _made(expressions, Variable(held), name)


def _made(expressions: Expressions, variable: Variable, name: str) -> Held:
    value = variable.value
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return Struct({key: _field(expressions, variable, name, key) for key in value})
    if isinstance(value, tuple):
        cells = tuple(Later(_cell(expressions, part, f"{name}({at})")) for at, part in enumerate(value, 1))
        return Cells(cells, (1, len(cells)))

    def array() -> Held:
        held = expressions.variable(name, variable, True)
        assert isinstance(held, np.ndarray)
        return held

    return Later(array, name) if np.size(value) > 1 else array()


def _field(expressions: Expressions, variable: Variable, name: str, key: str) -> Later:
    assert isinstance(variable.value, Mapping)
    part = Variable(variable.value[key], source=variable.source)
    table = isinstance(part.value, np.ndarray) and part.value.size > 1
    return Later(lambda: _made(expressions, part, f"{name}.{key}"), f"{name}.{key}" if table else "")


def _cell(expressions: Expressions, value: Value, name: str) -> Callable[[], Held]:
    return lambda: _made(expressions, Variable(value), name)


def parameter_number(expressions: Expressions, name: str, place: tuple[int, ...]) -> float | None:
    """The number that an element of a parameter has by its source; None of a table."""
    found = expressions.declared.parameters.get(name)
    if found is None or found.axes:
        return None
    values = np.asarray(found.values, dtype=np.float64)
    return float(values[place] if place else values.ravel()[0])


_GIVE = "Give its variables among the parameters: a script, a .mat, .sldd or calibration file."
