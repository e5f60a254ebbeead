"""Writes CVX 2.1 with comma and decimal point; numbers in the shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import holds_control_characters, one_line
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

Item = Parameter | Text
_NAME = re.compile(r'[^\s",:*][^",]*')


def write_cvx(parameters: ParameterSet, file: str) -> str:
    """Return the text of a CVX file with comma and decimal point.

    Each variant of a label is a record of its own. Descriptions, bounds, locks, axis inputs and extrapolation have no
    place in CVX. Raises `InputError` naming every parameter that CVX cannot store: cubes, blocks of more than two
    dimensions, non-finite values.
    """
    _refuse(parameters, file)
    items = (*parameters.texts, *parameters.parameters, *parameters.others)
    records = ['CALIBRATION VALUES V2.1,.,*,"",\n', *_header_records(items)]
    for item in items:
        records += _text_records(item) if isinstance(item, Text) else _member_records(item)
    records += [_axis_record(axis.name, "AXIS_PTS", axis) for axis in parameters.axes]
    return "\n".join(records).replace("\n", "\r\n")


def _header_records(items: Iterable[Item]) -> Iterator[str]:
    """Return the functions and variant criteria that occur in the file, which records may refer to only then."""
    functions: dict[str, None] = {}
    criteria: dict[str, dict[str, None]] = {}
    for item in items:
        functions |= dict.fromkeys(item.functions)
        for name, value in _criteria(item.variant):
            criteria.setdefault(name, {})[value] = None
    if functions:
        yield f"FUNCTION_HDR,,\n,{','.join(map(_quote, functions))}\n"
    if criteria:
        rows = (",".join(map(_quote, (name, *values))) for name, values in criteria.items())
        yield "VARIANT_HDR,,\n" + "\n".join(rows) + "\n"


def _criteria(variant: str) -> list[tuple[str, str]]:
    """Return the criteria of a variant with their values; one that names no criterion is a value alone."""
    parts = [part.partition("=") for part in variant.split(",")] if variant else []
    return [(name, value) if equals else ("", name) for name, equals, value in parts]


def _text_records(text: Text) -> Iterator[str]:
    kind = "ASCII" if text.kind == "text" else "VALUE"
    yield _record(text.name, f"{kind},{_format_unit(text.unit)},{_quote(text.text)}", *_coding(text))


def _coding(item: Item) -> list[str]:
    """Return the lines with functions, variant and display name; INCA leaves an empty line before them."""
    lines = [f'FUNCTION,,{_quote(name)},""' for name in item.functions]
    lines += _variant_lines(item)
    lines += [f"DISPLAY_IDENTIFIER,,{_quote(item.display_name)}"] if item.display_name else []
    return ["", *lines] if lines else []


def _variant_lines(item: Item) -> list[str]:
    pairs = [f"{_quote(name)}.{_quote(value)}" if name else _quote(value) for name, value in _criteria(item.variant)]
    return [f"VARIANT,,{','.join(pairs)}"] if pairs else []


def _member_records(member: Parameter) -> Iterator[str]:
    names = ",".join(axis.name for axis in member.axes).rstrip(",")
    if member.kind == "scalar":
        lines = [f"VALUE,{_format_unit(member.unit)},{_format_numbers(member.values.reshape(1))}"]
    elif member.kind == "block":
        first, *others = np.atleast_2d(member.values.T)
        lines = [
            f"VAL_BLK,{_format_unit(member.unit)},{_format_numbers(first)}",
            *(f",,{_format_numbers(row)}" for row in others),
        ]
    else:
        first, *others = np.atleast_2d(member.values.T)
        # The line after MAP is that of embedded breakpoints, which INCA leaves empty and every reader skips.
        lines = [f"MAP,{names}", ""] if member.kind == "map" else [f"CURVE,{names}".rstrip(",")]
        lines += [
            f"{_format_unit(member.unit)},,{_format_numbers(first)}",
            *(f",,{_format_numbers(row)}" for row in others),
        ]
    yield _record(member.name, *lines, *_coding(member))
    for letter, axis in zip("XY", member.axes, strict=False):
        if not axis.name:
            yield _axis_record(member.name, f"{letter}_AXIS_PTS", axis, *_variant_lines(member))


def _axis_record(name: str, kind: str, axis: Axis, *coding: str) -> str:
    return _record(name, f"{kind},{_format_unit(axis.unit)},{_format_numbers(axis.breakpoints)}", *coding)


def _record(name: str, *lines: str) -> str:
    return "\n".join([f",{name}", *lines, ""])


def _format_numbers(values: Float) -> str:
    return ",".join(map(repr, values.tolist()))


def _format_unit(unit: str) -> str:
    return f":{_quote(unit)}:" if unit else ""


def _quote(text: str) -> str:
    return '"' + one_line(text).replace('"', '""') + '"'


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings, seen = Findings(file), set[str]()
    for name in [*parameters, *(text.name for text in parameters.texts)]:
        if name in seen:
            findings.error(0, name, "is defined twice", "Rename one of the two.")
        seen.add(name)
    for name in [*parameters, *(text.name for text in parameters.texts), *(axis.name for axis in parameters.axes)]:
        if not _NAME.fullmatch(name) or holds_control_characters(name) or name != name.strip():
            findings.error(0, name, f"{name!r} is not a valid CVX name: it must have no commas or quotes", "Rename it.")
    groups = {axis.name: axis for axis in parameters.axes}
    for item in (*parameters.parameters, *parameters.texts, *parameters.others):
        for message in _text_faults(item) if isinstance(item, Text) else _faults(item, groups):
            findings.error(0, item.name, message, "Write it as .json.")
    findings.finish()


def _text_faults(text: Text) -> Iterator[str]:
    if holds_control_characters(text.text):
        yield "CVX cannot store a text with line breaks"


def _faults(member: Parameter, groups: Mapping[str, Axis]) -> Iterator[str]:
    for axis in member.axes:
        known = groups.get(axis.name)
        if axis.name and (known is None or not np.array_equal(known.breakpoints, axis.breakpoints)):
            yield f"the variant {member.variant!r} has other breakpoints for the group axis {axis.name}"
    if member.kind in ("cube", "rbf") or member.values.ndim > 2 or member.size == 0:
        yield f"CVX cannot store {'an' if member.kind == 'rbf' else 'a'} {member.kind} of shape {member.values.shape}"
    elif not np.isfinite(member.values).all():
        yield "CVX cannot store non-finite values"
