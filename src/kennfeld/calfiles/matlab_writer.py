"""Parameters as MATLAB: a script that reads like one written by hand, or a data file with the same variables.

Parameters as MATLAB variables, for scripts (.m) and data files (.mat) alike: what `matlab_values` reads.
"""

import re
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings, WriteResult
from kennfeld.calfiles.matlab_parameters import INFO, StructValue, Value
from kennfeld.calfiles.matlab_reader import TITLE, comment_of
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter, Text

__all__ = []

_LETTERS = "xyzw"

_WORDS = "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return"
_TAKEN = frozenset(f"{_WORDS} spmd switch try while {INFO} Inf NaN reshape char ans".split())
_LONGEST = 63

_HEAD = f"""{TITLE}
% A number or a matrix is a parameter. A struct with x, y and values is a curve or a map: values have a row for each x.
"""
_MAT_TITLE = b"MATLAB 5.0 MAT-file, written by Kennfeld".ljust(116)
_UNFIT = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def variables_of(parameters: ParameterSet) -> Iterator[tuple[str, Value]]:
    """A variable for each group axis, parameter and text; `kennfeld_info` says more about those that are plain."""
    names = _Names()
    for axis in parameters.axes:
        name, called = names.of(axis.name)
        said = {"kind": "axis", "name": called, "x_unit": axis.unit, "x_input": axis.input}
        yield name, StructValue({**_given(said), "x": axis.breakpoints})
    info: dict[str, Value] = {}
    for thing in (*parameters.chosen, *parameters.others):
        name, called = names.of(thing.name)
        labels = _labels_of(thing)
        value = _plain_value(thing)
        if value is None or called or thing.variant:
            yield name, _struct_of(thing, {"name": called, **labels})
        else:
            yield name, value
            if labels:
                info[name] = StructValue(labels)
    if info:
        yield INFO, StructValue(info)


class _Names:
    """Names that MATLAB can have, each once."""

    def __init__(self) -> None:
        self.used = set(_TAKEN)

    def of(self, wanted: str) -> tuple[str, str]:
        """The name of a variable, and what it is called truly where that is something else."""
        if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", wanted) and len(wanted) <= _LONGEST and wanted not in self.used:
            self.used.add(wanted)
            return wanted, ""
        plain = re.sub(r"[^A-Za-z0-9_]", "_", wanted)[: _LONGEST - 8]
        plain = plain if re.match(r"[A-Za-z]", plain) else f"p{plain}"
        made, count = plain, 1
        while made in self.used:
            count += 1
            made = f"{plain}_{count}"
        self.used.add(made)
        return made, wanted


def _given(said: Mapping[str, str]) -> dict[str, Value]:
    return {key: word for key, word in said.items() if word}


def _labels_of(thing: Parameter | Text) -> dict[str, Value]:
    kind = thing.kind if isinstance(thing, Text) and thing.kind != "text" else ""
    words = {
        "unit": thing.unit,
        "kind": kind,
        "description": thing.description,
        "display_name": thing.display_name,
        "variant": thing.variant,
    }
    functions: dict[str, Value] = {"functions": list(thing.functions)} if thing.functions else {}
    return _given(words) | functions


def _plain_value(thing: Parameter | Text) -> "Value | None":
    """What a variable without fields can say; None where it takes a struct."""
    if isinstance(thing, Text):
        return thing.text
    shape = thing.values.shape
    if thing.axes or (
        thing.kind == "block" and (thing.size == 1 or (len(shape) > 1 and (1 in shape[:2] or shape[-1] == 1)))
    ):
        return None
    return thing.values


def _struct_of(thing: Parameter | Text, labels: dict[str, Value]) -> StructValue:
    fields = {key: label for key, label in labels.items() if label}
    if isinstance(thing, Text):
        return StructValue({**fields, "text": thing.text})
    for letter, axis in zip(_LETTERS, thing.axes, strict=False):
        fields[letter] = axis.breakpoints
        said = {f"{letter}_name": axis.name, f"{letter}_unit": axis.unit, f"{letter}_input": axis.input}
        fields |= _given(said)
    if thing.kind == "block":
        fields["size"] = np.array(thing.values.shape, dtype=np.float64)
    return StructValue({**fields, "value" if thing.kind == "scalar" else "values": thing.values})


def write_script(parameters: ParameterSet, file: str) -> str:
    """The text of a .m script.

    Numbers read back exactly; bounds, locks and extrapolation have no place. A name that MATLAB cannot have becomes a
    similar one, with the true name in the field `name`. Raises `InputError` naming every parameter that is no table.
    """
    _refuse(parameters, file)
    variables = dict(variables_of(parameters))
    info = variables.pop(INFO, StructValue())
    said = info.fields if isinstance(info, StructValue) else {}
    groups = {axis.name: name for axis, name in zip(parameters.axes, variables, strict=False)}
    parts = [_HEAD]
    for name, value in variables.items():
        parts.append(_assigned(name, value, said, groups))
    if said:
        parts.append("\n" + "".join(_fields(INFO, StructValue(said))))
    return "".join(parts)


