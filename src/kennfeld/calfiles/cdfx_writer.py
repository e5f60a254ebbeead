"""Parameters as CDFX 2.0, without variants; numbers in their shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator
from html import escape  # that of xml.sax loads half of urllib

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Notes, holds_control_characters, one_line
from kennfeld.parameters import Axis, Parameter, ParameterSet, Text

__all__ = ["write_cdfx"]

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE MSRSW PUBLIC "-//ASAM//DTD CALIBRATION DATA FORMAT:V2.0.0:LAI:IAI:XML:CDF200.XSD//EN" "cdf_v2.0.0.sl.dtd">
<MSRSW>
<SHORT-NAME>{name}</SHORT-NAME>
<CATEGORY>CDF20</CATEGORY>
<SW-SYSTEMS>
<SW-SYSTEM>
<SHORT-NAME>information-not-available</SHORT-NAME>
<SW-INSTANCE-SPEC>
<SW-INSTANCE-TREE>
<SHORT-NAME>{name}</SHORT-NAME>
<CATEGORY>NO_VCD</CATEGORY>
"""
_FOOT = """</SW-INSTANCE-TREE>
</SW-INSTANCE-SPEC>
</SW-SYSTEM>
</SW-SYSTEMS>
</MSRSW>
"""
_CATEGORIES = {"scalar": "VALUE", "block": "VAL_BLK", "curve": "CURVE", "map": "MAP"}
_UNFIT = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")  # what XML 1.0 cannot hold
_OTHER = re.compile(r"[\ufffe\uffff]")


def write_cdfx(parameters: ParameterSet, file: str) -> str:
    """The text of a CDFX 2.0 file.

    A group axis becomes a COM_AXIS, to which its tables refer; a cube a CUBOID, or a CUBE_4 as A2L calls it.
    Bounds, locks, axis inputs and extrapolation have no place in CDFX. Raises `InputError` naming every parameter
    that CDFX cannot hold: expansions, values that are not finite, one name for two things.
    """
    _refuse(parameters, file)
    name = _escaped(file.rpartition(".")[0] or file)
    instances = [*map(_text, parameters.texts), *map(_parameter, parameters.parameters)]
    instances += map(_group_axis, parameters.axes)
    return "".join([_HEAD.format(name=name), *instances, _FOOT])


def _refuse(parameters: ParameterSet, file: str) -> None:
    notes = Notes(file)
    names = [*parameters, *(text.name for text in parameters.texts), *(axis.name for axis in parameters.axes)]
    seen = set[str]()
    for name in names:
        if name in seen:
            notes.error(0, name, "is given twice; parameters, texts and group axes share their names", "Rename one.")
        seen.add(name)
        if not name.strip() or name != name.strip() or holds_control_characters(name) or _UNFIT.search(name):
            notes.error(0, name, f"{name!r} cannot be a name in CDFX: blanks around it or controls in it", "Rename it.")
    for member in parameters.parameters:
        for what in _faults(member):
            notes.error(0, member.name, what, "Write it as .json.")
    for text in parameters.texts:
        if _UNFIT.search(text.text):
            notes.error(0, text.name, "XML cannot hold a text with control characters", "Write it as .json.")
    notes.settle()


def _faults(member: Parameter) -> Iterator[str]:
    if member.kind == "rbf":
        yield "CDFX cannot hold an expansion in radial basis functions"
    elif member.size == 0:
        yield "CDFX cannot hold a block without values"
    elif not np.isfinite(member.values).all():
        yield "CDFX cannot hold values that are not finite"


def _text(text: Text) -> str:
    category = "BOOLEAN" if text.text in ("true", "false") else "ASCII"
    value = f"<SW-VALUES-PHYS><VT>{_escaped(text.text)}</VT></SW-VALUES-PHYS>"
    return _instance(text.name, text.description, category, _value_cont("", "", value))


def _parameter(member: Parameter) -> str:
    category = _CATEGORIES.get(member.kind) or ("CUBOID" if len(member.axes) == 3 else f"CUBE_{len(member.axes)}")
    size = _array_size(member.values.shape) if member.kind == "block" else ""
    contents = [_value_cont(member.unit, size, _values(member.values))]
    if member.axes:
        contents += ["<SW-AXIS-CONTS>\n", *map(_axis_cont, member.axes), "</SW-AXIS-CONTS>\n"]
    return _instance(member.name, member.description, category, *contents)


def _group_axis(axis: Axis) -> str:
    return _instance(axis.name, "", "COM_AXIS", _value_cont(axis.unit, "", _values(axis.breakpoints)))


def _axis_cont(axis: Axis) -> str:
    if axis.name:
        content = f"<SW-INSTANCE-REF>{_escaped(axis.name)}</SW-INSTANCE-REF>\n{_array_size((len(axis),))}"
    else:
        content = _values(axis.breakpoints) + "\n"
    category = "COM_AXIS" if axis.name else "STD_AXIS"
    head = f"<SW-AXIS-CONT>\n<CATEGORY>{category}</CATEGORY>\n{_unit(axis.unit)}"
    return f"{head}{content}</SW-AXIS-CONT>\n"


def _instance(name: str, description: str, category: str, *contents: str) -> str:
    return "".join(
        [
            "<SW-INSTANCE>\n",
            f"<SHORT-NAME>{_escaped(name)}</SHORT-NAME>\n",
            f"<LONG-NAME>{_line(description)}</LONG-NAME>\n",
            f"<CATEGORY>{category}</CATEGORY>\n",
            *contents,
            "</SW-INSTANCE>\n",
        ]
    )


def _value_cont(unit: str, size: str, values: str) -> str:
    return f"<SW-VALUE-CONT>\n{_unit(unit)}{size}{values}\n</SW-VALUE-CONT>\n"


def _array_size(shape: Iterable[int]) -> str:
    return f"<SW-ARRAYSIZE>{''.join(f'<V>{size}</V>' for size in shape)}</SW-ARRAYSIZE>\n"


def _values(values: Float) -> str:
    return f"<SW-VALUES-PHYS>{_groups(np.atleast_1d(values).T)}</SW-VALUES-PHYS>"


def _groups(values: Float) -> str:
    """The numbers, x fastest, with a VG around each line of a table; its last index is x."""
    if values.ndim == 1:
        return "".join(f"<V>{number!r}</V>" for number in values.tolist())
    return "".join(f"\n<VG>{_groups(part)}</VG>" for part in values)


def _unit(unit: str) -> str:
    return f"<UNIT-DISPLAY-NAME>{_line(unit)}</UNIT-DISPLAY-NAME>\n"


def _line(text: str) -> str:
    return escape(_OTHER.sub(" ", one_line(text)), quote=False)


def _escaped(text: str) -> str:
    return escape(text, quote=False).replace("\r", "&#13;")
