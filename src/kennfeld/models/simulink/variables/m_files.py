"""MATLAB files: parameter scripts, mask code, enumerations and functions, interpreted but never executed.

Functions are files `name.m` next to the model, in its folders or among the parameters. Enumeration members are fixed
values named `Class.Member`. Expressions that need numbers are evaluated by the MATLAB evaluator.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.errors import Finding, InputError, Location, Severity
from kennfeld.file_errors import convert_errors
from kennfeld.matlab import syntax as m
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.evaluator import evaluate
from kennfeld.matlab.functions import NUMERIC_FUNCTIONS
from kennfeld.matlab.parser import parse_leniently, parse_script
from kennfeld.matlab.script_runner import run_script
from kennfeld.matlab.simulink_objects import ENUMERATION, LookupTable, to_calibration_parameter
from kennfeld.matlab.traversal import names_read
from kennfeld.matlab.values import MatlabCell, MatlabStruct, text
from kennfeld.matlab.values import Value as MatlabValue
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.simulink.reader.section_tree import SectionNode
from kennfeld.models.simulink.variables.mask_scope import (
    USER_SOURCE,
    ParameterValue,
    Variable,
    VariableTable,
    equal_values,
)

_REST = re.compile(r"%.*|\.\.\..*")
_HEAD = re.compile(r"\s*classdef\s*(?:\([^)]*\))?\s*(\w+)\s*(?:<\s*([\w.]+))?")
_OPENS, _ENDS = re.compile(r"\s*enumeration\b\s*(?:\([^)]*\))?"), re.compile(r"\s*end\b")
_MEMBER = re.compile(r"([A-Za-z]\w*)\s*(?:\(\s*([^()]*(?:\([^()]*\))?)\s*\))?")
_CAST = re.compile(r"\s*(?:u?int\d+|double|single|logical)\s*\((.*)\)\s*\Z")
_BASES = ("Simulink.IntEnumType", "Simulink.Mask.EnumerationBase", "double", "single", "logical")
_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_MAX_CLASS_CHARACTERS = 1_000_000  # in a class file

_MAX_FILE_BYTES = 2_000_000  # bytes

_SCRIPT_NAME = re.compile(r"[\w.-]{1,128}\Z")


def is_class(text: str) -> bool:
    """Return True if MATLAB code defines a class."""
    return bool(_HEAD.match(_plain_enumeration(text)))


def enumeration_of(text: str) -> tuple[str, dict[str, float]] | None:
    r"""Return name and members of an enumeration class, None for other classes and non-numeric members.

    >>> enumeration_of("classdef Gear < Simulink.IntEnumType\nenumeration\nFirst(1), Second(2)\nend\nend")
    ('Gear', {'First': 1.0, 'Second': 2.0})
    """
    plain = _plain_enumeration(text)
    head = _HEAD.match(plain)
    if head is None or not (head[2] in _BASES or re.match(r"u?int\d+\Z", head[2] or "")):
        return None
    members: dict[str, float] = {}
    for match in _MEMBER.finditer(_listed(plain)):
        value = _number(match[2])
        if value is None:
            return None
        members[match[1]] = value
    return (head[1], members) if members else None


def _listed(plain: str) -> str:
    """Return the text between `enumeration` and `end`, of all such sections."""
    members: list[str] = []
    inside = False
    for line in plain.splitlines():
        opens = _OPENS.match(line) if not inside else None
        inside = (inside or opens is not None) and not _ENDS.match(line)
        if inside:
            members.append(line[opens.end() :] if opens is not None else line)
    return "\n".join(members)


def _plain_enumeration(text: str) -> str:
    """Return a text without comments and line continuations."""
    return "\n".join(_REST.sub("", line) for line in text[:_MAX_CLASS_CHARACTERS].splitlines()).lstrip("\ufeff \t\r\n")


def _number(written: str | None) -> float | None:
    cast = _CAST.match(written or "")
    try:
        return float(cast[1] if cast else written or "")
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get((written or "").strip())


def enumerals(definition: SectionNode) -> dict[str, float]:
    """Return the members of a dictionary enumeration that have numbers."""
    members: dict[str, float] = {}
    for part in definition.every():
        said = {inner.keys.get("Name", ""): inner.text.strip() for inner in part.all("P")}
        value = _number(said.get("Value"))
        if said.get("Name") and value is not None:
            members[said["Name"]] = value
    return members


def variable_of(members: Mapping[str, float], source: str) -> Variable:
    """Return an enumeration as a struct of fixed values."""
    return Variable({name: np.array([[value]]) for name, value in members.items()}, source=source, fixed=True)


def enumeration_file(folder: Path, name: str) -> Variable | None:
    """Return the enumeration in the class file of a name next to a model, None if there is none."""
    path = folder / f"{name}.m"
    if not _NAME.match(name) or not path.is_file() or path.stat().st_size > _MAX_CLASS_CHARACTERS:
        return None
    enumeration = enumeration_of(path.read_bytes().decode("utf-8", "replace"))
    return variable_of(enumeration[1], path.name) if enumeration is not None and enumeration[0] == name else None


class FunctionFiles:
    """Functions and enumerations by file name; `files` are individually named ones."""

    def __init__(self, folders: Iterable[Path], files: Iterable[Path] = ()) -> None:
        self._files = {path.stem: path for path in files if path.suffix == ".m"}
        self._folders = tuple(folders)
        self._read: dict[str, Mapping[str, m.FunctionDefinition]] = {}
        self._enumerations: dict[str, Variable | None] = {}

    def find(self, name: str) -> Mapping[str, m.FunctionDefinition]:
        """Return the functions of the file `name.m`, its first one under that name; {} for a script."""
        if name not in self._read:
            path = self._path(name)
            self._read[name] = _functions(path) if path is not None else {}
        return self._read[name]

    def enumeration(self, name: str) -> Variable | None:
        """Return the enumeration in the class file of a name, None if there is none."""
        if name not in self._enumerations:
            candidates = (enumeration_file(folder, name) for folder in self._folders)
            self._enumerations[name] = next((variable for variable in candidates if variable is not None), None)
        return self._enumerations[name]

    def _path(self, name: str) -> Path | None:
        if not _NAME.match(name):
            return None
        places = [self._files[name]] if name in self._files else [folder / f"{name}.m" for folder in self._folders]
        return next((path for path in places if path.is_file()), None)


def _functions(path: Path) -> Mapping[str, m.FunctionDefinition]:
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
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
    return {**{function.name: function for function in script.functions}, path.stem: script.functions[0]}


def evaluate_numerically(
    tree: m.Expression, variable: Callable[[str], ParameterValue | None]
) -> tuple[ParameterValue, tuple[str, ...]]:
    """Return the value of an expression and the variables it uses, over those that `variable` returns.

    Raises:
        EvaluationError: if the expression has no value.
    """
    values = {name: value for name in sorted(names_read(tree)) if (value := variable(name)) is not None}
    try:
        result = supported_value(evaluate(tree, values, {"get_param": _get_param, "eval": _evaluate_text}))
    except MatlabError as error:
        missing = [name for name in sorted(names_read(tree)) if name not in values and name not in NUMERIC_FUNCTIONS]
        raise EvaluationError(error.findings[0].message, missing[0] if missing else "") from None
    if result is None:
        raise EvaluationError("its value is neither numeric nor text")
    return result, tuple(values)


def run_mask_code(code: str, variable: Callable[[str], ParameterValue | None]) -> dict[str, ParameterValue]:
    """Return the variables that mask code assigns, given those that `variable` returns."""
    script, _ = parse_leniently(code)
    wanted = sorted(names_read(script.statements))
    known_values = {name: value for name in wanted if (value := variable(name)) is not None}
    outcome = run_script(code, "mask", known_values, functions={"get_param": _get_param, "eval": _evaluate_text})
    values = {name: supported_value(value) for name, value in outcome.variables.items()}
    return {name: value for name, value in values.items() if value is not None}


def _get_param(holder: MatlabValue, key: MatlabValue) -> MatlabValue:
    said = holder.fields.get(text(key)) if isinstance(holder, MatlabStruct) else None
    if said is None:
        raise MatlabError.at("mask", m.SourcePosition(), f"get_param({text(key)[:40]}) requires Simulink")
    return said


def _evaluate_text(written: MatlabValue) -> MatlabValue:
    """Return the value of an expression without variables."""
    return evaluate(text(written))


def supported_value(value: Any) -> ParameterValue | None:
    """Return a MATLAB value as a block parameter, None if unsupported."""
    variable = to_variable(value, "")
    return variable.value if variable is not None else None


def to_variable(value: Any, source: str) -> Variable | None:
    """Return a variable with the limits, unit and description of its object."""
    meant = to_calibration_parameter(value)
    if meant is not None:
        parameter_value: ParameterValue = (
            _table(meant) if isinstance(meant, LookupTable) else np.asarray(meant.value, dtype=np.float64)
        )
        variable = Variable(parameter_value, unit=meant.unit, description=meant.description, source=source)
        return variable.limited(meant.min, meant.max)
    plain = _plain(value)
    fixed = isinstance(value, MatlabStruct) and value.kind == ENUMERATION
    return Variable(plain, source=source, fixed=fixed) if plain is not None else None


def _table(meant: LookupTable) -> dict[str, ParameterValue]:
    points = {f"Breakpoints{i + 1}": np.asarray(item.value) for i, item in enumerate(meant.breakpoints)}
    return {"Table": np.asarray(meant.value, dtype=np.float64), **points}


def _plain(value: Any) -> ParameterValue | None:
    if isinstance(value, MatlabStruct):
        return _struct(value)
    if isinstance(value, MatlabCell):
        parts = [supported_value(part) for part in value.values.ravel(order="F")]
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
        {name: part for name, inner in element.items() if (part := supported_value(inner)) is not None}
        for element in value.elements.ravel(order="F")
    ]
    return elements[0] if len(elements) == 1 else tuple(elements)


def run_parameter_script(variables: VariableTable, path: Path) -> None:
    """Run a parameter script and add its variables to `variables`; raise `InputError` if it cannot be read."""
    text = read_file(path).decode("utf-8", "replace")
    if not is_class(text):
        run_text(variables, text, path.name, path.parent)
    elif (enumeration := enumeration_of(text)) is not None:
        variables[enumeration[0]] = variable_of(enumeration[1], path.name)
    else:
        message = "is a class, but not an enumeration of integers"
        raise InputError.of(Location(path.name), message, "Use scripts and enumerations.")


def run_text(variables: VariableTable, text: str, name: str, folder: Path) -> None:
    """Run MATLAB code and add its variables to `variables`; variables it leaves without a value are removed.

    Variables given by the user stay, so that they can replace what a script cannot compute. Files are loaded from
    `folder` only.
    """
    values = {key: variable.value for key, variable in variables.items()}
    outcome = run_script(text, name, values, partial(_load_file, folder))
    for finding in outcome.findings:  # a script skips plots, and what follows an error
        severity: Severity = "warning" if finding.severity == "warning" else "remark"
        variables.findings.append(replace(finding, severity=severity))
    for key, value in outcome.variables.items():
        result = to_variable(value, name)
        if result is None:
            variables.findings.append(
                Finding(Location(name, path=key), "its type is not supported", severity="warning")
            )
            continue
        before = variables.get(key)
        if before is None or not equal_values(before.value, result.value):
            comment = result.description or outcome.comments.get(key, "")
            variables[key] = replace(result, description=comment)
    for key, why in outcome.undefined.items():
        variables.undefined[key] = why
        if key in variables and variables[key].source != USER_SOURCE:
            del variables[key]


def _load_file(folder: Path, name: str) -> bytes | None:
    path = folder / name
    return read_file(path) if _SCRIPT_NAME.match(name) and path.is_file() else None


def read_file(path: Path) -> bytes:
    """Return the content of a file; raise `InputError` if it cannot be read."""
    with convert_errors(path, "the file cannot be read", missing="file not found", advice="Check the path."):
        return path.read_bytes()
