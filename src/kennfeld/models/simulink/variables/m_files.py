"""Functions in files: `name.m` beside the model, in its folders, or among the parameters; enumerations as well.

They are read, never run.

Parameter scripts and the code in a model's callbacks: followed, never executed.

Expressions that only numbers can tell, and scripts: by the evaluator of MATLAB, which executes nothing.

Enumerations: names for whole numbers, from class files and data dictionaries.

To an expression they are fixed values called `Class.Member`.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.matlab import syntax as m
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.evaluator import evaluate, free_names
from kennfeld.matlab.functions import NUMERIC_FUNCTIONS
from kennfeld.matlab.parser import parse_leniently, parse_script
from kennfeld.matlab.script_runner import Files, run_script
from kennfeld.matlab.simulink_objects import ENUMERATION, LookupTable, to_calibration_parameter
from kennfeld.matlab.values import MatlabCell, MatlabStruct, text
from kennfeld.matlab.values import Value as MatlabValue
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.simulink.reader.section_tree import SectionNode
from kennfeld.models.simulink.variables.mask_scope import (
    USER_SOURCE,
    ParameterValue,
    Variable,
    VariableTable,
    equal_values,
)

__all__ = [
    "EvaluationFailure",
    "FunctionFiles",
    "enumerals",
    "enumeration_file",
    "enumeration_of",
    "evaluate_numerically",
    "read_file",
    "run_mask_code",
    "run_parameter_script",
    "run_text",
    "variable_of",
]

_REST = re.compile(r"%.*|\.\.\..*")
_HEAD = re.compile(r"\s*classdef\s*(?:\([^)]*\))?\s*(\w+)\s*(?:<\s*([\w.]+))?")
_OPENS, _ENDS = re.compile(r"\s*enumeration\b\s*(?:\([^)]*\))?"), re.compile(r"\s*end\b")
_MEMBER = re.compile(r"([A-Za-z]\w*)\s*(?:\(\s*([^()]*(?:\([^()]*\))?)\s*\))?")
_CAST = re.compile(r"\s*(?:u?int\d+|double|single|logical)\s*\((.*)\)\s*\Z")
_BASES = ("Simulink.IntEnumType", "Simulink.Mask.EnumerationBase", "double", "single", "logical")
_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_LARGEST = 1_000_000  # characters of a class file

_LARGEST_FILE = 2_000_000  # bytes

_SCRIPT_NAME = re.compile(r"[\w.-]{1,128}\Z")


def is_class(text: str) -> bool:
    """Whether a text of MATLAB defines a class."""
    return bool(_HEAD.match(_plain_enumeration(text)))


def enumeration_of(text: str) -> tuple[str, dict[str, float]] | None:
    r"""The name and the members of an enumeration class; None where it is another class, or a value is no number.

    >>> enumeration_of("classdef Gear < Simulink.IntEnumType\nenumeration\nFirst(1), Second(2)\nend\nend")
    ('Gear', {'First': 1.0, 'Second': 2.0})
    """
    plain = _plain_enumeration(text)
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


def _plain_enumeration(text: str) -> str:
    """A text without comments and line ends that go on."""
    return "\n".join(_REST.sub("", line) for line in text[:_LARGEST].splitlines()).lstrip("\ufeff \t\r\n")


def _number(written: str | None) -> float | None:
    cast = _CAST.match(written or "")
    try:
        return float(cast[1] if cast else written or "")
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get((written or "").strip())


def enumerals(definition: SectionNode) -> dict[str, float]:
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


def enumeration_file(folder: Path, name: str) -> Variable | None:
    """The enumeration in the class file of a name beside a model; None where there is none."""
    path = folder / f"{name}.m"
    if not _NAME.match(name) or not path.is_file() or path.stat().st_size > _LARGEST:
        return None
    found = enumeration_of(path.read_bytes().decode("utf-8", "replace"))
    return variable_of(found[1], path.name) if found is not None and found[0] == name else None


class FunctionFiles:
    """Functions and enumerations by the names of their files; `given` are files that are named one by one."""

    def __init__(self, folders: Iterable[Path], given: Iterable[Path] = ()) -> None:
        self._given = {path.stem: path for path in given if path.suffix == ".m"}
        self._folders = tuple(folders)
        self._read: dict[str, Mapping[str, m.FunctionDefinition]] = {}
        self._enumerations: dict[str, Variable | None] = {}

    def find(self, name: str) -> Mapping[str, m.FunctionDefinition]:
        """The functions of the file that is called `name.m`, its first one by that name; none of a script."""
        if name not in self._read:
            path = self._path(name)
            self._read[name] = _functions(path) if path is not None else {}
        return self._read[name]

    def enumeration(self, name: str) -> Variable | None:
        """The enumeration in the class file of a name; None where there is none."""
        if name not in self._enumerations:
            found = (enumeration_file(folder, name) for folder in self._folders)
            self._enumerations[name] = next((one for one in found if one is not None), None)
        return self._enumerations[name]

    def _path(self, name: str) -> Path | None:
        if not _NAME.match(name):
            return None
        places = [self._given[name]] if name in self._given else [folder / f"{name}.m" for folder in self._folders]
        return next((path for path in places if path.is_file()), None)


def _functions(path: Path) -> Mapping[str, m.FunctionDefinition]:
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise ProgramError(f"the file {path.name} is too large for a function")
        text = path.read_bytes().decode("utf-8", "replace")
        if is_class(text):
            return {}
        script = parse_script(text, path.name)
    except OSError as error:
        raise ProgramError(f"the file {path.name} cannot be read: {error.strerror or error}") from None
    except InputError as error:
        raise ProgramError(str(error.findings[0])) from None
    if not script.functions or script.statements:
        return {}
    return {**{one.name: one for one in script.functions}, path.stem: script.functions[0]}


class Evaluated(NamedTuple):
    """The value of an expression, and the variables that it took."""

    value: ParameterValue
    names: tuple[str, ...]


class EvaluationFailure(NamedTuple):
    """Why an expression has no value, and the variable that nothing gives one, if that is why."""

    why: str
    undefined: str = ""


def evaluate_numerically(
    tree: m.Expression, variable: Callable[[str], ParameterValue | None]
) -> Evaluated | EvaluationFailure:
    """The value of an expression over the variables that `variable` gives, or why it has none."""
    given = {name: value for name in sorted(free_names(tree)) if (value := variable(name)) is not None}
    try:
        found = known(evaluate(tree, given, {"get_param": _asked, "eval": _meant}))
    except MatlabError as error:
        missing = [name for name in sorted(free_names(tree)) if name not in given and name not in NUMERIC_FUNCTIONS]
        return EvaluationFailure(error.findings[0].message, missing[0] if missing else "")
    return (
        Evaluated(found, tuple(given))
        if found is not None
        else EvaluationFailure("its value is neither numbers nor text")
    )


def run_mask_code(code: str, variable: Callable[[str], ParameterValue | None]) -> dict[str, ParameterValue]:
    """The variables that a text of MATLAB makes of those that `variable` gives."""
    script, _ = parse_leniently(code)
    wanted = sorted(_taken(script.statements))
    given = {name: value for name in wanted if (value := variable(name)) is not None}
    outcome = run_script(code, "mask", given, functions={"get_param": _asked, "eval": _meant})
    values = {name: known(value) for name, value in outcome.variables.items()}
    return {name: value for name, value in values.items() if value is not None}


def _asked(holder: MatlabValue, key: MatlabValue) -> MatlabValue:
    """A text that a model says of itself."""
    said = holder.fields.get(text(key)) if isinstance(holder, MatlabStruct) else None
    if said is None:
        raise MatlabError.at(
            "mask", m.SourcePosition(), f"get_param asks for {text(key)[:40]}, which only Simulink can tell"
        )
    return said


def _meant(written: MatlabValue) -> MatlabValue:
    """The value of an expression without variables."""
    return evaluate(text(written))


def _taken(statements: object) -> frozenset[str]:
    """All names in statements."""
    if isinstance(statements, m.Expression):
        return free_names(statements)
    if isinstance(statements, tuple):
        return frozenset().union(*map(_taken, statements))
    if is_dataclass(statements):
        return frozenset().union(*(_taken(getattr(statements, one.name)) for one in fields(statements)))
    return frozenset()


def known(value: Any) -> ParameterValue | None:
    """A value of MATLAB as blocks use it; None for what they cannot."""
    found = to_variable(value, "")
    return found.value if found is not None else None


def to_variable(value: Any, source: str) -> Variable | None:
    """A variable with the limits, unit and description that an object has."""
    meant = to_calibration_parameter(value)
    if meant is not None:
        held: ParameterValue = (
            _table(meant) if isinstance(meant, LookupTable) else np.asarray(meant.value, dtype=np.float64)
        )
        made = Variable(held, unit=meant.unit, description=meant.description, source=source)
        return made.limited(meant.min, meant.max)
    plain = _plain(value)
    fixed = isinstance(value, MatlabStruct) and value.kind == ENUMERATION
    return Variable(plain, source=source, fixed=fixed) if plain is not None else None


def _table(meant: LookupTable) -> dict[str, ParameterValue]:
    points = {f"Breakpoints{i + 1}": np.asarray(one.value) for i, one in enumerate(meant.breakpoints)}
    return {"Table": np.asarray(meant.value, dtype=np.float64), **points}


def _plain(value: Any) -> ParameterValue | None:
    if isinstance(value, MatlabStruct):
        return _struct(value)
    if isinstance(value, MatlabCell):
        parts = [known(part) for part in value.values.ravel(order="F")]
        return tuple(part for part in parts if part is not None)
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.kind == "U":
        return "".join(value.ravel())
    if value.dtype.kind == "O":
        return str(value.ravel()[0]) if value.size == 1 else tuple(map(str, value.ravel(order="F")))
    return np.asarray(value, dtype=np.float64)


def _struct(value: MatlabStruct) -> ParameterValue:
    elements = [
        {name: part for name, inner in one.items() if (part := known(inner)) is not None}
        for one in value.elements.ravel(order="F")
    ]
    return elements[0] if len(elements) == 1 else tuple(elements)


def run_parameter_script(found: VariableTable, path: Path) -> None:
    """Add the variables that a script makes; raises `InputError` where it cannot be read."""
    text = read_file(path).decode("utf-8", "replace")
    if is_class(text):
        _enumeration(found, text, path)
    else:
        run_text(found, text, path.name, path.parent)


def _enumeration(found: VariableTable, text: str, path: Path) -> None:
    made = enumeration_of(text)
    if made is None:
        raise InputError.of(path.name, "is a class, and none of whole numbers", "Give scripts and enumerations.")
    found[made[0]] = variable_of(made[1], path.name)


def run_text(found: VariableTable, text: str, name: str, folder: Path) -> None:
    """Add the variables that a text of MATLAB makes; those that it leaves without a value lose the one they had.

    What is given by name stays, so that it can stand in for what a script cannot say. Files that it loads are looked
    for in `folder` alone.
    """
    given = {key: variable.value for key, variable in found.items()}
    outcome = run_script(text, name, given, _beside(folder))
    found.findings += [replace(one, severity="warning") for one in outcome.findings]
    for key, value in outcome.variables.items():
        made = to_variable(value, name)
        if made is None:
            found.findings.append(Finding(f"{name} {key}", "it is of a kind that is not supported", severity="warning"))
            continue
        before = found.get(key)
        if before is None or not equal_values(before.value, made.value):
            found[key] = _commented(made, outcome.comments.get(key, ""))
    for key, why in outcome.undefined.items():
        found.undefined[key] = why
        if key in found and found[key].source != USER_SOURCE:
            del found[key]


def _commented(made: Variable, comment: str) -> Variable:
    return made if made.description or not comment else replace(made, description=comment)


def _beside(folder: Path) -> Files:
    def found(name: str) -> bytes | None:
        path = folder / name
        return read_file(path) if _SCRIPT_NAME.match(name) and path.is_file() else None

    return found


def read_file(path: Path) -> bytes:
    """What a file holds; raises `InputError` where it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
        remedy = nearest(path.name, beside) or "Check the path."
        raise InputError.of(str(path), "there is no such file", remedy) from None
    except OSError as error:
        raise InputError.of(str(path), f"the file cannot be read: {error.strerror or error}") from None