def _assigned(name: str, value: Value, said: dict[str, Value], groups: dict[str, str]) -> str:
    """The lines that assign a variable; unit and description of a plain one stand in a comment where they can."""
    if isinstance(value, StructValue):
        return "\n" + "".join(_fields(name, _referring(value, groups)))
    labels = said.get(name)
    comment = ""
    if isinstance(labels, StructValue):
        unit, description = (str(labels.fields.get(key, "")) for key in ("unit", "description"))
        made = comment_of(unit, description)
        if made:
            comment = f" % {made}"
            kept = {key: word for key, word in labels.fields.items() if key not in ("unit", "description")}
            said.pop(name)
            said.update({name: StructValue(kept)} if kept else {})
    return f"{name} = {_expression(value)};{comment}\n"


class _Reference(str):
    """The name of the variable that holds a value."""

    __slots__ = ()


def _referring(struct: StructValue, groups: dict[str, str]) -> StructValue:
    """A table whose group axes are those of the variables that hold them: they are changed once."""
    fields = dict(struct.fields)
    for letter in "xyzw":
        group = fields.get(f"{letter}_name")
        if isinstance(group, str) and group in groups:
            fields[letter] = _Reference(f"{groups[group]}.x")
    return StructValue(fields)


def _fields(name: str, struct: StructValue) -> Iterator[str]:
    for key, value in struct.fields.items():
        if isinstance(value, StructValue):
            yield from _fields(f"{name}.{key}", value)
        else:
            yield f"{name}.{key} = {_expression(value)};\n"


def _expression(value: Value) -> str:
    if isinstance(value, _Reference):
        return str(value)
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, np.ndarray):
        return _numbers(value)
    assert isinstance(value, list)
    return "{" + ", ".join(map(_quoted, value)) + "}"


def _quoted(text: str) -> str:
    if _UNFIT.search(text):
        return f"char([{' '.join(str(ord(character)) for character in text)}])"
    return "'" + text.replace("'", "''") + "'"


def _numbers(values: Float) -> str:
    if values.ndim == 0:
        return _number(values.item())
    if values.ndim == 1:
        return f"[{_row(values)}]"
    if values.ndim == 2:
        return "[\n" + "".join(f"   {_row(row)}\n" for row in values) + "]"
    pages = " ...\n   ".join(_row(column) for column in values.reshape(values.shape[0], -1, order="F").T)
    return f"reshape([{pages}], [{' '.join(map(str, values.shape))}])"


def _row(values: Float) -> str:
    return " ".join(map(_number, values.tolist()))


def _number(number: float) -> str:
    if number != number:
        return "NaN"
    if number in (np.inf, -np.inf):
        return "Inf" if number > 0 else "-Inf"
    return repr(number).removesuffix(".0")


def write_mat(parameters: ParameterSet, file: str) -> WriteResult:
    """A set as a data file of MATLAB, version 5, with the variables of the script.

    What a comment says there stands in the struct `kennfeld_info`. Raises `InputError` as `write_script` does.
    """
    from scipy.io import savemat

    _refuse(parameters, file)
    stream = BytesIO()
    variables = {name: _plain(value) for name, value in variables_of(parameters)}
    savemat(stream, variables, long_field_names=True, do_compression=True, oned_as="row")
    # The text at its beginning states a date; the same set shall give the same bytes.
    return WriteResult(_MAT_TITLE + stream.getvalue()[len(_MAT_TITLE) :])


def _plain(value: Value) -> Any:
    if isinstance(value, StructValue):
        return {key: _plain(inner) for key, inner in value.fields.items()}
    if isinstance(value, list):
        made = np.empty(len(value), dtype=object)
        made[:] = value
        return made
    return value


def _refuse(parameters: ParameterSet, file: str) -> None:
    notes, seen = Findings(file), set[str]()
    for name in [*parameters, *(text.name for text in parameters.texts), *(axis.name for axis in parameters.axes)]:
        if name in seen:
            notes.error(0, name, "is given twice; parameters, texts and group axes share their names", "Rename one.")
        if not name:
            notes.error(0, name, "a parameter without a name has no place in MATLAB", "Name it.")
        seen.add(name)
    for thing in (*parameters.parameters, *parameters.others):
        if thing.kind == "rbf" or (thing.kind == "block" and not getattr(thing, "size", 1)):
            message = "an expansion in radial basis functions" if thing.kind == "rbf" else "a block without values"
            notes.error(0, thing.name, f"{message} has no place in MATLAB files", "Write it as .json.")
    notes.settle()
