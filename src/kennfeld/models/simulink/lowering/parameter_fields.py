"""Arrays that are a parameter as a whole: the variable behind a table's field, or the field itself.

The places that a block selects or assigns along the dimensions of an array.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.traversal import field_path
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.reader.model_tree import split_arguments
from kennfeld.models.simulink.variables.mask_scope import MaskCodeVariable, MaskVariable, Scope, Variable, nested_field

__all__ = [
    "ParameterField",
    "calibrated_table",
    "case_values",
    "length_of",
    "listed",
    "named_text",
    "parameter_field",
    "selected_indices",
]

_MOST_NUMBERS = 10_000


@dataclass(frozen=True, eq=False)
class ParameterField:
    """The numbers of a field, and the name that they go by: that of a variable, or "Path:Field" of a literal."""

    name: str
    values: Numbers
    variable: Variable
    is_variable: bool


def parameter_field(site: BlockContext, field: str) -> ParameterField:
    """What a field holds. Where it is but a variable, through masks or within structs, that gives the name.

    A matrix that is transposed on the way is not the variable itself: it goes by the name with a quote behind it.
    """
    text = site.text(field)
    values = site.numbers(field)
    found = _variable(text, site.atom.scope)
    if found is None:
        return ParameterField(
            f"{site.atom.path}:{field}", values, Variable(values, source=_source(text, site.atom.scope)), False
        )
    name, variable, transposed = found
    if transposed:
        return ParameterField(f"{name}'", values, _transposed(variable), True)
    return ParameterField(name, values, variable, True)


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


def named_text(site: BlockContext, text: str) -> ParameterField:
    """What an expression holds that is nothing but a variable, as `named` says it."""
    found = _variable(text, site.atom.scope)
    if found is None or found[2] or not isinstance(found[1].value, np.ndarray):
        raise UnsupportedError(f"{text[:80]} is no variable with numbers")
    return ParameterField(found[0], found[1].value, found[1], True)


def calibrated_table(site: BlockContext, text: str) -> ParameterField | None:
    """The table that a calibration file gives in the place of a table object; None where there is none."""
    found = _variable(text, site.atom.scope)
    if found is None or found[2] or not isinstance(found[1].value, np.ndarray) or not found[1].axes:
        return None
    return ParameterField(found[0], found[1].value, found[1], True)


def _variable(text: str, scope: Scope, deep: int = 0) -> tuple[str, Variable, bool] | None:
    """The variable that an expression is nothing but, its name, and whether it is a matrix that is transposed.

    None where the expression is more.
    """
    try:
        bare, turned = _bare(parse_expression(text))
    except InputError:
        return None
    way = field_path(bare)
    if way is None or deep > 50:
        return None
    found = scope.find(way[0])
    if isinstance(found, MaskVariable):
        inner = ".".join([found.text.strip(), *way[1:]])
        further = _variable(inner, found.outside, deep + 1) if found.evaluated else None
        if further is None:
            return None
        name, variable, transposed = further
        return name, variable, _is_matrix(variable) and turned != transposed
    meant = _meant(found, way, scope)
    return (".".join(way), meant, turned and _is_matrix(meant)) if meant is not None else None


def _meant(found: MaskCodeVariable | Variable | None, way: list[str], scope: Scope) -> Variable | None:
    """The variable at the end of a way."""
    if (part := scope.part(way)) is not None:
        return part
    if not isinstance(found, Variable):
        return None
    try:
        value = nested_field(found.value, way)
    except EvaluationError:
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


def listed(site: BlockContext, *names: str) -> list[str]:
    """A setting for each dimension, separated by commas or quoted; the first that the file states."""
    written = next((text for name in names if (text := site.text(name, ""))), "")
    quoted = re.findall(r"'([^']*)'", written)
    return quoted or [part.strip() for part in split_arguments(written) if part.strip()]


def selected_indices(
    site: BlockContext, option: str, text: str, size: int, axis: int, count: int | None = None
) -> list[int]:
    """The places along a dimension of some size, counted from 0.

    From a starting index there are as many as `count`, or as the file says.
    """
    if option == "Select all":
        return list(range(size))
    if option not in ("Index vector (dialog)", "Starting index (dialog)"):
        raise UnsupportedError(f"it selects by {option!r}, which is not supported")
    first = 0 if site.text("IndexMode").startswith("Zero") else 1
    places = [int(n) - first for n in site.evaluated(text).ravel()]
    if option == "Starting index (dialog)" and places:
        length = length_of(site, axis) if count is None else count
        places = list(range(places[0], places[0] + min(length, size + 1)))
    elif places == [-1 - first]:
        return list(range(size))
    within(places, size, text)
    return places


def length_of(site: BlockContext, axis: int) -> int:
    """How many elements the file says to take along a dimension."""
    sizes = listed(site, "OutputSizes", "OutputSizeArray")
    return int(site.evaluated(sizes[axis]).item()) if axis < len(sizes) else 1


def within(places: list[int], size: int, text: str) -> None:
    """Raise `UnsupportedError` where a place is none of an array's."""
    if not places or not all(0 <= place < size for place in places):
        raise UnsupportedError(f"it selects {text[:60]} of {size} elements")


def case_values(site: BlockContext, field: str) -> list[list[float]]:
    """The numbers in each part of a list in braces, `{1, [2 3], Gear.First}`."""
    text = site.text(field)
    try:
        tree = parse_expression(text)
    except InputError:
        tree = m.Number(0.0)
    if not isinstance(tree, m.CellArray):
        raise UnsupportedError(f"{field} is {text[:60]}, not a list of cases in braces")
    parts = [part for row in tree.rows for part in row]
    try:
        found = [site.compiler.expressions.tree_numbers(one, site.atom.scope).ravel().tolist() for one in parts]
    except EvaluationError as error:
        raise UnsupportedError(f"its {field} ({text[:60]}) has no value: {error}", undefined=error.undefined) from None
    if sum(map(len, found)) > _MOST_NUMBERS:
        raise UnsupportedError(f"{field} has {sum(map(len, found))} numbers; {_MOST_NUMBERS} are the most")
    if not all(found):
        raise UnsupportedError(f"{field} is {text[:60]}, which has an empty part")
    return found
