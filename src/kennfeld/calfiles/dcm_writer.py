"""Parameters as DCM 2.0 text, laid out as INCA does; numbers in their shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Notes, holds_control_characters, one_line
from kennfeld.parameters import Axis, Block, Parameter, ParameterSet, Text

__all__ = ["write_dcm"]

_HEADER = """* encoding="UTF-8"
* DAMOS format
* Created by Kennfeld

KONSERVIERUNG_FORMAT 2.0
"""
_A_LINE = 6  # numbers a line, as INCA writes them
_NAME = re.compile(r'[^\s"*!.][^\s"]*')
_KEYWORDS = {"scalar": "FESTWERT", "block": "FESTWERTEBLOCK", "curve": "KENNLINIE", "map": "KENNFELD"}
_LETTERS = ("X", "Y")


def write_dcm(parameters: ParameterSet, file: str) -> str:
    """The text of a DCM 2.0 file.

    A table with a group axis becomes a GRUPPENKENNLINIE or GRUPPENKENNFELD, and each group axis is written once.
    Bounds, locks, axis inputs and extrapolation have no place in DCM. Raises `InputError` naming every parameter
    that DCM cannot hold: cubes, blocks of more than two dimensions, values that are not finite.
    """
    _refuse(parameters, file)
    blocks = [*map(_text_block, parameters.texts), *map(_parameter_block, parameters.parameters)]
    # An axis whose name has blanks cannot head a block; its tables carry it.
    blocks += [_axis_block(axis) for axis in parameters.axes if _NAME.fullmatch(axis.name)]
    return "\n".join([_HEADER, *blocks])


def _refuse(parameters: ParameterSet, file: str) -> None:
    notes = Notes(file)
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    for name in _repeated([*parameters, *(text.name for text in parameters.texts)]):
        notes.error(0, name, "is given twice", "Rename one of the two.")
    for member in parameters.parameters:
        for what, mend in _faults(member):
            notes.error(0, member.name, what, mend)
    for text in parameters.texts:
        for what, mend in [*_name_faults(text.name), *_text_faults(text)]:
            notes.error(0, text.name, what, mend)
    for axis in parameters.axes:
        for what, mend in _axis_faults(axis, used):
            notes.error(0, axis.name, what, mend)
    notes.settle()


def _repeated(names: list[str]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []


def _faults(member: Parameter) -> Iterator[tuple[str, str]]:
    yield from _name_faults(member.name)
    if member.kind == "rbf":
        yield "DCM cannot hold an expansion in radial basis functions", "Write it as .json."
    elif member.kind not in _KEYWORDS or member.values.ndim > 2:
        yield f"DCM cannot hold a {member.kind} of {member.values.ndim} dimensions", "Write it as .json."
    elif member.size == 0:
        yield "DCM cannot hold a block without values", "Write it as .json."
    elif not np.isfinite(member.values).all():
        yield "DCM cannot hold values that are not finite", "Give it values, or write it as .json."


def _name_faults(name: str) -> Iterator[tuple[str, str]]:
    if not _NAME.fullmatch(name) or holds_control_characters(name):
        yield f"{name!r} cannot be a name in DCM: it must be one word without quotes", "Rename it."


def _text_faults(text: Text) -> Iterator[tuple[str, str]]:
    if holds_control_characters(text.text):
        yield "DCM cannot hold a text with line breaks or control characters", "Write it as .json."


def _axis_faults(axis: Axis, used: set[str]) -> Iterator[tuple[str, str]]:
    if axis.name not in used:
        yield from _name_faults(axis.name)
    elif axis.name != axis.name.strip() or holds_control_characters(axis.name):
        yield f"{axis.name!r} cannot be the name of a group axis in DCM: blanks around it are lost", "Rename it."


def _parameter_block(member: Parameter) -> str:
    group = "GRUPPEN" if any(axis.name for axis in member.axes) else ""
    sizes = " @ ".join(map(str, member.values.shape)) if isinstance(member, Block) else _sizes(member.axes)
    lines = [f"{group}{_KEYWORDS[member.kind]} {member.name} {sizes}".rstrip()]
    lines.append(f"   LANGNAME {_quoted(member.description)}")
    lines += [f"   EINHEIT_{letter} {_quoted(axis.unit)}" for letter, axis in _directions(member)]
    lines.append(f"   EINHEIT_W {_quoted(member.unit)}")
    lines += [f"*SST{letter}\t{axis.name}" for letter, axis in _directions(member) if axis.name]
    lines += _numbers_of(member)
    return "\n".join([*lines, "END", ""])


def _numbers_of(member: Parameter) -> Iterator[str]:
    if member.axes:
        yield from _numbers("ST/X", member.axes[0].breakpoints)
    if len(member.axes) < 2:
        # One row a line group for a two-dimensional block, so that a reader sees its shape.
        for row in np.atleast_2d(member.values.T):
            yield from _numbers("WERT", row)
        return
    for point, row in zip(member.axes[1].breakpoints, member.values.T, strict=True):
        yield f"   ST/Y   {float(point)!r}"
        yield from _numbers("WERT", row)


def _numbers(keyword: str, values: Float) -> Iterator[str]:
    words = [repr(value) for value in values.tolist()]
    for start in range(0, len(words), _A_LINE):
        yield f"   {keyword}   {'   '.join(words[start : start + _A_LINE])}"


def _text_block(text: Text) -> str:
    lines = [f"TEXTSTRING {text.name}", f"   LANGNAME {_quoted(text.description)}", f"   TEXT {_quoted(text.text)}"]
    return "\n".join([*lines, "END", ""])


def _axis_block(axis: Axis) -> str:
    lines = [f"STUETZSTELLENVERTEILUNG {axis.name} {len(axis)}", "*SST", '   LANGNAME ""']
    lines += [f"   EINHEIT_X {_quoted(axis.unit)}", *_numbers("ST/X", axis.breakpoints)]
    return "\n".join([*lines, "END", ""])


def _directions(member: Parameter) -> Iterable[tuple[str, Axis]]:
    return zip(_LETTERS, member.axes, strict=False)


def _sizes(axes: tuple[Axis, ...]) -> str:
    return " ".join(str(len(axis)) for axis in axes)


def _quoted(text: str) -> str:
    escaped = one_line(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
