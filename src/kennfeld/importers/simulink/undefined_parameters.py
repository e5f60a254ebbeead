"""Parameters that the user must define, with what the blocks that use them tell about their size."""

from collections.abc import Collection, Iterator, Mapping

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.lowering.registry import field_text
from kennfeld.importers.simulink.variables.mask_scope import MaskVariable, Scope
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.quantities import UndefinedParameter
from kennfeld.program.traversal import dotted_name

# breakpoint fields of the tables in a block, by the field of the table
_AXES: Mapping[tuple[str, str], tuple[str, ...]] = {
    ("Lookup_n-D", "Table"): tuple(f"BreakpointsForDimension{at}" for at in range(1, 5)),
    ("Lookup", "Table"): ("InputValues",),
    ("Lookup", "OutputValues"): ("InputValues",),
    ("Lookup2D", "Table"): ("RowIndex", "ColumnIndex"),
}
_SCALARS = frozenset(
    {"Threshold", "Bias", "OnSwitchValue", "OffSwitchValue", "SampleTime", "DelayLength", "DelayTime", "Frequency"}
)
_MAX_FIELDS = 4
_MAX_LINKS = 50  # of masks within masks


def undefined_parameters(
    failed: Collection[FlatBlock],
    expressions: ParameterExpressions,
    paths: Mapping[str, Collection[str]],
    reasons: Mapping[str, str],
) -> tuple[UndefinedParameter, ...]:
    """Return the undefined variables of a model.

    Args:
        failed: the unsupported blocks.
        expressions: the evaluator of their fields.
        paths: the paths of the blocks that use each variable.
        reasons: by variable, why scripts could not assign it a value.
    """
    blocks = {flat.path: flat for flat in failed}
    parameters = []
    for name, users in paths.items():
        fields = [
            (blocks[path], key) for path in users if path in blocks for key in _fields(blocks[path], expressions, name)
        ]
        sizes = (_shape(flat, key, expressions, name) for flat, key in fields)
        shape = next((size for size in sizes if size is not None), None)
        labels = dict.fromkeys(f"{flat.path}:{key}" for flat, key in fields)
        parameters.append(
            UndefinedParameter(
                name, shape, tuple(labels)[:_MAX_FIELDS] or tuple(users)[:_MAX_FIELDS], _reason(name, reasons)
            )
        )
    return tuple(parameters)


def _reason(name: str, reasons: Mapping[str, str]) -> str:
    """Return why a variable or one of the structs around it has no value."""
    names = name.split(".")
    candidates = (".".join(names[:count]) for count in range(len(names), 0, -1))
    return next((reasons[candidate] for candidate in candidates if candidate in reasons), "")


def _fields(flat: FlatBlock, expressions: ParameterExpressions, name: str) -> Iterator[str]:
    """Yield the fields of a block that have no value because a variable is undefined."""
    for key, text in flat.block.parameters.items():
        try:
            expressions.evaluate(text, flat.scope, False)
        except EvaluationError as error:
            if error.undefined == name:
                yield key


def _shape(flat: FlatBlock, field: str, expressions: ParameterExpressions, name: str) -> tuple[int, ...] | None:
    """Return the shape that a block requires of a variable in a field, None if it is unknown."""
    if not _is_only(flat.block.parameters[field], flat.scope, name):
        return None
    if field in _SCALARS:
        return ()
    for (kind, table), axes in _AXES.items():
        if flat.type == kind and field == table:
            return _sizes(flat, axes[: _dimensions(flat, axes)], expressions)
        if flat.type == kind and field in axes:
            shape = _table_shape(flat, table, expressions)
            at = axes.index(field)
            return shape[at : at + 1] if shape is not None and at < len(shape) else None
    return None


def _dimensions(flat: FlatBlock, axes: tuple[str, ...]) -> int:
    written = (field_text(flat, "NumberOfTableDimensions") or "").strip()
    return min(int(written), len(axes)) if written.isdigit() else len(axes)


def _sizes(flat: FlatBlock, axes: Collection[str], expressions: ParameterExpressions) -> tuple[int, ...] | None:
    """Return the number of breakpoints of each axis, None if one is unknown."""
    sizes = []
    for axis in axes:
        try:
            sizes.append(expressions.numbers(field_text(flat, axis) or "", flat.scope).size)
        except EvaluationError:
            return None
    return tuple(sizes)


def _table_shape(flat: FlatBlock, table: str, expressions: ParameterExpressions) -> tuple[int, ...] | None:
    try:
        numbers = expressions.numbers(field_text(flat, table) or "", flat.scope)
    except EvaluationError:
        return None
    return (numbers.size,) if 1 in numbers.shape else numbers.shape


def _is_only(text: str, scope: Scope, name: str, depth: int = 0) -> bool:
    """Return True if an expression is only a variable, also through masks."""
    try:
        path = dotted_name(parse_expression(text))
    except InputError:
        return False
    variable = scope.find(path.partition(".")[0]) if path else None
    if isinstance(variable, MaskVariable) and depth < _MAX_LINKS:
        rest = path.partition(".")[2]
        inner = f"{variable.text.strip()}.{rest}" if rest else variable.text
        return variable.evaluated and _is_only(inner, variable.outside, name, depth + 1)
    return path == name
