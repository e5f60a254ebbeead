"""Parameters as CDFX 2.0; numbers in their shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape  # that of xml.sax loads half of urllib

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import holds_control_characters, one_line
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["write_cdfx"]

Thing = Parameter | Text
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
<CATEGORY>{coding}</CATEGORY>
"""
_FOOT = """</SW-INSTANCE-TREE>
</SW-INSTANCE-SPEC>
</SW-SYSTEM>
</SW-SYSTEMS>
</MSRSW>
"""
_CATEGORIES = {
    "scalar": "VALUE",
    "block": "VAL_BLK",
    "curve": "CURVE",
    "map": "MAP",
    "text": "ASCII",
    "enumeration": "VALUE",
    "boolean": "BOOLEAN",
}
_UNFIT = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")  # what XML 1.0 cannot hold
_OTHER = re.compile(r"[\ufffe\uffff]")


def write_cdfx(parameters: ParameterSet, file: str) -> str:
    """The text of a CDFX 2.0 file.

    A group axis becomes a COM_AXIS, to which its tables refer; a cube a CUBOID, or a CUBE_4 as A2L calls it. A label
    with variants has one SW-INSTANCE-PROPS-VARIANT for each. Bounds, locks, axis inputs and extrapolation have no place
    in CDFX. Raises `InputError` naming every parameter that CDFX cannot hold: expansions, values that are not finite,
    one name for two things.
    """
    _refuse(parameters, file)
    name = _escaped(file.rpartition(".")[0] or file)
    others: dict[str, list[Thing]] = {}
    for thing in parameters.others:
        others.setdefault(thing.name, []).append(thing)
    labels: tuple[Thing, ...] = (*parameters.texts, *parameters.parameters)
    instances = [_instance(thing, others.get(thing.name, [])) for thing in labels]
    instances += map(_group_axis, parameters.axes)
    coding = "VCD" if parameters.variants else "NO_VCD"
    return "".join([_HEAD.format(name=name, coding=coding), *instances, _FOOT])


def _refuse(parameters: ParameterSet, file: str) -> None:
    notes = Findings(file)
    names = [*parameters, *(text.name for text in parameters.texts), *(axis.name for axis in parameters.axes)]
    seen = set[str]()
    for name in names:
        if name in seen:
            notes.error(0, name, "is given twice; parameters, texts and group axes share their names", "Rename one.")
        seen.add(name)
        if not name.strip() or name != name.strip() or holds_control_characters(name) or _UNFIT.search(name):
            notes.error(0, name, f"{name!r} cannot be a name in CDFX: blanks around it or controls in it", "Rename it.")
    for member in parameters.parameters:
        for message in _faults(member):
            notes.error(0, member.name, message, "Write it as .json.")
    for text in parameters.texts:
        if _UNFIT.search(text.text):
            notes.error(0, text.name, "XML cannot hold a text with control characters", "Write it as .json.")
    _refuse_variants(parameters, notes)
    notes.settle()


def _refuse_variants(parameters: ParameterSet, notes: Findings) -> None:
    first = {thing.name: thing for thing in parameters.chosen}
    for thing in parameters.others:
        if thing.name not in first or thing.kind != first[thing.name].kind:
            message = f"is a {thing.kind} in the variant {thing.variant!r} alone; a label of CDFX has one category"
            notes.error(0, thing.name, message, "Write it as .json.")
        faults = [*_faults(thing), *other_axes(thing, parameters)] if isinstance(thing, Parameter) else []
        for message in faults:
            notes.error(0, thing.name, f"{message} (variant {thing.variant})", "Write it as .json.")
        if isinstance(thing, Text) and _UNFIT.search(thing.text):
            notes.error(0, thing.name, "XML cannot hold a text with control characters", "Write it as .json.")


def other_axes(member: Parameter, parameters: ParameterSet) -> Iterator[str]:
    """The group axes that have other breakpoints in a variant than in the set, which a file holds once."""
    groups = {axis.name: axis for axis in parameters.axes}
    for axis in member.axes:
        known = groups.get(axis.name)
        if axis.name and (known is None or not np.array_equal(known.breakpoints, axis.breakpoints)):
            yield f"has other breakpoints for the group axis {axis.name}"


