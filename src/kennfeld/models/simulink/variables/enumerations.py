"""Enumerations: names for whole numbers, from class files and data dictionaries.

To an expression they are fixed values called `Class.Member`.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kennfeld.models.simulink.files.section import Section
from kennfeld.models.simulink.variables.scopes import Variable

__all__ = ["beside", "enumerals", "enumeration_of", "is_class", "variable_of"]

_REST = re.compile(r"%.*|\.\.\..*")
_HEAD = re.compile(r"\s*classdef\s*(?:\([^)]*\))?\s*(\w+)\s*(?:<\s*([\w.]+))?")
_OPENS, _ENDS = re.compile(r"\s*enumeration\b\s*(?:\([^)]*\))?"), re.compile(r"\s*end\b")
_MEMBER = re.compile(r"([A-Za-z]\w*)\s*(?:\(\s*([^()]*(?:\([^()]*\))?)\s*\))?")
_CAST = re.compile(r"\s*(?:u?int\d+|double|single|logical)\s*\((.*)\)\s*\Z")
_BASES = ("Simulink.IntEnumType", "Simulink.Mask.EnumerationBase", "double", "single", "logical")
_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_LARGEST = 1_000_000  # characters of a class file


def is_class(text: str) -> bool:
    """Whether a text of MATLAB defines a class."""
    return bool(_HEAD.match(_plain(text)))


def enumeration_of(text: str) -> tuple[str, dict[str, float]] | None:
    r"""The name and the members of an enumeration class; None where it is another class, or a value is no number.

    >>> enumeration_of("classdef Gear < Simulink.IntEnumType\nenumeration\nFirst(1), Second(2)\nend\nend")
    ('Gear', {'First': 1.0, 'Second': 2.0})
    """
    plain = _plain(text)
    head = _HEAD.match(plain)
    if head is None or not (head[2] in _BASES or re.match(r"u?int\d+\Z", head[2] or "")):
        return None
    members: dict[str, float] = {}
    for found in _MEMBER.finditer(_listed(plain)):
        value = _number(found[2])
        if value is None:
            return None
        members[found[1]] = value
    return (head[1], members) if members else None


def _listed(plain: str) -> str:
    """What stands between `enumeration` and its `end`, of all such parts."""
    found: list[str] = []
    inside = False
    for line in plain.splitlines():
        opens = _OPENS.match(line) if not inside else None
        inside = (inside or opens is not None) and not _ENDS.match(line)
        if inside:
            found.append(line[opens.end() :] if opens is not None else line)
    return "\n".join(found)


def _plain(text: str) -> str:
    """A text without comments and line ends that go on."""
    return "\n".join(_REST.sub("", line) for line in text[:_LARGEST].splitlines()).lstrip("\ufeff \t\r\n")


def _number(written: str | None) -> float | None:
    cast = _CAST.match(written or "")
    try:
        return float(cast[1] if cast else written or "")
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get((written or "").strip())


def enumerals(definition: Section) -> dict[str, float]:
    """The members of an enumeration in a data dictionary; those without a number are left out."""
    found: dict[str, float] = {}
    for part in definition.every():
        said = {inner.keys.get("Name", ""): inner.text.strip() for inner in part.all("P")}
        value = _number(said.get("Value"))
        if said.get("Name") and value is not None:
            found[said["Name"]] = value
    return found


def variable_of(members: Mapping[str, float], source: str) -> Variable:
    """An enumeration as what an expression finds under its name."""
    return Variable({name: np.array([[value]]) for name, value in members.items()}, source=source, fixed=True)


def beside(folder: Path, name: str) -> Variable | None:
    """The enumeration in the class file of a name beside a model; None where there is none."""
    path = folder / f"{name}.m"
    if not _NAME.match(name) or not path.is_file() or path.stat().st_size > _LARGEST:
        return None
    found = enumeration_of(path.read_bytes().decode("utf-8", "replace"))
    return variable_of(found[1], path.name) if found is not None and found[0] == name else None
