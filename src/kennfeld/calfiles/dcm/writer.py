"""Writes DCM 2.0 as INCA lays it out; numbers in the shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import holds_control_characters, one_line
from kennfeld.calfiles.content import in_stored_order, stored_breakpoints
from kennfeld.calfiles.format import FileFindings, Item
from kennfeld.calfiles.storable import USE_JSON, report_repeated, value_faults
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Parameter
from kennfeld.domain.texts import Text

_HEADER = """* encoding="UTF-8"
* DAMOS format
* Created by Kennfeld

KONSERVIERUNG_FORMAT 2.0
"""
_NUMBERS_PER_LINE = 6  # numbers a line, as INCA writes them
_NAME = re.compile(r'[^\s"*!.][^\s"]*')
_KEYWORDS = {"scalar": "FESTWERT", "block": "FESTWERTEBLOCK", "curve": "KENNLINIE", "map": "KENNFELD"}
_LETTERS = ("X", "Y")


def whole_text(parameters: ParameterSet) -> str:
    """Return the text of a DCM 2.0 file.

    A table with a group axis becomes a GRUPPENKENNLINIE or GRUPPENKENNFELD, and each group axis is written once.
    Bounds, locks, axis inputs and extrapolation cannot be stored in DCM.
    """
    further = parameters.others_by_name
    blocks = []
    for item in parameters.chosen:
        others = further.get(item.name, [])
        blocks.append(item_block(item, [other for other in others if shares_block(item, other)]))
        blocks += [item_block(other) for other in others if not shares_block(item, other)]
    # An axis whose name has blanks cannot head a block; its tables carry it.
    blocks += [axis_block(axis) for axis in parameters.axes if _NAME.fullmatch(axis.name)]
    return "\n".join([_HEADER, *_lists(parameters), *blocks])


def shares_block(item: Item, other: Item) -> bool:
    """Check whether another variant is a line in the block of a single value, as `VAR VariantA=27.5`."""
    single = isinstance(item, Text) or item.kind == "scalar"
    return single and not item.variant and bool(other.variant) and "=" not in other.variant


def _lists(parameters: ParameterSet) -> Iterator[str]:
    """Return the functions and the criteria of variants that blocks name."""
    functions = dict.fromkeys(name for item in parameters.everything.values() for name in item.functions)
    if functions:
        yield "\n".join(["FUNKTIONEN", *(f'   FKT {_quote_if_needed(name)} "" ""' for name in functions), "END", ""])
    values: dict[str, dict[str, None]] = {}
    for variant in parameters.variants:
        for criterion, equals, value in (part.partition("=") for part in variant.split(",")):
            if equals:
                values.setdefault(criterion, {})[value] = None
    if values:
        lines = [f"   KRITERIUM {name} {' '.join(words)}" for name, words in values.items()]
        yield "\n".join(["VARIANTENKODIERUNG", *lines, "END", ""])


def _quote_if_needed(name: str) -> str:
    return name if _NAME.fullmatch(name) else quote(name)


def check_storable(parameters: ParameterSet, file: str) -> None:
    """Raise `InputError` naming every parameter that DCM cannot store, such as cubes and non-finite values."""
    findings = FileFindings(file)
    report_repeated((item.name for item in parameters.chosen), findings)
    for item in (*parameters.chosen, *parameters.others):
        for message, remedy in _item_faults(item):
            findings.error(0, item.name, message, remedy)
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    for axis in parameters.axes:
        # tables name their axes in a comment, which takes nearly any name; a block of its own takes one word
        if axis.name not in used:
            for message, remedy in _name_faults(axis.name):
                findings.error(0, axis.name, message, remedy)
        elif axis.name != axis.name.strip() or holds_control_characters(axis.name):
            message = f"{axis.name!r} is not a valid name of a DCM group axis: surrounding blanks are lost"
            findings.error(0, axis.name, message, "Rename it.")
    findings.finish()


def _item_faults(item: Item) -> Iterator[tuple[str, str]]:
    yield from _name_faults(item.name)
    if any(map(holds_control_characters, (item.variant, *item.functions))) or '"' in "".join(item.functions):
        yield "DCM cannot store line breaks in a variant, or quotes in a function", "Rename it."
    if isinstance(item, Text):
        if holds_control_characters(item.text):
            yield "DCM cannot store a text with line breaks or control characters", USE_JSON
    elif item.kind != "rbf" and (item.kind not in _KEYWORDS or item.values.ndim > 2):
        yield f"DCM cannot store a {item.kind} of {item.values.ndim} dimensions", USE_JSON
    else:
        yield from ((message, USE_JSON) for message in value_faults(item, "DCM"))


def _name_faults(name: str) -> Iterator[tuple[str, str]]:
    if not _NAME.fullmatch(name) or holds_control_characters(name):
        yield f"{name!r} is not a valid DCM name: it must be one word without quotes", "Rename it."


def item_block(item: Item, variants: Iterable[Item] = ()) -> str:
    """Return the block of a parameter or text, ending in a line feed; `variants` are further values of a single one."""
    body = _text_body(item) if isinstance(item, Text) else _parameter_body(item)
    values = []
    for other in variants:
        value = quote(other.text) if isinstance(other, Text) else repr(float(other.values))
        values.append(f"   VAR {other.variant}={value}")
    return "\n".join([*body, *values, "END", ""])


def _parameter_body(member: Parameter) -> Iterator[str]:
    group = "GRUPPEN" if any(axis.name for axis in member.axes) else ""
    sizes = (" @ " if isinstance(member, Block) else " ").join(map(str, member.values.shape))
    axes = list(zip(_LETTERS, member.axes, strict=False))
    yield f"{group}{_KEYWORDS[member.kind]} {member.name} {sizes}".rstrip()
    yield from _labels(member)
    yield from (f"   EINHEIT_{letter} {quote(axis.unit)}" for letter, axis in axes)
    yield f"   EINHEIT_W {quote(member.unit)}"
    yield from (f"*SST{letter}\t{axis.name}" for letter, axis in axes if axis.name)
    values, points = in_stored_order(member)
    if points:
        yield from _numbers("ST/X", points[0])
    # One row a line group for a two-dimensional block too, so that a reader sees its shape.
    for at, row in enumerate(np.atleast_2d(values.T)):
        if len(points) > 1:
            yield f"   ST/Y   {float(points[1][at])!r}"
        yield from _numbers("WERT", row)


def _labels(item: Item) -> Iterator[str]:
    yield f"   LANGNAME {quote(item.description)}"
    if item.functions:
        yield f"   FUNKTION {' '.join(map(_quote_if_needed, item.functions))}"
    if item.display_name:
        yield f"   DISPLAYNAME {_quote_if_needed(item.display_name)}"
    if item.variant:
        yield f"   VAR {item.variant}"


def _numbers(keyword: str, values: Float) -> Iterator[str]:
    words = [repr(value) for value in values.tolist()]
    for start in range(0, len(words), _NUMBERS_PER_LINE):
        yield f"   {keyword}   {'   '.join(words[start : start + _NUMBERS_PER_LINE])}"


def _text_body(text: Text) -> Iterator[str]:
    yield f"{'TEXTSTRING' if text.kind == 'text' else 'FESTWERT'} {text.name}"
    yield from _labels(text)
    if text.unit or text.kind != "text":
        yield f"   EINHEIT_W {quote(text.unit)}"
    yield f"   TEXT {quote(text.text)}"


def axis_block(axis: Axis) -> str:
    """Return the block of a group axis, ending in a line feed."""
    lines = [f"STUETZSTELLENVERTEILUNG {axis.name} {len(axis)}", "*SST", '   LANGNAME ""']
    lines += [f"   EINHEIT_X {quote(axis.unit)}", *_numbers("ST/X", stored_breakpoints(axis))]
    return "\n".join([*lines, "END", ""])


def quote(text: str) -> str:
    """Return a text between quotes, on one line."""
    escaped = one_line(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
