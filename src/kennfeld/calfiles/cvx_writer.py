"""Parameters as CVX 2.1 text with comma and decimal point; numbers in their shortest form that reads back exactly."""

import re
from collections.abc import Iterator

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Notes, holds_control_characters, one_line
from kennfeld.parameters import Axis, Parameter, ParameterSet

__all__ = ["write_cvx"]

_NAME = re.compile(r'[^\s",:*][^",]*')


def write_cvx(parameters: ParameterSet, file: str) -> str:
    """The text of a CVX file with comma and decimal point.

    Descriptions, bounds, locks, axis inputs and extrapolation have no place in CVX. Raises `InputError` naming
    every parameter that CVX cannot hold: cubes, blocks of more than two dimensions, values that are not finite.
    """
    _refuse(parameters, file)
    records = ['CALIBRATION VALUES V2.1,.,*,"",\n']
    records += [_record(text.name, f"ASCII,,{_quoted(text.text)}") for text in parameters.texts]
    for member in parameters.parameters:
        records += _member_records(member)
    records += [_axis_record(axis.name, "AXIS_PTS", axis) for axis in parameters.axes]
    return "\n".join(records).replace("\n", "\r\n")


def _member_records(member: Parameter) -> Iterator[str]:
    names = ",".join(axis.name for axis in member.axes).rstrip(",")
    if member.kind == "scalar":
        yield _record(member.name, f"VALUE,{_unit(member.unit)},{_joined(member.values.reshape(1))}")
    elif member.kind == "block":
        first, *others = np.atleast_2d(member.values.T)
        rows = [f",,{_joined(row)}" for row in others]
        yield _record(member.name, f"VAL_BLK,{_unit(member.unit)},{_joined(first)}", *rows)
    else:
        first, *others = np.atleast_2d(member.values.T)
        rows = [f"{_unit(member.unit)},,{_joined(first)}", *(f",,{_joined(row)}" for row in others)]
        # The line after MAP is that of embedded breakpoints, which INCA leaves empty and every reader skips.
        head = [f"MAP,{names}", ""] if member.kind == "map" else [f"CURVE,{names}".rstrip(",")]
        yield _record(member.name, *head, *rows)
    for letter, axis in zip("XY", member.axes, strict=False):
        if not axis.name:
            yield _axis_record(member.name, f"{letter}_AXIS_PTS", axis)


def _axis_record(name: str, kind: str, axis: Axis) -> str:
    return _record(name, f"{kind},{_unit(axis.unit)},{_joined(axis.breakpoints)}")


def _record(name: str, *lines: str) -> str:
    return "\n".join([f",{name}", *lines, ""])


def _joined(values: Float) -> str:
    return ",".join(map(repr, values.tolist()))


def _unit(unit: str) -> str:
    return f":{_quoted(unit)}:" if unit else ""


def _quoted(text: str) -> str:
    return '"' + one_line(text).replace('"', '""') + '"'


def _refuse(parameters: ParameterSet, file: str) -> None:
    notes, seen = Notes(file), set[str]()
    for name in [*parameters, *(text.name for text in parameters.texts)]:
        if name in seen:
            notes.error(0, name, "is given twice", "Rename one of the two.")
        seen.add(name)
    for name in [*parameters, *(text.name for text in parameters.texts), *(axis.name for axis in parameters.axes)]:
        if not _NAME.fullmatch(name) or holds_control_characters(name) or name != name.strip():
            notes.error(0, name, f"{name!r} cannot be a name in CVX: no commas and no quotes", "Rename it.")
    for member in parameters.parameters:
        for what in _faults(member):
            notes.error(0, member.name, what, "Write it as .json.")
    for text in parameters.texts:
        if holds_control_characters(text.text):
            notes.error(0, text.name, "CVX cannot hold a text with line breaks", "Write it as .json.")
    notes.settle()


def _faults(member: Parameter) -> Iterator[str]:
    if member.kind in ("cube", "rbf") or member.values.ndim > 2 or member.size == 0:
        yield f"CVX cannot hold {'an' if member.kind == 'rbf' else 'a'} {member.kind} of shape {member.values.shape}"
    elif not np.isfinite(member.values).all():
        yield "CVX cannot hold values that are not finite"
