"""Enumerations: members of class files and dictionary definitions, each a fixed integer."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.base.file_state import note_opened
from kennfeld.importers.simulink.reader.section_tree import SectionNode
from kennfeld.importers.simulink.variables.mask_scope import Variable
from kennfeld.matlab.evaluator import evaluate

_REST = re.compile(r"%.*|\.\.\..*")
_HEAD = re.compile(r"\s*classdef\s*(?:\([^)]*\))?\s*(\w+)\s*(?:<\s*([\w.]+))?")
_LISTS = re.compile(r"(?:^|[;,])\s*enumeration\b\s*(?:\([^)\n]*\))?(.*?)\bend\b", re.MULTILINE | re.DOTALL)
# `First`, `First(1)` or `First(uint8(min(1, 2)))`: brackets in up to three levels
_MEMBER = re.compile(r"([A-Za-z]\w*)\s*(?:\(((?:[^()]|\((?:[^()]|\([^()]*\))*\))*)\))?")
_BASES = ("Simulink.IntEnumType", "Simulink.Mask.EnumerationBase", "double", "single", "logical")
_INTEGER = re.compile(r"u?int\d+\Z")
_MAX_CLASS_CHARACTERS = 1_000_000  # in a class file
_MAX_HEAD_BYTES = 4096  # in which the word classdef stands


def is_class(text: str) -> bool:
    """Return True if MATLAB code defines a class."""
    return bool(_HEAD.match(_plain_class(text)))


def enumeration_of(text: str) -> tuple[str, dict[str, float]] | None:
    r"""Parse name and members of an enumeration class, None for other classes and non-numeric members.

    >>> enumeration_of("classdef Gear < Simulink.IntEnumType\nenumeration\nFirst(1), Second(2)\nend\nend")
    ('Gear', {'First': 1.0, 'Second': 2.0})
    """
    plain = _plain_class(text)
    head = _HEAD.match(plain)
    if head is None or not (head[2] in _BASES or _INTEGER.match(head[2] or "")):
        return None
    members: dict[str, float] = {}
    for match in _MEMBER.finditer("\n".join(section[1] for section in _LISTS.finditer(plain[head.end() :]))):
        value = _number(match[2])
        if value is None:
            return None
        members[match[1]] = value
    return (head[1], members) if members else None


def _plain_class(text: str) -> str:
    """Return a text without comments and line continuations."""
    return "\n".join(_REST.sub("", line) for line in text[:_MAX_CLASS_CHARACTERS].splitlines()).lstrip("\ufeff \t\r\n")


def _number(written: str | None) -> float | None:
    """Return the number of a member, which may be a cast or an expression of literals."""
    try:
        value = np.asarray(evaluate(written or ""), dtype=np.float64)
    except (InputError, TypeError, ValueError):
        return None
    return float(value.item()) if value.size == 1 else None


def enumerals(definition: SectionNode) -> dict[str, float]:
    """Collect the members of a dictionary enumeration that have numbers."""
    members: dict[str, float] = {}
    for part in definition.every():
        properties = {inner.keys.get("Name", ""): inner.text.strip() for inner in part.all("P")}
        value = _number(properties.get("Value"))
        if properties.get("Name") and value is not None:
            members[properties["Name"]] = value
    return members


def enumeration_variable(members: Mapping[str, float], source: str) -> Variable:
    """Represent an enumeration as a struct of fixed values."""
    return Variable({name: np.array([[value]]) for name, value in members.items()}, source=source, fixed=True)


def members_of(variable: Variable | None) -> Mapping[str, float]:
    """Return the members of a variable that is an enumeration, {} for any other."""
    if variable is None or not variable.fixed or not isinstance(variable.value, Mapping):
        return {}
    return {
        name: float(value.item())
        for name, value in variable.value.items()
        if isinstance(value, np.ndarray) and value.size == 1
    }


def unqualified_member(variables: Mapping[str, Variable], name: str) -> float | None:
    """Look up the number of a member that is named without its class, None if it is unknown or ambiguous."""
    numbers = {members[name] for variable in variables.values() if name in (members := members_of(variable))}
    # the same number in several enumerations is still unambiguous
    return numbers.pop() if len(numbers) == 1 else None


def enumeration_files(folders: Iterable[Path], files: Iterable[Path] = ()) -> dict[str, Variable]:
    """Read the enumerations by name whose class files are in the folders or among the files.

    A class in an earlier folder takes precedence, one among the files over all folders.
    """
    paths = [*files, *(path for folder in folders for path in _scripts(folder))]
    enumerations: dict[str, Variable] = {}
    for path in paths:
        if path.stem not in enumerations and (text := _class_text(path)):
            enumeration = enumeration_of(text)
            # MATLAB finds a class by the name of its file
            if enumeration is not None and enumeration[0] == path.stem:
                enumerations[path.stem] = enumeration_variable(enumeration[1], path.name)
    return enumerations


def _scripts(folder: Path) -> Iterator[Path]:
    note_opened(folder)
    try:
        yield from sorted(path for path in folder.iterdir() if path.suffix == ".m")
    except OSError:
        return


def _class_text(path: Path) -> str:
    """Return the text of a class file, "" for any other or an unreadable one."""
    note_opened(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(_MAX_HEAD_BYTES)
            # a folder may hold large scripts, of which the begin is enough
            rest = stream.read(_MAX_CLASS_CHARACTERS) if b"classdef" in head else b""
    except OSError:
        return ""
    text = (head + rest).decode("utf-8", "replace")
    return text if is_class(text) else ""
