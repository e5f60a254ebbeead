"""Writes CVX 2.1 with comma and decimal point; numbers in the shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import holds_control_characters, one_line
from kennfeld.calfiles.content import in_stored_order, stored_breakpoints
from kennfeld.calfiles.format import FileFindings, Item
from kennfeld.calfiles.storable import USE_JSON, differing_groups, report_repeated, value_faults
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.texts import Text

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
        records += _item_records(item)
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


def _coding(item: Item) -> list[str]:
    """Return the lines with functions, variant and display name; INCA leaves an empty line before them."""
    lines = [f'FUNCTION,,{_quote(name)},""' for name in item.functions]
    lines += _variant_lines(item)
    lines += [f"DISPLAY_IDENTIFIER,,{_quote(item.display_name)}"] if item.display_name else []
    return ["", *lines] if lines else []


def _variant_lines(item: Item) -> list[str]:
    pairs = [f"{_quote(name)}.{_quote(value)}" if name else _quote(value) for name, value in _criteria(item.variant)]
    return [f"VARIANT,,{','.join(pairs)}"] if pairs else []


def _item_records(item: Item) -> Iterator[str]:
    unit = _format_unit(item.unit)
    if isinstance(item, Text):
        kind = "ASCII" if item.kind == "text" else "VALUE"
        yield _record(item.name, f"{kind},{unit},{_quote(item.text)}", *_coding(item))
        return
    values, _ = in_stored_order(item)
    # one line for each y
    first, *others = map(_format_numbers, np.atleast_2d(values.T))
    lines = [f"{unit},,{first}"]
    if item.kind in ("scalar", "block"):
        lines = [f"{'VALUE' if item.kind == 'scalar' else 'VAL_BLK'},{unit},{first}"]
    elif item.kind == "curve":
        lines.insert(0, f"CURVE,{item.axes[0].name}".rstrip(","))
    else:
        # The line after MAP is that of embedded breakpoints, which INCA leaves empty and every reader skips.
        names = ",".join(axis.name for axis in item.axes).rstrip(",")
        lines[:0] = [f"MAP,{names}", ""]
    yield _record(item.name, *lines, *(f",,{row}" for row in others), *_coding(item))
    for letter, axis in zip("XY", item.axes, strict=False):
        if not axis.name:
            yield _axis_record(item.name, f"{letter}_AXIS_PTS", axis, *_variant_lines(item))


def _axis_record(name: str, kind: str, axis: Axis, *coding: str) -> str:
    return _record(name, f"{kind},{_format_unit(axis.unit)},{_format_numbers(stored_breakpoints(axis))}", *coding)


def _record(name: str, *lines: str) -> str:
    return "\n".join([f",{name}", *lines, ""])


def _format_numbers(values: Float) -> str:
    return ",".join(map(repr, values.tolist()))


def _format_unit(unit: str) -> str:
    return f":{_quote(unit)}:" if unit else ""


def _quote(text: str) -> str:
    return '"' + one_line(text).replace('"', '""') + '"'


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings = FileFindings(file)
    report_repeated((item.name for item in parameters.chosen), findings)
    for name in [item.name for item in (*parameters.chosen, *parameters.axes)]:
        if not _NAME.fullmatch(name) or holds_control_characters(name) or name != name.strip():
            findings.error(0, name, f"{name!r} is not a valid CVX name: it must have no commas or quotes", "Rename it.")
    for item in (*parameters.chosen, *parameters.others):
        for message in _faults(item, parameters):
            findings.error(0, item.name, message, USE_JSON)
    findings.finish()


def _faults(item: Item, parameters: ParameterSet) -> Iterator[str]:
    if isinstance(item, Text):
        if holds_control_characters(item.text):
            yield "CVX cannot store a text with line breaks"
        return
    for name in differing_groups(item, parameters):
        yield f"the variant {item.variant!r} has other breakpoints for the group axis {name}"
    if item.kind in ("cube", "rbf") or item.values.ndim > 2 or item.size == 0:
        yield f"CVX cannot store {'an' if item.kind == 'rbf' else 'a'} {item.kind} of shape {item.values.shape}"
    else:
        yield from value_faults(item, "CVX")
