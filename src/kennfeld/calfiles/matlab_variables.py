"""Parameters as MATLAB variables, for scripts (.m) and data files (.mat) alike: what `matlab_values` reads."""

import re
from collections.abc import Iterator, Mapping

import numpy as np

from kennfeld.calfiles.matlab_values import INFO, Struct, Value
from kennfeld.parameters import Parameter, ParameterSet, Text

__all__ = ["variables_of"]

_LETTERS = "xyzw"


def variables_of(parameters: ParameterSet) -> Iterator[tuple[str, Value]]:
    """A variable for each group axis, parameter and text; `kennfeld_info` says more about those that are plain."""
    names = _Names()
    for axis in parameters.axes:
        name, called = names.of(axis.name)
        said = {"kind": "axis", "name": called, "x_unit": axis.unit, "x_input": axis.input}
        yield name, Struct({**_given(said), "x": axis.breakpoints})
    info: dict[str, Value] = {}
    for thing in (*parameters.chosen, *parameters.others):
        name, called = names.of(thing.name)
        labels = _labels_of(thing)
        value = _plain_value(thing)
        if value is None or called or thing.variant:
            yield name, _struct_of(thing, {"name": called, **labels})
        else:
            yield name, value
            if labels:
                info[name] = Struct(labels)
    if info:
        yield INFO, Struct(info)


_WORDS = "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return"
_TAKEN = frozenset(f"{_WORDS} spmd switch try while {INFO} Inf NaN reshape char ans".split())
_LONGEST = 63


class _Names:
    """Names that MATLAB can have, each once."""

    def __init__(self) -> None:
        self.used = set(_TAKEN)

    def of(self, wanted: str) -> tuple[str, str]:
        """The name of a variable, and what it is called truly where that is something else."""
        if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", wanted) and len(wanted) <= _LONGEST and wanted not in self.used:
            self.used.add(wanted)
            return wanted, ""
        plain = re.sub(r"[^A-Za-z0-9_]", "_", wanted)[: _LONGEST - 8]
        plain = plain if re.match(r"[A-Za-z]", plain) else f"p{plain}"
        made, count = plain, 1
        while made in self.used:
            count += 1
            made = f"{plain}_{count}"
        self.used.add(made)
        return made, wanted


def _given(said: Mapping[str, str]) -> dict[str, Value]:
    return {key: word for key, word in said.items() if word}


def _labels_of(thing: Parameter | Text) -> dict[str, Value]:
    kind = thing.kind if isinstance(thing, Text) and thing.kind != "text" else ""
    words = {
        "unit": thing.unit,
        "kind": kind,
        "description": thing.description,
        "display_name": thing.display_name,
        "variant": thing.variant,
    }
    functions: dict[str, Value] = {"functions": list(thing.functions)} if thing.functions else {}
    return _given(words) | functions


def _plain_value(thing: Parameter | Text) -> "Value | None":
    """What a variable without fields can say; None where it takes a struct."""
    if isinstance(thing, Text):
        return thing.text
    shape = thing.values.shape
    if thing.axes or (
        thing.kind == "block" and (thing.size == 1 or (len(shape) > 1 and (1 in shape[:2] or shape[-1] == 1)))
    ):
        return None
    return thing.values


def _struct_of(thing: Parameter | Text, labels: dict[str, Value]) -> Struct:
    fields = {key: label for key, label in labels.items() if label}
    if isinstance(thing, Text):
        return Struct({**fields, "text": thing.text})
    for letter, axis in zip(_LETTERS, thing.axes, strict=False):
        fields[letter] = axis.breakpoints
        said = {f"{letter}_name": axis.name, f"{letter}_unit": axis.unit, f"{letter}_input": axis.input}
        fields |= _given(said)
    if thing.kind == "block":
        fields["size"] = np.array(thing.values.shape, dtype=np.float64)
    return Struct({**fields, "value" if thing.kind == "scalar" else "values": thing.values})
