"""Writes DCM 2.0 as INCA lays it out; numbers in the shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import holds_control_characters, one_line
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Text

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
    further: dict[str, list[Parameter | Text]] = {}
    for item in parameters.others:
        further.setdefault(item.name, []).append(item)
    blocks = []
    for item in parameters.chosen:
        others = further.get(item.name, [])
        blocks.append(item_block(item, [other for other in others if shares_block(item, other)]))
        blocks += [item_block(other) for other in others if not shares_block(item, other)]
    # An axis whose name has blanks cannot head a block; its tables carry it.
    blocks += [axis_block(axis) for axis in parameters.axes if _NAME.fullmatch(axis.name)]
    return "\n".join([_HEADER, *_lists(parameters), *blocks])


def shares_block(item: Parameter | Text, other: Parameter | Text) -> bool:
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
        lines = [f"   KRITERIUM {name} {' '.join(found)}" for name, found in values.items()]
        yield "\n".join(["VARIANTENKODIERUNG", *lines, "END", ""])


def _quote_if_needed(name: str) -> str:
    return name if _NAME.fullmatch(name) else quote(name)


def check_storable(parameters: ParameterSet, file: str) -> None:
    """Raise `InputError` naming every parameter that DCM cannot store, such as cubes and non-finite values."""
    findings = Findings(file)
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    for name in _repeated_names([*parameters, *(text.name for text in parameters.texts)]):
        findings.error(0, name, "is defined twice", "Rename one of the two.")
    for item in (*parameters.chosen, *parameters.others):
        for message, remedy in _item_faults(item):
            findings.error(0, item.name, message, remedy)
    for axis in parameters.axes:
        for message, remedy in _axis_faults(axis, used):
            findings.error(0, axis.name, message, remedy)
    findings.finish()


def _repeated_names(names: list[str]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []


def _item_faults(item: Parameter | Text) -> Iterator[tuple[str, str]]:
    yield from _name_faults(item.name)
    if any(map(holds_control_characters, (item.variant, *item.functions))) or '"' in "".join(item.functions):
        yield "DCM cannot store line breaks in a variant, or quotes in a function", "Rename it."
    if isinstance(item, Text):
        if holds_control_characters(item.text):
            yield "DCM cannot store a text with line breaks or control characters", "Write it as .json."
    elif item.kind == "rbf":
        yield "DCM cannot store a radial basis function expansion", "Write it as .json."
    elif item.kind not in _KEYWORDS or item.values.ndim > 2:
        yield f"DCM cannot store a {item.kind} of {item.values.ndim} dimensions", "Write it as .json."
    elif item.size == 0:
        yield "DCM cannot store an empty block", "Write it as .json."
    elif not np.isfinite(item.values).all():
        yield "DCM cannot store non-finite values", "Set finite values, or write it as .json."


def _name_faults(name: str) -> Iterator[tuple[str, str]]:
    if not _NAME.fullmatch(name) or holds_control_characters(name):
        yield f"{name!r} is not a valid DCM name: it must be one word without quotes", "Rename it."


def _axis_faults(axis: Axis, used: set[str]) -> Iterator[tuple[str, str]]:
    if axis.name not in used:
        yield from _name_faults(axis.name)
    elif axis.name != axis.name.strip() or holds_control_characters(axis.name):
        yield f"{axis.name!r} is not a valid name of a DCM group axis: surrounding blanks are lost", "Rename it."


def item_block(item: Parameter | Text, variants: Iterable[Parameter | Text] = ()) -> str:
    """Return the block of a parameter or text, ending in a line feed; `variants` are further values of a single one."""
    body = _text_body(item) if isinstance(item, Text) else _parameter_body(item)
    values = [f"   {variant_line(other)}" for other in variants]
    return "\n".join([*body, *values, "END", ""])


def variant_line(other: Parameter | Text) -> str:
    """Return the value of another variant: `VAR VariantA=27.5`."""
    value = quote(other.text) if isinstance(other, Text) else repr(float(other.values))
    return f"VAR {other.variant}={value}"


def _parameter_body(member: Parameter) -> Iterator[str]:
    group = "GRUPPEN" if any(axis.name for axis in member.axes) else ""
    sizes = " @ ".join(map(str, member.values.shape)) if isinstance(member, Block) else _sizes(member.axes)
    yield f"{group}{_KEYWORDS[member.kind]} {member.name} {sizes}".rstrip()
    yield from _labels(member)
    yield from (f"   EINHEIT_{letter} {quote(axis.unit)}" for letter, axis in _lettered_axes(member))
    yield f"   EINHEIT_W {quote(member.unit)}"
    yield from (f"*SST{letter}\t{axis.name}" for letter, axis in _lettered_axes(member) if axis.name)
    yield from _numbers_of(member)


def _labels(item: Parameter | Text) -> Iterator[str]:
    yield f"   LANGNAME {quote(item.description)}"
    if item.functions:
        yield f"   FUNKTION {' '.join(map(_quote_if_needed, item.functions))}"
    if item.display_name:
        yield f"   DISPLAYNAME {_quote_if_needed(item.display_name)}"
    if item.variant:
        yield f"   VAR {item.variant}"


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
    lines += [f"   EINHEIT_X {quote(axis.unit)}", *_numbers("ST/X", axis.breakpoints)]
    return "\n".join([*lines, "END", ""])


def _lettered_axes(member: Parameter) -> Iterable[tuple[str, Axis]]:
    return zip(_LETTERS, member.axes, strict=False)


def _sizes(axes: tuple[Axis, ...]) -> str:
    return " ".join(str(len(axis)) for axis in axes)


def quote(text: str) -> str:
    """Return a text between quotes, on one line."""
    escaped = one_line(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
