"""Parameters and enumerations of a model that code may name, resolved when they are used.

Variables of the resolved values stay parameters; fields of structs are parameters named by their paths.
"""

from collections.abc import Mapping

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    ParameterValue,
    Scope,
    Variable,
)
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.simulink_objects import ENUMERATION
from kennfeld.matlab.values import MatlabCell, MatlabStruct, StructArray, object_array
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.program.traversal import field_path

_REMEDY = "Define its variables in a script, a .mat, .sldd or calibration file given as parameters."


def resolve_parameter(
    expressions: ParameterExpressions,
    scope: Scope,
    name: str,
) -> s.SymbolicValue | None:
    """Resolve a name in code among model parameters and enumerations; None if undefined."""
    variable = scope.find(name)
    if variable is None:
        return None
    try:
        if isinstance(variable, MaskVariable | MaskCodeVariable):
            return _resolve_mask_parameter(expressions, scope, variable, name)
        return _resolve_variable(expressions, scope, variable, [name])
    except (EvaluationError, InputError) as error:
        raise ProgramError(f"parameter {name}: {error}", _REMEDY) from None


def _resolve_mask_parameter(
    expressions: ParameterExpressions, scope: Scope, variable: MaskVariable | MaskCodeVariable, name: str
) -> s.SymbolicValue:
    """Resolve a variable of a mask; a struct keeps the names it has outside of the mask."""
    value = expressions.mask_value(variable)
    if isinstance(value, np.ndarray | str):
        return value
    outside = field_path(parse_expression(variable.text)) if isinstance(variable, MaskVariable) else None
    if outside is not None and len(outside) == 1:
        whole = resolve_parameter(expressions, variable.outside, outside[0])
        if whole is not None:
            return whole
    return _resolve_variable(expressions, scope, Variable(value), [name])


def _resolve_variable(
    expressions: ParameterExpressions, scope: Scope, variable: Variable, path: list[str]
) -> s.SymbolicValue:
    """Resolve a variable or the field at a path in it."""
    value, name = variable.value, ".".join(path)
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        fields = _fields(expressions, scope, variable, value, path)
        return MatlabStruct.of(fields, ENUMERATION if variable.fixed and len(path) == 1 else "")
    if isinstance(value, StructArray):
        elements = [
            _fields(expressions, scope, variable, element, [f"{name}({at})"]) for at, element in enumerate(value, 1)
        ]
        return MatlabStruct(object_array(elements, value.shape), value.names)
    if isinstance(value, tuple):
        parts = (Variable(part, source=variable.source, fixed=variable.fixed) for part in value)
        cells = [_part(expressions, scope, part, [f"{name}({at})"]) for at, part in enumerate(parts, 1)]
        return MatlabCell.of(cells, (1, len(cells)))

    def array() -> s.SymbolicValue:
        nodes = expressions.variable(name, variable, True)
        assert isinstance(nodes, np.ndarray)
        return nodes

    return s.DeferredValue(array, name) if np.size(value) > 1 and not variable.fixed else array()


def _fields(
    expressions: ParameterExpressions,
    scope: Scope,
    variable: Variable,
    value: Mapping[str, ParameterValue],
    path: list[str],
) -> dict[str, s.SymbolicValue]:
    """Return the fields of a struct; a calibration file may override one by its full name."""
    fields: dict[str, s.SymbolicValue] = {}
    for key, part in value.items():
        field = scope.part([*path, key]) or Variable(part, source=variable.source, fixed=variable.fixed)
        fields[key] = _part(expressions, scope, field, [*path, key])
    return fields


def _part(expressions: ParameterExpressions, scope: Scope, part: Variable, path: list[str]) -> s.DeferredValue:
    table = isinstance(part.value, np.ndarray) and part.value.size > 1 and not part.fixed
    return s.DeferredValue(lambda: _resolve_variable(expressions, scope, part, path), ".".join(path) if table else "")
