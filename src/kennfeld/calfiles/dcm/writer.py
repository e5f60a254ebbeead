"""Parameters as new DCM 2.0 text, laid out as INCA does; numbers in their shortest form that reads back exactly."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import holds_control_characters, one_line
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Text

__all__ = ["axis_block", "in_the_block_of", "quoted", "refuse", "thing_block", "whole_text"]

_HEADER = """* encoding="UTF-8"
* DAMOS format
* Created by Kennfeld

KONSERVIERUNG_FORMAT 2.0
"""
_A_LINE = 6  # numbers a line, as INCA writes them
_NAME = re.compile(r'[^\s"*!.][^\s"]*')
_KEYWORDS = {"scalar": "FESTWERT", "block": "FESTWERTEBLOCK", "curve": "KENNLINIE", "map": "KENNFELD"}
_LETTERS = ("X", "Y")


def whole_text(parameters: ParameterSet) -> str:
    """The text of a DCM 2.0 file.

    A table with a group axis becomes a GRUPPENKENNLINIE or GRUPPENKENNFELD, and each group axis is written once.
    Bounds, locks, axis inputs and extrapolation have no place in DCM.
    """
    further: dict[str, list[Parameter | Text]] = {}
    for thing in parameters.others:
        further.setdefault(thing.name, []).append(thing)
    blocks = []
    for thing in parameters.chosen:
        others = further.get(thing.name, [])
        blocks.append(thing_block(thing, [other for other in others if in_the_block_of(thing, other)]))
        blocks += [thing_block(other) for other in others if not in_the_block_of(thing, other)]
    # An axis whose name has blanks cannot head a block; its tables carry it.
    blocks += [axis_block(axis) for axis in parameters.axes if _NAME.fullmatch(axis.name)]
    return "\n".join([_HEADER, *_lists(parameters), *blocks])


def in_the_block_of(thing: Parameter | Text, other: Parameter | Text) -> bool:
    """Whether another variant is a line in the block of a single value, as `VAR VariantA=27.5`."""
    single = isinstance(thing, Text) or thing.kind == "scalar"
    return single and not thing.variant and bool(other.variant) and "=" not in other.variant


def _lists(parameters: ParameterSet) -> Iterator[str]:
    """The functions and the criteria of variants that blocks name."""
    functions = dict.fromkeys(name for thing in parameters.everything.values() for name in thing.functions)
    if functions:
        yield "\n".join(["FUNKTIONEN", *(f'   FKT {_word(name)} "" ""' for name in functions), "END", ""])
    values: dict[str, dict[str, None]] = {}
    for variant in parameters.variants:
        for criterion, equals, value in (part.partition("=") for part in variant.split(",")):
            if equals:
                values.setdefault(criterion, {})[value] = None
    if values:
        lines = [f"   KRITERIUM {name} {' '.join(found)}" for name, found in values.items()]
        yield "\n".join(["VARIANTENKODIERUNG", *lines, "END", ""])


def _word(name: str) -> str:
    return name if _NAME.fullmatch(name) else quoted(name)


def refuse(parameters: ParameterSet, file: str) -> None:
    """Raise `InputError` naming every parameter that DCM cannot hold: cubes, values that are not finite."""
    notes = Findings(file)
    used = {axis.name for member in parameters.parameters for axis in member.axes}
    for name in _repeated([*parameters, *(text.name for text in parameters.texts)]):
        notes.error(0, name, "is given twice", "Rename one of the two.")
    for thing in (*parameters.chosen, *parameters.others):
        for message, remedy in _faults(thing):
            notes.error(0, thing.name, message, remedy)
    for axis in parameters.axes:
        for message, remedy in _axis_faults(axis, used):
            notes.error(0, axis.name, message, remedy)
    notes.settle()


def _repeated(names: list[str]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []


def _faults(thing: Parameter | Text) -> Iterator[tuple[str, str]]:
    yield from _name_faults(thing.name)
    if any(map(holds_control_characters, (thing.variant, *thing.functions))) or '"' in "".join(thing.functions):
        yield "DCM cannot hold line breaks in a variant, or quotes in a function", "Rename it."
    if isinstance(thing, Text):
        if holds_control_characters(thing.text):
            yield "DCM cannot hold a text with line breaks or control characters", "Write it as .json."
    elif thing.kind == "rbf":
        yield "DCM cannot hold an expansion in radial basis functions", "Write it as .json."
    elif thing.kind not in _KEYWORDS or thing.values.ndim > 2:
        yield f"DCM cannot hold a {thing.kind} of {thing.values.ndim} dimensions", "Write it as .json."
    elif thing.size == 0:
        yield "DCM cannot hold a block without values", "Write it as .json."
    elif not np.isfinite(thing.values).all():
        yield "DCM cannot hold values that are not finite", "Give it values, or write it as .json."


def _name_faults(name: str) -> Iterator[tuple[str, str]]:
    if not _NAME.fullmatch(name) or holds_control_characters(name):
        yield f"{name!r} cannot be a name in DCM: it must be one word without quotes", "Rename it."


def _axis_faults(axis: Axis, used: set[str]) -> Iterator[tuple[str, str]]:
    if axis.name not in used:
        yield from _name_faults(axis.name)
    elif axis.name != axis.name.strip() or holds_control_characters(axis.name):
        yield f"{axis.name!r} cannot be the name of a group axis in DCM: blanks around it are lost", "Rename it."


def thing_block(thing: Parameter | Text, variants: Iterable[Parameter | Text] = ()) -> str:
    """The block of a parameter or text, ending in a line feed; `variants` are further values of a single one."""
    body = _text_body(thing) if isinstance(thing, Text) else _parameter_body(thing)
    values = [f"   {variant_line(other)}" for other in variants]
    return "\n".join([*body, *values, "END", ""])


def variant_line(other: Parameter | Text) -> str:
    """The value of another variant: `VAR VariantA=27.5`."""
    value = quoted(other.text) if isinstance(other, Text) else repr(float(other.values))
    return f"VAR {other.variant}={value}"


def _parameter_body(member: Parameter) -> Iterator[str]:
    group = "GRUPPEN" if any(axis.name for axis in member.axes) else ""
    sizes = " @ ".join(map(str, member.values.shape)) if isinstance(member, Block) else _sizes(member.axes)
    yield f"{group}{_KEYWORDS[member.kind]} {member.name} {sizes}".rstrip()
    yield from _labels(member)
    yield from (f"   EINHEIT_{letter} {quoted(axis.unit)}" for letter, axis in _directions(member))
    yield f"   EINHEIT_W {quoted(member.unit)}"
    yield from (f"*SST{letter}\t{axis.name}" for letter, axis in _directions(member) if axis.name)
    yield from _numbers_of(member)


def _labels(thing: Parameter | Text) -> Iterator[str]:
    yield f"   LANGNAME {quoted(thing.description)}"
    if thing.functions:
        yield f"   FUNKTION {' '.join(map(_word, thing.functions))}"
    if thing.display_name:
        yield f"   DISPLAYNAME {_word(thing.display_name)}"
    if thing.variant:
        yield f"   VAR {thing.variant}"


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


def _text_body(text: Text) -> Iterator[str]:
    yield f"{'TEXTSTRING' if text.kind == 'text' else 'FESTWERT'} {text.name}"
    yield from _labels(text)
    if text.unit or text.kind != "text":
        yield f"   EINHEIT_W {quoted(text.unit)}"
    yield f"   TEXT {quoted(text.text)}"


def axis_block(axis: Axis) -> str:
    """The block of a group axis, ending in a line feed."""
    lines = [f"STUETZSTELLENVERTEILUNG {axis.name} {len(axis)}", "*SST", '   LANGNAME ""']
    lines += [f"   EINHEIT_X {quoted(axis.unit)}", *_numbers("ST/X", axis.breakpoints)]
    return "\n".join([*lines, "END", ""])


def _directions(member: Parameter) -> Iterable[tuple[str, Axis]]:
    return zip(_LETTERS, member.axes, strict=False)


def _sizes(axes: tuple[Axis, ...]) -> str:
    return " ".join(str(len(axis)) for axis in axes)


def quoted(text: str) -> str:
    """A text between quotes, on one line."""
    escaped = one_line(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
