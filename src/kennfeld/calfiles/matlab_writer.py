"""Writes parameters as a MATLAB script (.m) or data file (.mat) with the same variables."""

import re
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.calfiles.content import in_stored_order, stored_breakpoints
from kennfeld.calfiles.format import FileFindings, Item, WriteResult
from kennfeld.calfiles.matlab_parameters import INFO, StructValue, Value
from kennfeld.calfiles.matlab_reader import format_comment
from kennfeld.calfiles.storable import USE_JSON, report_repeated_variables
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import LABELS
from kennfeld.domain.texts import Text
from kennfeld.files.calibrations import SCRIPT_TITLE
from kennfeld.matlab.variable_names import KEYWORDS, variable_name

_RESERVED_NAMES = KEYWORDS | {INFO, "Inf", "NaN", "reshape", "char", "ans"}

_HEAD = f"""{SCRIPT_TITLE}
% A number or a matrix is a parameter. A struct with x, y and values is a curve or a map: values have a row for each x.
"""
_MAT_TITLE = b"MATLAB 5.0 MAT-file, written by Kennfeld".ljust(116)
_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def variables_of(parameters: ParameterSet) -> Iterator[tuple[str, Value]]:
    """Yield one variable per group axis, parameter and text; `kennfeld_info` has the attributes of plain ones."""
    used = set(_RESERVED_NAMES)
    for axis in parameters.axes:
        name, original = _variable_name(axis.name, used)
        own = {"kind": "axis", "name": original, "x_unit": axis.unit, "x_input": axis.input}
        yield name, StructValue({**_non_empty(own), "x": stored_breakpoints(axis)})
    info: dict[str, Value] = {}
    for item in (*parameters.chosen, *parameters.others):
        name, original = _variable_name(item.name, used)
        kind = item.kind if isinstance(item, Text) and item.kind != "text" else ""
        attributes = {label: getattr(item, label) for label in LABELS} | {"functions": list(item.functions)}
        labels = _non_empty({"unit": item.unit, "kind": kind, **attributes})
        value = _plain_value(item)
        if value is None or original or item.variant:
            yield name, _struct_of(item, _non_empty({"name": original}) | labels)
        else:
            yield name, value
            if labels:
                info[name] = StructValue(labels)
    if info:
        yield INFO, StructValue(info)


def _variable_name(name: str, used: set[str]) -> tuple[str, str]:
    """Return a valid name of a variable that is not used yet, and the true name if that differs."""
    result = variable_name(name, used, prefix="p")
    return result, "" if result == name else name


def _non_empty(labels: Mapping[str, Any]) -> dict[str, Value]:
    return {key: label for key, label in labels.items() if label}


def _plain_value(item: Item) -> Value | None:
    """Return the value of a variable without fields; None if it requires a struct."""
    if isinstance(item, Text):
        return item.text
    shape = item.values.shape
    # MATLAB drops trailing sizes of 1, and a single row or column is read as a vector
    drops_ones = len(shape) > 1 and (1 in shape[:2] or shape[-1] == 1)
    return None if item.axes or (item.kind == "block" and (item.size == 1 or drops_ones)) else item.values


def _struct_of(item: Item, labels: dict[str, Value]) -> StructValue:
    fields = dict(labels)
    if isinstance(item, Text):
        return StructValue({**fields, "text": item.text})
    values, points = in_stored_order(item)
    for letter, axis, numbers in zip(AXIS_LETTERS, item.axes, points, strict=False):
        fields[letter] = numbers
        fields |= _non_empty({f"{letter}_{key}": getattr(axis, key) for key in ("name", "unit", "input")})
    if item.kind == "block":
        fields["size"] = np.array(item.values.shape, dtype=np.float64)
    return StructValue({**fields, "value" if item.kind == "scalar" else "values": values})


def write_script(parameters: ParameterSet, file: str) -> str:
    """Return the text of a .m script.

    Numbers read back exactly; bounds, locks and extrapolation have no place. A name that MATLAB cannot have becomes a
    similar one, with the true name in the field `name`. Raises `InputError` naming every parameter that is no table.
    """
    _refuse(parameters, file)
    variables = dict(variables_of(parameters))
    struct = variables.pop(INFO, StructValue())
    info = struct.fields if isinstance(struct, StructValue) else {}
    # the group axes have the first variables, in their order
    groups = {axis.name: name for axis, name in zip(parameters.axes, variables, strict=False)}
    parts = [_HEAD]
    for name, value in variables.items():
        parts.append(_assignment(name, value, info, groups))
    if info:
        parts.append("\n" + "".join(_fields(INFO, StructValue(info))))
    return "".join(parts)


