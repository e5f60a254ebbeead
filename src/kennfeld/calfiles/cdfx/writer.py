"""Writes CDFX 2.0; numbers in the shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape  # that of xml.sax loads half of urllib

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import holds_control_characters, one_line
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

Item = Parameter | Text
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
_NOT_XML = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")  # what XML 1.0 cannot store
_NONCHARACTERS = re.compile(r"[\ufffe\uffff]")


def write_cdfx(parameters: ParameterSet, file: str) -> str:
    """Return the text of a CDFX 2.0 file.

    A group axis becomes a COM_AXIS, to which its tables refer; a cube a CUBOID, or a CUBE_4 as A2L calls it. A label
    with variants has one SW-INSTANCE-PROPS-VARIANT for each. Bounds, locks, axis inputs and extrapolation have no place
    in CDFX. Raises `InputError` naming every parameter that CDFX cannot store: expansions, non-finite values,
    one name for two things.
    """
    _refuse(parameters, file)
    name = _escape_text(file.rpartition(".")[0] or file)
    others: dict[str, list[Item]] = {}
    for item in parameters.others:
        others.setdefault(item.name, []).append(item)
    labels: tuple[Item, ...] = (*parameters.texts, *parameters.parameters)
    instances = [_instance(item, others.get(item.name, [])) for item in labels]
    instances += map(_group_axis, parameters.axes)
    coding = "VCD" if parameters.variants else "NO_VCD"
    return "".join([_HEAD.format(name=name, coding=coding), *instances, _FOOT])


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings = Findings(file)
    names = [*parameters, *(text.name for text in parameters.texts), *(axis.name for axis in parameters.axes)]
    seen = set[str]()
    for name in names:
        if name in seen:
            findings.error(
                0, name, "is defined twice; parameters, texts and group axes share one namespace", "Rename one."
            )
        seen.add(name)
        if not name.strip() or name != name.strip() or holds_control_characters(name) or _NOT_XML.search(name):
            findings.error(
                0,
                name,
                f"{name!r} is not a valid CDFX name: it has surrounding blanks or control characters",
                "Rename it.",
            )
    for member in parameters.parameters:
        for message in _faults(member):
            findings.error(0, member.name, message, "Write it as .json.")
    for text in parameters.texts:
        if _NOT_XML.search(text.text):
            findings.error(0, text.name, "XML cannot store a text with control characters", "Write it as .json.")
    _refuse_variants(parameters, findings)
    findings.finish()


def _refuse_variants(parameters: ParameterSet, findings: Findings) -> None:
    first = {item.name: item for item in parameters.chosen}
    for item in parameters.others:
        if item.name not in first or item.kind != first[item.name].kind:
            message = f"is a {item.kind} only in the variant {item.variant!r}; a CDFX label has one category"
            findings.error(0, item.name, message, "Write it as .json.")
        faults = [*_faults(item), *other_axes(item, parameters)] if isinstance(item, Parameter) else []
        for message in faults:
            findings.error(0, item.name, f"{message} (variant {item.variant})", "Write it as .json.")
        if isinstance(item, Text) and _NOT_XML.search(item.text):
            findings.error(0, item.name, "XML cannot store a text with control characters", "Write it as .json.")


def other_axes(member: Parameter, parameters: ParameterSet) -> Iterator[str]:
    """Return the group axes that have other breakpoints in a variant than in the set, which a file holds once."""
    groups = {axis.name: axis for axis in parameters.axes}
    for axis in member.axes:
        known = groups.get(axis.name)
        if axis.name and (known is None or not np.array_equal(known.breakpoints, axis.breakpoints)):
            yield f"has other breakpoints for the group axis {axis.name}"


def _faults(member: Parameter) -> Iterator[str]:
    if member.kind == "rbf":
        yield "CDFX cannot store a radial basis function expansion"
    elif member.size == 0:
        yield "CDFX cannot store an empty block"
    elif not np.isfinite(member.values).all():
        yield "CDFX cannot store non-finite values"


def _category(item: Item) -> str:
    if isinstance(item, Text) or item.kind in _CATEGORIES:
        return _CATEGORIES[item.kind]
    return "CUBOID" if len(item.axes) == 3 else f"CUBE_{len(item.axes)}"


def _format_values(item: Item) -> str:
    """Return the values of a label in one variant."""
    if isinstance(item, Text):
        return _value_cont(item.unit, "", f"<SW-VALUES-PHYS><VT>{_escape_text(item.text)}</VT></SW-VALUES-PHYS>")
    size = _array_size(item.values.shape) if item.kind == "block" else ""
    contents = [_value_cont(item.unit, size, _values(item.values))]
    if item.axes:
        contents += ["<SW-AXIS-CONTS>\n", *map(_axis_cont, item.axes), "</SW-AXIS-CONTS>\n"]
    return "".join(contents)


def _variant(item: Item) -> str:
    criteria = "".join(map(_criterion, item.variant.split(","))) if item.variant else ""
    values = f"<SW-VCD-CRITERION-VALUES>\n{criteria}</SW-VCD-CRITERION-VALUES>\n" if criteria else ""
    return f"<SW-INSTANCE-PROPS-VARIANT>\n{values}{_format_values(item)}</SW-INSTANCE-PROPS-VARIANT>\n"


def _criterion(said: str) -> str:
    name, equals, value = said.partition("=")
    reference = f"<SW-VCD-CRITERION-REF>{_escape_line(name)}</SW-VCD-CRITERION-REF>" if equals else ""
    text = f"<VT>{_escape_line(value if equals else said)}</VT>"
    return f"<SW-VCD-CRITERION-VALUE>{reference}{text}</SW-VCD-CRITERION-VALUE>\n"


def _group_axis(axis: Axis) -> str:
    head = (
        f"<SHORT-NAME>{_escape_text(axis.name)}</SHORT-NAME>\n<LONG-NAME></LONG-NAME>\n<CATEGORY>COM_AXIS</CATEGORY>\n"
    )
    return f"<SW-INSTANCE>\n{head}{_value_cont(axis.unit, '', _values(axis.breakpoints))}</SW-INSTANCE>\n"


def _axis_cont(axis: Axis) -> str:
    if axis.name:
        content = f"<SW-INSTANCE-REF>{_escape_text(axis.name)}</SW-INSTANCE-REF>\n{_array_size((len(axis),))}"
    else:
        content = _values(axis.breakpoints) + "\n"
    category = "COM_AXIS" if axis.name else "STD_AXIS"
    head = f"<SW-AXIS-CONT>\n<CATEGORY>{category}</CATEGORY>\n{_format_unit(axis.unit)}"
    return f"{head}{content}</SW-AXIS-CONT>\n"


def _instance(item: Item, others: Sequence[Item]) -> str:
    """Return a label with its values, in variants where it has any."""
    references = (f"<SW-FEATURE-REF>{_escape_line(name)}</SW-FEATURE-REF>\n" for name in item.functions)
    held = _format_values(item)
    if item.variant or others:
        variants = "".join(map(_variant, (item, *others)))
        held = f"<SW-INSTANCE-PROPS-VARIANTS>\n{variants}</SW-INSTANCE-PROPS-VARIANTS>\n"
    return "".join(
        [
            "<SW-INSTANCE>\n",
            f"<SHORT-NAME>{_escape_text(item.name)}</SHORT-NAME>\n",
            f"<LONG-NAME>{_escape_line(item.description)}</LONG-NAME>\n",
            f"<DISPLAY-NAME>{_escape_line(item.display_name)}</DISPLAY-NAME>\n" if item.display_name else "",
            f"<CATEGORY>{_category(item)}</CATEGORY>\n",
            *references,
            held,
            "</SW-INSTANCE>\n",
        ]
    )


def _value_cont(unit: str, size: str, values: str) -> str:
    return f"<SW-VALUE-CONT>\n{_format_unit(unit)}{size}{values}\n</SW-VALUE-CONT>\n"


def _array_size(shape: Iterable[int]) -> str:
    return f"<SW-ARRAYSIZE>{''.join(f'<V>{size}</V>' for size in shape)}</SW-ARRAYSIZE>\n"


def _values(values: Float) -> str:
    return f"<SW-VALUES-PHYS>{_groups(np.atleast_1d(values).T)}</SW-VALUES-PHYS>"


def _groups(values: Float) -> str:
    """Return the numbers, x fastest, with a VG around each line of a table; its last index is x."""
    if values.ndim == 1:
        return "".join(f"<V>{number!r}</V>" for number in values.tolist())
    return "".join(f"\n<VG>{_groups(part)}</VG>" for part in values)


def _format_unit(unit: str) -> str:
    return f"<UNIT-DISPLAY-NAME>{_escape_line(unit)}</UNIT-DISPLAY-NAME>\n"


def _escape_line(text: str) -> str:
    return escape(_NONCHARACTERS.sub(" ", one_line(text)), quote=False)


def _escape_text(text: str) -> str:
    return escape(text, quote=False).replace("\r", "&#13;")