def _faults(member: Parameter) -> Iterator[str]:
    if member.kind == "rbf":
        yield "CDFX cannot hold an expansion in radial basis functions"
    elif member.size == 0:
        yield "CDFX cannot hold a block without values"
    elif not np.isfinite(member.values).all():
        yield "CDFX cannot hold values that are not finite"


def _category(thing: Thing) -> str:
    if isinstance(thing, Text) or thing.kind in _CATEGORIES:
        return _CATEGORIES[thing.kind]
    return "CUBOID" if len(thing.axes) == 3 else f"CUBE_{len(thing.axes)}"


def _held(thing: Thing) -> str:
    """The values of a label in one variant."""
    if isinstance(thing, Text):
        return _value_cont(thing.unit, "", f"<SW-VALUES-PHYS><VT>{_escaped(thing.text)}</VT></SW-VALUES-PHYS>")
    size = _array_size(thing.values.shape) if thing.kind == "block" else ""
    contents = [_value_cont(thing.unit, size, _values(thing.values))]
    if thing.axes:
        contents += ["<SW-AXIS-CONTS>\n", *map(_axis_cont, thing.axes), "</SW-AXIS-CONTS>\n"]
    return "".join(contents)


def _variant(thing: Thing) -> str:
    criteria = "".join(map(_criterion, thing.variant.split(","))) if thing.variant else ""
    values = f"<SW-VCD-CRITERION-VALUES>\n{criteria}</SW-VCD-CRITERION-VALUES>\n" if criteria else ""
    return f"<SW-INSTANCE-PROPS-VARIANT>\n{values}{_held(thing)}</SW-INSTANCE-PROPS-VARIANT>\n"


def _criterion(said: str) -> str:
    """One criterion of a variant, `Engine=2`."""
    name, equals, value = said.partition("=")
    reference = f"<SW-VCD-CRITERION-REF>{_line(name)}</SW-VCD-CRITERION-REF>" if equals else ""
    text = f"<VT>{_line(value if equals else said)}</VT>"
    return f"<SW-VCD-CRITERION-VALUE>{reference}{text}</SW-VCD-CRITERION-VALUE>\n"


def _group_axis(axis: Axis) -> str:
    head = f"<SHORT-NAME>{_escaped(axis.name)}</SHORT-NAME>\n<LONG-NAME></LONG-NAME>\n<CATEGORY>COM_AXIS</CATEGORY>\n"
    return f"<SW-INSTANCE>\n{head}{_value_cont(axis.unit, '', _values(axis.breakpoints))}</SW-INSTANCE>\n"


def _axis_cont(axis: Axis) -> str:
    if axis.name:
        content = f"<SW-INSTANCE-REF>{_escaped(axis.name)}</SW-INSTANCE-REF>\n{_array_size((len(axis),))}"
    else:
        content = _values(axis.breakpoints) + "\n"
    category = "COM_AXIS" if axis.name else "STD_AXIS"
    head = f"<SW-AXIS-CONT>\n<CATEGORY>{category}</CATEGORY>\n{_unit(axis.unit)}"
    return f"{head}{content}</SW-AXIS-CONT>\n"


def _instance(thing: Thing, others: Sequence[Thing]) -> str:
    """A label with its values, in variants where it has any."""
    references = (f"<SW-FEATURE-REF>{_line(name)}</SW-FEATURE-REF>\n" for name in thing.functions)
    held = _held(thing)
    if thing.variant or others:
        variants = "".join(map(_variant, (thing, *others)))
        held = f"<SW-INSTANCE-PROPS-VARIANTS>\n{variants}</SW-INSTANCE-PROPS-VARIANTS>\n"
    return "".join(
        [
            "<SW-INSTANCE>\n",
            f"<SHORT-NAME>{_escaped(thing.name)}</SHORT-NAME>\n",
            f"<LONG-NAME>{_line(thing.description)}</LONG-NAME>\n",
            f"<DISPLAY-NAME>{_line(thing.display_name)}</DISPLAY-NAME>\n" if thing.display_name else "",
            f"<CATEGORY>{_category(thing)}</CATEGORY>\n",
            *references,
            held,
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
