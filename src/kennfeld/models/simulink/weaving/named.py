"""Arrays that are a parameter as a whole: the variable behind a table's field, or the field itself."""

import re
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.struct_parts import part_of, way_of
from kennfeld.models.simulink.variables.scopes import Array, Coded, Masked, Scope, Variable
from kennfeld.models.simulink.weaving.site import Site
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["Named", "given_table", "named", "named_text"]


@dataclass(frozen=True, eq=False)
class Named:
    """The numbers of a field, and the name that they go by: that of a variable, or "Path:Field" of a literal."""

    name: str
    values: Array
    variable: Variable
    is_variable: bool


def named(site: Site, field: str) -> Named:
    """What a field holds. Where it is but a variable, through masks or within structs, that gives the name.

    A matrix that is transposed on the way is not the variable itself: it goes by the name with a quote behind it.
    """
    text = site.text(field)
    values = site.numbers(field)
    found = _variable(text, site.atom.scope)
    if found is None:
        return Named(
            f"{site.atom.path}:{field}", values, Variable(values, source=_source(text, site.atom.scope)), False
        )
    name, variable, transposed = found
    if transposed:
        return Named(f"{name}'", values, _transposed(variable), True)
    return Named(name, values, variable, True)


def _transposed(variable: Variable) -> Variable:
    """The variable of a matrix, its axes and limits changed over as well."""
    matrix = np.transpose(np.asarray(variable.value))
    lower, upper = (np.transpose(bound) for bound in (variable.lower, variable.upper))
    return replace(variable, value=matrix, axes=variable.axes[::-1], lower=lower, upper=upper)


def _source(text: str, scope: Scope) -> str:
    """Where a field's numbers come from: an expression of variables, or the field alone."""
    if any(scope.find(name) is not None for name in re.findall(r"[^\W\d]\w*", text)):
        return f"{' '.join(text.split())[:40]} of the block"
    return "a literal of the block"


def named_text(site: Site, text: str) -> Named:
    """What an expression holds that is nothing but a variable, as `named` says it."""
    found = _variable(text, site.atom.scope)
    if found is None or found[2] or not isinstance(found[1].value, np.ndarray):
        raise UnsupportedError(f"{text[:80]} is no variable with numbers")
    return Named(found[0], found[1].value, found[1], True)


def given_table(site: Site, text: str) -> Named | None:
    """The table that a calibration file gives in the place of a table object; None where there is none."""
    found = _variable(text, site.atom.scope)
    if found is None or found[2] or not isinstance(found[1].value, np.ndarray) or not found[1].axes:
        return None
    return Named(found[0], found[1].value, found[1], True)


def _variable(text: str, scope: Scope, deep: int = 0) -> tuple[str, Variable, bool] | None:
    """The variable that an expression is nothing but, its name, and whether it is a matrix that is transposed.

    None where the expression is more.
    """
    try:
        bare, turned = _bare(parse_expression(text))
    except InputError:
        return None
    way = way_of(bare)
    if way is None or deep > 50:
        return None
    found = scope.find(way[0])
    if isinstance(found, Masked):
        inner = ".".join([found.text.strip(), *way[1:]])
        further = _variable(inner, found.outside, deep + 1) if found.evaluated else None
        if further is None:
            return None
        name, variable, transposed = further
        return name, variable, _is_matrix(variable) and turned != transposed
    meant = _meant(found, way, scope)
    return (".".join(way), meant, turned and _is_matrix(meant)) if meant is not None else None


def _meant(found: Coded | Variable | None, way: list[str], scope: Scope) -> Variable | None:
    """The variable at the end of a way."""
    if (part := scope.part(way)) is not None:
        return part
    if not isinstance(found, Variable):
        return None
    try:
        value = part_of(found.value, way)
    except NoValueError:
        return None
    if way[1:] == ["Table"]:  # the limits and the unit of a table object are those of its table
        return replace(found, value=value)
    return found if len(way) == 1 else Variable(value, source=found.source)


def _is_matrix(variable: Variable) -> bool:
    return isinstance(variable.value, np.ndarray) and variable.value.ndim == 2 and 1 not in variable.value.shape


def _bare(tree: m.Expression) -> tuple[m.Expression, bool]:
    """An expression without transposes, casts and `x(:)`, which change no value, and whether it is transposed."""
    turned = False
    while True:
        if isinstance(tree, m.Transpose):
            tree, turned = tree.operand, not turned
        elif isinstance(tree, m.Call) and tree.arguments == (m.Colon(),):
            tree, turned = tree.of, False
        elif isinstance(tree, m.Call) and tree.of in (m.Name("single"), m.Name("double")) and len(tree.arguments) == 1:
            tree = tree.arguments[0]
        else:
            return tree, turned
