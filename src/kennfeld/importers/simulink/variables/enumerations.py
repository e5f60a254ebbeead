"""Enumerations as variables: members of class files and dictionary definitions, each a fixed integer."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.base.file_state import note_opened
from kennfeld.base.formatting import join_names
from kennfeld.importers.simulink.reader.dialog_words import after_word
from kennfeld.importers.simulink.reader.section_tree import SectionNode
from kennfeld.importers.simulink.variables.mask_scope import Variable
from kennfeld.importers.simulink.variables.stored_variables import ENUMERATED
from kennfeld.matlab.enumerations import MAX_CHARACTERS, Enumeration, enumeration_of, is_class, number_of
from kennfeld.matlab.simulink_objects import with_default

_MAX_HEAD_BYTES = 4096  # in which the word classdef stands


def enumerals(definition: SectionNode) -> dict[str, float]:
    """Collect the members of a dictionary enumeration that have numbers, the default one first."""
    members: dict[str, float] = {}
    default = ""
    for part in definition.every():
        properties = {inner.keys.get("Name", ""): inner.text.strip() for inner in part.all("P")}
        value = number_of(properties.get("Value"))
        if properties.get("Name") and value is not None:
            members[properties["Name"]] = value
        default = properties.get("DefaultValue") or default
    return with_default(members, default.rpartition(".")[2])


def enumeration_variable(members: Mapping[str, float], source: str) -> Variable:
    """Return an enumeration as a struct of fixed values, its default first."""
    return Variable({name: np.array([[value]]) for name, value in members.items()}, source=source, fixed=True)


def class_variable(enumeration: Enumeration, source: str) -> Variable:
    """Return the enumeration of a class file; a description says what the file leaves open."""
    variable = enumeration_variable(enumeration.members, source)
    if not enumeration.counted:
        return variable
    numbers = join_names([f"{name} = {number:g}" for name, number in enumeration.members.items()], 4)
    return replace(variable, description=f"its members have no numbers; they are counted from 0 ({numbers})")


def members_of(variable: Variable | None) -> Mapping[str, float]:
    """Return the members of a variable that is an enumeration, {} for any other."""
    # other structs are parameters, field by field
    if variable is None or not variable.fixed or not isinstance(variable.value, Mapping):
        return {}
    return {
        name: float(value.item())
        for name, value in variable.value.items()
        if isinstance(value, np.ndarray) and value.size == 1
    }


def enumerated_type(written: str) -> str:
    """Return the class in a data type, "Enum: Mode" or "Mode"."""
    name = after_word(written, ENUMERATED)
    return written.strip() if name is None else name


def unqualified_member(variables: Mapping[str, Variable], name: str, types: Iterable[str] = ()) -> float | None:
    """Return the number of a member that is named without its class, None if it is unknown or ambiguous.

    The classes in `types`, those that a chart uses, take precedence over all others that are known.
    """
    # a folder holds the classes of many models, in which words such as Off occur again and again
    near = {kind: variables[kind] for kind in types if kind in variables}
    for classes in (near, variables):
        numbers = {members[name] for variable in classes.values() if name in (members := members_of(variable))}
        if numbers:
            return numbers.pop() if len(numbers) == 1 else None
    return None


def enumeration_files(folders: Iterable[Path], files: Iterable[Path] = ()) -> dict[str, Variable]:
    """Return the enumerations by name whose class files are in the folders or among the files.

    A class in an earlier folder takes precedence, one among the files over all folders.
    """
    paths = [*files, *(path for folder in folders for path in _scripts(folder))]
    enumerations: dict[str, Variable] = {}
    for path in paths:
        # MATLAB finds a class by the name of its file only
        if path.stem not in enumerations and (text := _class_text(path)):
            enumeration = enumeration_of(text)
            if enumeration is not None and enumeration.name == path.stem:
                enumerations[path.stem] = class_variable(enumeration, path.name)
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
