"""Block fields that are one parameter as a whole, and index option fields."""

import re
from dataclasses import replace

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.lowering.block_context import BlockContext
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError, evaluating
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import split_arguments
from kennfeld.importers.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    Scope,
    Variable,
    nested_field,
    split_index,
)
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.program import tree as m
from kennfeld.program.traversal import element_path

_MAX_NUMBERS = 10_000
_INDEX_OPTIONS = (
    "Select all", "Assign all", "Index vector (dialog)", "Index vector (port)", "Starting index (dialog)",
    "Starting index (port)", "Starting and ending indices (port)",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class ParameterField:
    """Numbers of a field, with the name of the variable or "Path:Field" for a literal."""

    name: str
    values: Numbers
    variable: Variable
    is_variable: bool


def parameter_field(block: BlockContext, field: str) -> ParameterField:
    """Find the parameter of a field.

    If the field is only a variable, through masks or struct fields, the parameter has its name. A transposed matrix
    gets the name with a trailing quote.
    """
    text = block.field_text(field)
    values = block.numeric_array(field)
    match = _variable(text, block.flat.scope)
    if match is None:
        literal = Variable(values, source=_source(text, block.flat.scope))
        return ParameterField(f"{block.flat.path}:{field}", values, literal, False)
    name, variable, transposed = match
    if not transposed:
        return ParameterField(name, values, variable, True)
    matrix, lower, upper = (np.transpose(np.asarray(x)) for x in (variable.value, variable.lower, variable.upper))
    swapped = replace(variable, value=matrix, axes=variable.axes[::-1], lower=lower, upper=upper)
    return ParameterField(f"{name}'", values, swapped, True)


def _source(text: str, scope: Scope) -> str:
    """Return the origin of a field's numbers: an expression of variables, or the field."""
    if any(scope.find(name) is not None for name in re.findall(r"[^\W\d]\w*", text)):
        return f"{' '.join(text.split())[:40]} of the block"
    return "a literal of the block"


def variable_field(block: BlockContext, text: str) -> ParameterField:
    """Find the parameter of an expression that is only a variable, as `parameter_field` does."""
    if (field := _numeric_variable(block, text)) is None:
        raise UnsupportedError(f"{text[:80]} is not a numeric variable")
    return field


def calibrated_table(block: BlockContext, text: str) -> ParameterField | None:
    """Find the table that a calibration file gives in place of a table object, None if there is none."""
    field = _numeric_variable(block, text)
    return field if field is not None and field.variable.axes else None


def text_variable(block: BlockContext, text: str) -> str:
    """Return the text that an expression holds which is only a variable, "" if it holds none."""
    match = _variable(text, block.flat.scope)
    return match[1].value if match is not None and isinstance(match[1].value, str) else ""


def _numeric_variable(block: BlockContext, text: str) -> ParameterField | None:
    match = _variable(text, block.flat.scope)
    if match is None or match[2] or not isinstance(match[1].value, np.ndarray):
        return None
    return ParameterField(match[0], match[1].value, match[1], True)


def _variable(text: str, scope: Scope, deep: int = 0) -> tuple[str, Variable, bool] | None:
    """Return variable, name and transposition if an expression is only a variable, else None."""
    try:
        bare, turned = _strip_casts(parse_expression(text))
    except InputError:
        return None
    path = element_path(bare)
    # a mask parameter may refer to itself through further masks
    if path is None or deep > 50:
        return None
    meaning = scope.find(split_index(path[0])[0])
    if isinstance(meaning, MaskVariable):
        index = path[0].removeprefix(split_index(path[0])[0])
        inner = ".".join([f"{meaning.text.strip()}{index}", *path[1:]])
        further = _variable(inner, meaning.outside, deep + 1) if meaning.evaluated else None
        if further is None:
            return None
        name, variable, transposed = further
        # two transposes cancel out, and a vector is the same table either way
        return name, variable, _is_matrix(variable) and turned != transposed
    meant = _resolve_path(meaning, path, scope)
    return (".".join(path), meant, turned and _is_matrix(meant)) if meant is not None else None


def _resolve_path(variable: MaskCodeVariable | Variable | None, path: list[str], scope: Scope) -> Variable | None:
    if (part := scope.part(path)) is not None:
        return part
    if not isinstance(variable, Variable):
        return None
    try:
        value = nested_field(variable.value, path)
    except EvaluationError:
        return None
    if path[1:] == ["Table"]:  # limits and unit of a table object belong to its table
        return replace(variable, value=value)
    return variable if len(path) == 1 else Variable(value, source=variable.source)


def _is_matrix(variable: Variable) -> bool:
    return isinstance(variable.value, np.ndarray) and variable.value.ndim == 2 and 1 not in variable.value.shape


def _strip_casts(tree: m.Expression) -> tuple[m.Expression, bool]:
    """Return an expression without transposes, casts and `x(:)`, and whether it is transposed."""
    turned = False
    while True:
        if isinstance(tree, m.Transpose):
            tree, turned = tree.operand, not turned
        # x(:) is a column, whether x was transposed or not
        elif isinstance(tree, m.Call) and tree.arguments == (m.Colon(),):
            tree, turned = tree.of, False
        elif isinstance(tree, m.Call) and tree.of in (m.Name("single"), m.Name("double")) and len(tree.arguments) == 1:
            tree = tree.arguments[0]
        else:
            return tree, turned


def dimension_settings(block: BlockContext, *names: str) -> list[str]:
    """Read the setting of each dimension from the first of the fields that the file contains."""
    written = next((text for name in names if (text := block.field_text(name, ""))), "")
    quoted = re.findall(r"'([^']*)'", written)
    return quoted or [part.strip() for part in split_arguments(written) if part.strip()]


def index_options(block: BlockContext) -> list[str]:
    """Read the index option of each dimension, [] if the file has none, as in releases before R2009."""
    written = dimension_settings(block, "IndexOptions", "IndexOptionArray")
    return [match_word(option, _INDEX_OPTIONS) or option for option in written]


def first_index(block: BlockContext) -> int:
    """Return the number of the first element, 0 or 1."""
    return 0 if block.begins_with("IndexMode", "Zero") else 1


def selected_indices(
    block: BlockContext, option: str, text: str, size: int, axis: int, count: int | None = None, note: str = ""
) -> list[int]:
    """Evaluate constant indices along a dimension of `size` elements, from 0.

    A starting index covers `count` elements, or as many as the file specifies; `note` ends a message on the size.
    """
    if option == "Select all":
        return list(range(size))
    if option not in ("Index vector (dialog)", "Starting index (dialog)"):
        raise UnsupportedError(f"the index option {option!r} is not supported")
    first = first_index(block)
    places = [int(n) - first for n in block.evaluate(text).ravel()]
    if option == "Starting index (dialog)" and places:
        length = selection_length(block, axis) if count is None else count
        # one more than fits is enough to be refused; the length itself may be huge
        places = list(range(places[0], places[0] + min(length, size + 1)))
    # -1 in older files selects all elements
    elif places == [-1 - first]:
        return list(range(size))
    check_indices(places, size, text, note)
    return places


def selection_length(block: BlockContext, axis: int) -> int:
    """Return the number of elements to select along a dimension."""
    sizes = dimension_settings(block, "OutputSizes", "OutputSizeArray")
    return int(block.evaluate(sizes[axis]).item()) if axis < len(sizes) else 1


def check_indices(places: list[int], size: int, text: str, note: str = "") -> None:
    """Raise `UnsupportedError` if an index is out of range."""
    if not places or not all(0 <= place < size for place in places):
        raise UnsupportedError(f"its index {text[:60]} is out of range for {count_noun(size, 'element')}{note}")


def case_values(block: BlockContext, field: str) -> list[list[float]]:
    """Evaluate the numbers in each part of a list in braces, `{1, [2 3], Gear.First}`."""
    text = block.field_text(field)
    try:
        tree = parse_expression(text)
    except InputError:
        tree = m.Number(0.0)
    if not isinstance(tree, m.CellArray):
        raise UnsupportedError(f"{field} must be a list of cases in braces, got {text[:60]}")
    parts = [part for row in tree.rows for part in row]
    with evaluating(f"its {field} ({text[:60]}) has no value"):
        cases = [block.compiler.expressions.tree_numbers(case, block.flat.scope).ravel().tolist() for case in parts]
    if (count := sum(map(len, cases))) > _MAX_NUMBERS:
        raise UnsupportedError(f"{field} has {count} numbers; at most {_MAX_NUMBERS} are supported")
    if not all(cases):
        raise UnsupportedError(f"{field} {text[:60]} has an empty case")
    return cases
