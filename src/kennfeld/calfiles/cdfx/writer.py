"""Writes CDFX 2.0; numbers in the shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape  # that of xml.sax loads half of urllib

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import holds_control_characters, one_line
from kennfeld.calfiles.content import in_stored_order, stored_breakpoints
from kennfeld.calfiles.format import FileFindings, Item
from kennfeld.calfiles.storable import USE_JSON, differing_groups, report_repeated_variables, value_faults
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

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
_CATEGORIES = {"scalar": "VALUE", "block": "VAL_BLK", "curve": "CURVE", "map": "MAP"}
_CATEGORIES |= {"text": "ASCII", "enumeration": "VALUE", "boolean": "BOOLEAN"}
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
    others = parameters.others_by_name
    labels: tuple[Item, ...] = (*parameters.texts, *parameters.parameters)
    instances = [_instance(item, others.get(item.name, [])) for item in labels]
    instances += map(_group_axis, parameters.axes)
    coding = "VCD" if parameters.variants else "NO_VCD"
    return "".join([_HEAD.format(name=name, coding=coding), *instances, _FOOT])


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings = FileFindings(file)
    for name in report_repeated_variables(parameters, findings):
        if not name.strip() or name != name.strip() or holds_control_characters(name) or _NOT_XML.search(name):
            message = f"{name!r} is not a valid CDFX name: it has surrounding blanks or control characters"
            findings.error(0, name, message, "Rename it.")
    first = {item.name: item for item in parameters.chosen}
    for item in parameters.chosen:
        for message in _faults(item):
            findings.error(0, item.name, message, USE_JSON)
    for item in parameters.others:
        if item.name not in first or item.kind != first[item.name].kind:
            message = f"is a {item.kind} only in the variant {item.variant!r}; a CDFX label has one category"
            findings.error(0, item.name, message, USE_JSON)
        groups = differing_groups(item, parameters) if isinstance(item, Parameter) else []
        for message in [*_faults(item), *(f"has other breakpoints for the group axis {name}" for name in groups)]:
            findings.error(0, item.name, f"{message} (variant {item.variant})", USE_JSON)
    findings.finish()


def _faults(item: Item) -> Iterator[str]:
    if isinstance(item, Parameter):
        yield from value_faults(item, "CDFX")
    elif _NOT_XML.search(item.text):
        yield "XML cannot store a text with control characters"


def _instance(item: Item, others: Sequence[Item]) -> str:
    """Return a label with its values, in variants if it has any."""
    category = _CATEGORIES.get(item.kind, "")
    if not category and isinstance(item, Parameter):
        category = "CUBOID" if len(item.axes) == 3 else f"CUBE_{len(item.axes)}"
    references = (f"<SW-FEATURE-REF>{_escape_line(name)}</SW-FEATURE-REF>\n" for name in item.functions)
    values = _format_values(item)
    # a single variant is written as one, or its criteria would be lost
    if item.variant or others:
        variants = "".join(map(_variant, (item, *others)))
        values = f"<SW-INSTANCE-PROPS-VARIANTS>\n{variants}</SW-INSTANCE-PROPS-VARIANTS>\n"
    parts = [
        "<SW-INSTANCE>\n",
        f"<SHORT-NAME>{_escape_text(item.name)}</SHORT-NAME>\n",
        f"<LONG-NAME>{_escape_line(item.description)}</LONG-NAME>\n",
        f"<DISPLAY-NAME>{_escape_line(item.display_name)}</DISPLAY-NAME>\n" if item.display_name else "",
        f"<CATEGORY>{category}</CATEGORY>\n",
        *references,
        values,
        "</SW-INSTANCE>\n",
    ]
    return "".join(parts)


def _format_values(item: Item) -> str:
    if isinstance(item, Text):
        return _value_cont(item.unit, "", f"<SW-VALUES-PHYS><VT>{_escape_text(item.text)}</VT></SW-VALUES-PHYS>")
    size = _array_size(item.values.shape) if item.kind == "block" else ""
    values, points = in_stored_order(item)
    contents = [_value_cont(item.unit, size, _values(values))]
    if item.axes:
        contents += ["<SW-AXIS-CONTS>\n", *map(_axis_cont, item.axes, points), "</SW-AXIS-CONTS>\n"]
    return "".join(contents)


def _variant(item: Item) -> str:
    criteria = []
    for criterion in item.variant.split(",") if item.variant else ():
        # of `Engine=2`, Engine is the criterion; a text without = is the value of an unnamed one
        name, equals, value = criterion.partition("=")
        reference = f"<SW-VCD-CRITERION-REF>{_escape_line(name)}</SW-VCD-CRITERION-REF>" if equals else ""
        text = f"<VT>{_escape_line(value if equals else criterion)}</VT>"
        criteria.append(f"<SW-VCD-CRITERION-VALUE>{reference}{text}</SW-VCD-CRITERION-VALUE>\n")
    values = f"<SW-VCD-CRITERION-VALUES>\n{''.join(criteria)}</SW-VCD-CRITERION-VALUES>\n" if criteria else ""
    return f"<SW-INSTANCE-PROPS-VARIANT>\n{values}{_format_values(item)}</SW-INSTANCE-PROPS-VARIANT>\n"


def _group_axis(axis: Axis) -> str:
    head = (
        f"<SHORT-NAME>{_escape_text(axis.name)}</SHORT-NAME>\n<LONG-NAME></LONG-NAME>\n<CATEGORY>COM_AXIS</CATEGORY>\n"
    )
    return f"<SW-INSTANCE>\n{head}{_value_cont(axis.unit, '', _values(stored_breakpoints(axis)))}</SW-INSTANCE>\n"


def _axis_cont(axis: Axis, points: Float) -> str:
    if axis.name:
        content = f"<SW-INSTANCE-REF>{_escape_text(axis.name)}</SW-INSTANCE-REF>\n{_array_size((len(axis),))}"
    else:
        content = _values(points) + "\n"
    category = "COM_AXIS" if axis.name else "STD_AXIS"
    head = f"<SW-AXIS-CONT>\n<CATEGORY>{category}</CATEGORY>\n{_format_unit(axis.unit)}"
    return f"{head}{content}</SW-AXIS-CONT>\n"


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
    # readers of XML turn a bare carriage return into a line feed
    return escape(text, quote=False).replace("\r", "&#13;")
