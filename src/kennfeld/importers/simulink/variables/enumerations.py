"""Enumerations as variables: members of class files and dictionary definitions, each a fixed integer."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from kennfeld.base.file_state import note_opened
from kennfeld.importers.simulink.reader.section_tree import SectionNode
from kennfeld.importers.simulink.variables.mask_scope import Variable
from kennfeld.matlab.enumerations import MAX_CHARACTERS, enumeration_of, is_class, number_of

_MAX_HEAD_BYTES = 4096  # in which the word classdef stands


def enumerals(definition: SectionNode) -> dict[str, float]:
    """Collect the members of a dictionary enumeration that have numbers."""
    members: dict[str, float] = {}
    for part in definition.every():
        properties = {inner.keys.get("Name", ""): inner.text.strip() for inner in part.all("P")}
        value = number_of(properties.get("Value"))
        if properties.get("Name") and value is not None:
            members[properties["Name"]] = value
    return members


def enumeration_variable(members: Mapping[str, float], source: str) -> Variable:
    """Return an enumeration as a struct of fixed values."""
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
    """Return the number of a member that is named without its class, None if it is unknown or ambiguous."""
    numbers = {members[name] for variable in variables.values() if name in (members := members_of(variable))}
    return numbers.pop() if len(numbers) == 1 else None


def enumeration_files(folders: Iterable[Path], files: Iterable[Path] = ()) -> dict[str, Variable]:
    """Return the enumerations by name whose class files are in the folders or among the files.

    A class in an earlier folder takes precedence, one among the files over all folders.
    """
    paths = [*files, *(path for folder in folders for path in _scripts(folder))]
    enumerations: dict[str, Variable] = {}
    for path in paths:
        if path.stem not in enumerations and (text := _class_text(path)):
            enumeration = enumeration_of(text)
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
            rest = stream.read(MAX_CHARACTERS) if b"classdef" in head else b""
    except OSError:
        return ""
    text = (head + rest).decode("utf-8", "replace")
    return text if is_class(text) else ""
