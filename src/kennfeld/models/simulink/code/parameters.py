"""The parameters of a model as values of code: variables stay parameters, structs are taken apart when used."""

from collections.abc import Callable, Mapping

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.values import Cells, Held, Later, Members, Struct
from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.struct_parts import way_of
from kennfeld.models.simulink.variables.scopes import Coded, Masked, Scope, Variable

__all__ = ["parameter", "parameter_number"]


def parameter(
    expressions: Expressions, scope: Scope, name: str, enumeration: Callable[[str], Variable | None] = lambda name: None
) -> Held | None:
    """What a name means among the parameters of a model, or enumerations; None where it means nothing."""
    found = scope.find(name) or enumeration(name)
    if found is None:
        return None
    try:
        if isinstance(found, Masked):
            return _masked(expressions, scope, found, name)
        if isinstance(found, Coded):
            held = expressions.name(name, scope, True)
            return held if isinstance(held, np.ndarray) else _made(expressions, scope, Variable(held), [name])
        return _made(expressions, scope, found, [name])
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
    return _made(expressions, scope, Variable(held), [name])


def _made(expressions: Expressions, scope: Scope, variable: Variable, way: list[str]) -> Held:
    """A variable, or the part of one at the end of a way."""
    value, name = variable.value, ".".join(way)
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        fields = {key: _field(expressions, scope, variable, [*way, key]) for key in value}
        return Members(fields) if variable.fixed and len(way) == 1 else Struct(fields)
    if isinstance(value, tuple):
        parts = (Variable(part, source=variable.source, fixed=variable.fixed) for part in value)
        cells = [_part(expressions, scope, part, [f"{name}({at})"]) for at, part in enumerate(parts, 1)]
        return Cells(tuple(cells), (1, len(cells)))

    def array() -> Held:
        held = expressions.variable(name, variable, True)
        assert isinstance(held, np.ndarray)
        return held

    return Later(array, name) if np.size(value) > 1 and not variable.fixed else array()


def _field(expressions: Expressions, scope: Scope, variable: Variable, way: list[str]) -> Later:
    """A field of a struct; a calibration file may give it a value by its full name."""
    assert isinstance(variable.value, Mapping)
    inside = Variable(variable.value[way[-1]], source=variable.source, fixed=variable.fixed)
    return _part(expressions, scope, scope.part(way) or inside, way)


def _part(expressions: Expressions, scope: Scope, part: Variable, way: list[str]) -> Later:
    table = isinstance(part.value, np.ndarray) and part.value.size > 1 and not part.fixed
    return Later(lambda: _made(expressions, scope, part, way), ".".join(way) if table else "")


def parameter_number(expressions: Expressions, name: str, place: tuple[int, ...]) -> float | None:
    """The number that an element of a parameter has by its source; None of a table."""
    found = expressions.declared.parameters.get(name)
    if found is None or found.axes:
        return None
    values = np.asarray(found.values, dtype=np.float64)
    return float(values[place] if place else values.ravel()[0])


_GIVE = "Give its variables among the parameters: a script, a .mat, .sldd or calibration file."