def _assignment(name: str, value: Value, info: dict[str, Value], groups: dict[str, str]) -> str:
    """Return the lines that assign a variable; a comment has unit and description of a plain one, if it can."""
    if isinstance(value, StructValue):
        return "\n" + "".join(_fields(name, _refer_to_groups(value, groups)))
    labels = info.get(name)
    comment = None
    if isinstance(labels, StructValue):
        unit, description = (str(labels.fields.get(key, "")) for key in ("unit", "description"))
        comment = format_comment(unit, description)
        if comment:
            del info[name]
            others = {key: word for key, word in labels.fields.items() if key not in ("unit", "description")}
            info |= {name: StructValue(others)} if others else {}
    return f"{name} = {_format_value(value)};{f' % {comment}' if comment else ''}\n"


class _Reference(str):
    """The name of the variable that holds a value."""

    __slots__ = ()


def _refer_to_groups(struct: StructValue, groups: dict[str, str]) -> StructValue:
    """Return a table that refers to the variables of its group axes, so that they are changed in one place."""
    fields = dict(struct.fields)
    for letter in AXIS_LETTERS:
        group = fields.get(f"{letter}_name")
        if isinstance(group, str) and group in groups:
            fields[letter] = _Reference(f"{groups[group]}.x")
    return StructValue(fields)


def _fields(name: str, struct: StructValue) -> Iterator[str]:
    for key, value in struct.fields.items():
        if isinstance(value, StructValue):
            yield from _fields(f"{name}.{key}", value)
        else:
            yield f"{name}.{key} = {_format_value(value)};\n"


def _format_value(value: Value) -> str:
    if isinstance(value, _Reference):
        return str(value)
    if isinstance(value, str):
        return _quote(value)
    if isinstance(value, np.ndarray):
        return _format_array(value)
    assert isinstance(value, list)
    return "{" + ", ".join(map(_quote, value)) + "}"


def _quote(text: str) -> str:
    if _UNPRINTABLE.search(text):
        return f"char([{' '.join(str(ord(character)) for character in text)}])"
    return "'" + text.replace("'", "''") + "'"


def _format_array(values: Float) -> str:
    if values.ndim == 0:
        return _format_number(values.item())
    if values.ndim == 1:
        return f"[{_format_row(values)}]"
    if values.ndim == 2:
        return "[\n" + "".join(f"   {_format_row(row)}\n" for row in values) + "]"
    # columns one after the other, as MATLAB stores arrays
    pages = " ...\n   ".join(_format_row(column) for column in values.reshape(values.shape[0], -1, order="F").T)
    return f"reshape([{pages}], [{' '.join(map(str, values.shape))}])"


def _format_row(values: Float) -> str:
    return " ".join(map(_format_number, values.tolist()))


def _format_number(number: float) -> str:
    if number != number:
        return "NaN"
    if number in (np.inf, -np.inf):
        return "Inf" if number > 0 else "-Inf"
    return repr(number).removesuffix(".0")


def write_mat(parameters: ParameterSet, file: str) -> WriteResult:
    """Return a set as a MATLAB data file, version 5, with the variables of the script.

    What a comment says there stands in the struct `kennfeld_info`. Raises `InputError` as `write_script` does.
    """
    from scipy.io import savemat

    _refuse(parameters, file)
    stream = BytesIO()
    variables = {name: _to_savemat(value) for name, value in variables_of(parameters)}
    savemat(stream, variables, long_field_names=True, do_compression=True, oned_as="row")
    # The text at its beginning states a date; the same set shall give the same bytes.
    return WriteResult(_MAT_TITLE + stream.getvalue()[len(_MAT_TITLE) :])


def _to_savemat(value: Value) -> Any:
    if isinstance(value, StructValue):
        return {key: _to_savemat(inner) for key, inner in value.fields.items()}
    if isinstance(value, list):
        # texts in a plain array would become a matrix of characters
        result = np.empty(len(value), dtype=object)
        result[:] = value
        return result
    return value


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings = FileFindings(file)
    if "" in report_repeated_variables(parameters, findings):
        findings.error(0, "", "a MATLAB variable needs a name", "Name the parameter.")
    for item in (*parameters.parameters, *parameters.others):
        if item.kind == "rbf" or (item.kind == "block" and not getattr(item, "size", 1)):
            message = "a radial basis function expansion" if item.kind == "rbf" else "a block without values"
            findings.error(0, item.name, f"MATLAB files cannot store {message}", USE_JSON)
    findings.finish()
