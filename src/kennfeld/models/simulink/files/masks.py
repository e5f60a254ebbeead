"""The mask of a block, in the three ways in which files have written it.

A `<Mask>` element (since R2016), an object of the class Simulink.Mask (since R2013), and before that one string for
all variables, one for all values, and so on.
"""

import re
from collections.abc import Iterable

from kennfeld.models.simulink.files.section import Section
from kennfeld.models.simulink.files.tree import Mask, MaskParameter

__all__ = ["mask_of"]

_BAR = re.compile(r"(?<!\\)\|")  # separates values; one that belongs to a value has a backslash before it
_VARIABLE = re.compile(r"\s*(\w+)\s*=\s*([@&])(\d+)\s*\Z")


def mask_of(block: Section) -> Mask | None:
    """The mask in a block's section; None where it has none."""
    instance = block.first("InstanceData")
    element = block.first("Mask") or (instance.first("Mask") if instance is not None else None)
    if element is not None:
        return _mask(element, element.all("MaskParameter"))
    made = next((p for p in block.parts if p.keys.get("PropName") == "MaskObject"), None)
    if made is not None:
        return _mask(made, _parameter_objects(made))
    return _flat(block) if block.keys.get("MaskVariables") or block.keys.get("MaskType") else None


def _mask(section: Section, parameters: Iterable[Section]) -> Mask:
    found = tuple(_parameter(part) for part in parameters)
    return Mask(section.get("Type"), found, section.get("Initialization"))


def _parameter_objects(mask: Section) -> list[Section]:
    """The objects of the parameters: one by itself, or several in an array."""
    found: list[Section] = []
    for part in mask.parts:
        if part.keys.get("PropName") == "Parameters":
            found += [inner for inner in part.parts if "Name" in inner.keys] if part.kind == "Array" else [part]
    return found


def _parameter(section: Section) -> MaskParameter:
    return MaskParameter(
        section.get("Name"),
        section.get("Value"),
        section.get("Type", "edit"),
        section.get("Evaluate", "on") != "off",
        section.get("Prompt"),
        _options(section),
    )


def _options(section: Section) -> tuple[str, ...]:
    """The choices of a popup: a list of its own, or an array."""
    arrays = (part for part in section.all("Array") if part.keys.get("PropName") == "TypeOptions")
    found = section.first("TypeOptions") or next(arrays, None)
    return tuple(part.text.strip() for part in found.parts) if found is not None else ()


def _flat(block: Section) -> Mask:
    keys = block.keys
    values = _split(keys.get("MaskValueString", ""))
    styles, choices = _styles(keys.get("MaskStyleString", ""))
    prompts = _split(keys.get("MaskPromptString", ""))
    parameters = []
    for variable in keys.get("MaskVariables", "").split(";"):
        found = _VARIABLE.match(variable)
        if found is None:
            continue
        at = int(found[3][:6]) - 1
        parameters.append(
            MaskParameter(
                found[1],
                _at(values, at),
                _at(styles, at) or "edit",
                found[2] == "@",
                _at(prompts, at),
                tuple(_split(_at(choices, at))) if _at(choices, at) else (),
            )
        )
    return Mask(keys.get("MaskType", ""), tuple(parameters), keys.get("MaskInitialization", ""))


def _split(text: str) -> list[str]:
    return [value.replace("\\|", "|") for value in _BAR.split(text)]


def _styles(text: str) -> tuple[list[str], list[str]]:
    """The kinds of the dialog's fields, and the choices of a popup, which stand in brackets behind its kind.

    >>> _styles("edit,popup(slow|fast),checkbox")
    (['edit', 'popup', 'checkbox'], ['', 'slow|fast', ''])
    """
    fields, depth = [""], 0
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            fields.append("")
        else:
            fields[-1] += character
    parts = [field.partition("(") for field in fields]
    return [kind.strip() for kind, _, _ in parts], [rest.removesuffix(")") for _, _, rest in parts]


def _at(texts: list[str], at: int) -> str:
    return texts[at] if 0 <= at < len(texts) else ""
