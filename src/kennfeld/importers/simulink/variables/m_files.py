"""MATLAB files: parameter scripts, mask code and functions, interpreted but never executed.

Functions are files `name.m` next to the model, in its folders or among the parameters. Expressions that need numbers
are evaluated by the MATLAB evaluator.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location, Severity
from kennfeld.base.file_state import note_opened
from kennfeld.base.output_paths import file_name
from kennfeld.importers.simulink.variables.enumerations import class_variable
from kennfeld.importers.simulink.variables.file_search import FileSearch, read_file
from kennfeld.importers.simulink.variables.mask_scope import (
    USER_SOURCE,
    ParameterValue,
    Variable,
    VariableTable,
    equal_values,
)
from kennfeld.importers.simulink.variables.stored_variables import StoredVariables, mat_variables
from kennfeld.matlab.enumerations import enumeration_of, is_class
from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.evaluator import evaluate
from kennfeld.matlab.functions import NUMERIC_FUNCTIONS
from kennfeld.matlab.parser import parse_leniently, parse_script
from kennfeld.matlab.script_runner import run_script
from kennfeld.matlab.simulink_objects import ENUMERATION, LookupTable, StructParameter, to_calibration_parameter
from kennfeld.matlab.simulink_types import BUS, BUS_ELEMENT, TYPE_CLASSES
from kennfeld.matlab.values import MatlabCell, MatlabStruct, StructArray, from_python, object_array, text
from kennfeld.matlab.values import Value as MatlabValue
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.program import tree as m
from kennfeld.program.traversal import names_read

Load: TypeAlias = Callable[[str], "bytes | None"]

_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_MAX_FILE_BYTES = 2_000_000  # bytes


class FunctionFiles:
    """Functions by file name, and files of data that blocks name; `files` are individually named ones."""

    def __init__(self, folders: Iterable[Path], files: Iterable[Path] = ()) -> None:
        self._given = {path.name: path for path in files}
        self._files = {path.stem: path for path in self._given.values() if path.suffix == ".m"}
        self._folders = tuple(folders)
        self._read: dict[str, Mapping[str, m.FunctionDefinition]] = {}
        self._data: dict[str, StoredVariables | None] = {}

    def find(self, name: str) -> Mapping[str, m.FunctionDefinition]:
        """Read the functions of the file `name.m`, its first one under that name; {} for a script."""
        if name not in self._read:
            path = self._path(name)
            self._read[name] = _functions(path) if path is not None else {}
        return self._read[name]

    def data(self, name: str) -> StoredVariables | None:
        """Read a MAT-file that a block names, None if there is none; one that the user names precedes those in folders.

        Folders within the name are followed below those of the model, and ignored if they lead elsewhere.
        """
        # several passes over a model ask for the same file
        if name not in self._data:
            path = self._given.get(file_name(name)) or FileSearch(self._folders).find(name)
            self._data[name] = None if path is None else mat_variables(read_file(path))
        return self._data[name]

    def _path(self, name: str) -> Path | None:
        if not _NAME.match(name):
            return None
        # a file that the user names precedes those in folders
        places = [self._files[name]] if name in self._files else [folder / f"{name}.m" for folder in self._folders]
        return next((path for path in places if path.is_file()), None)


def _functions(path: Path) -> Mapping[str, m.FunctionDefinition]:
    note_opened(path)
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
    # a file with statements outside of its functions is a script
    if not script.functions or script.statements:
        return {}
    # MATLAB calls the first function by the name of the file, whatever its own name is
    return {**{function.name: function for function in script.functions}, path.stem: script.functions[0]}


def evaluate_numerically(
    tree: m.Expression, variable: Callable[[str], ParameterValue | None]
) -> tuple[ParameterValue, tuple[str, ...]]:
    """Evaluate an expression over the variables that `variable` returns; return its value and those it uses.

    Raises:
        EvaluationError: if the expression has no value.
    """
    values = {name: value for name in sorted(names_read(tree)) if (value := variable(name)) is not None}
    try:
        result = supported_value(evaluate(tree, values, {"get_param": _get_param, "eval": _evaluate_text}))
    except MatlabError as error:
        # names of functions need no value
        missing = [name for name in sorted(names_read(tree)) if name not in values and name not in NUMERIC_FUNCTIONS]
        raise EvaluationError(error.findings[0].message, missing[0] if missing else "") from None
    if result is None:
        raise EvaluationError("its value is neither numeric nor text")
    return result, tuple(values)


def run_mask_code(code: str, variable: Callable[[str], ParameterValue | None]) -> dict[str, ParameterValue]:
    """Run mask code over the variables that `variable` returns; return those that it assigns."""
    script, _ = parse_leniently(code)
    wanted = sorted(names_read(script.statements))
    known_values = {name: value for name in wanted if (value := variable(name)) is not None}
    outcome = run_script(code, "mask", known_values, functions={"get_param": _get_param, "eval": _evaluate_text})
    values = {name: supported_value(value) for name, value in outcome.variables.items()}
    return {name: value for name, value in values.items() if value is not None}


def _get_param(holder: MatlabValue, key: MatlabValue) -> MatlabValue:
    value: MatlabValue | None = holder.fields.get(text(key)) if isinstance(holder, MatlabStruct) else None
    if value is None:
        raise MatlabError.at("mask", m.TextPosition(), f"get_param({text(key)[:40]}) requires Simulink")
    return value


def _evaluate_text(written: MatlabValue) -> MatlabValue:
    """Return the value of an expression without variables."""
    return evaluate(text(written))


def supported_value(value: Any) -> ParameterValue | None:
    """Convert a MATLAB value to a block parameter, None if unsupported."""
    variable = to_variable(value, "")
    return variable.value if variable is not None else None


def to_variable(value: Any, source: str) -> Variable | None:
    """Convert a value to a variable with the limits, unit and description of its object."""
    meant = to_calibration_parameter(value)
    if isinstance(meant, StructParameter):
        return Variable(_struct(meant.value), description=meant.description, source=source)
    if meant is not None:
        numbers: ParameterValue = (
            _table(meant) if isinstance(meant, LookupTable) else np.asarray(meant.value, dtype=np.float64)
        )
        unit, description = meant.unit, meant.description
        variable = Variable(numbers, unit=unit, description=description, source=source, single=_is_single(value))
        return variable.limited(meant.min, meant.max)
    plain = _plain(value)
    kind = value.kind if isinstance(value, MatlabStruct) else ""
    type_class = kind if kind in TYPE_CLASSES else ""
    if plain is None:
        return None
    return Variable(plain, source=source, fixed=kind == ENUMERATION, kind=type_class, single=_is_single(value))


def _is_single(value: Any) -> bool:
    """Return True for numbers of single precision, and for objects that specify it."""
    if not isinstance(value, MatlabStruct):
        return isinstance(value, np.ndarray) and value.dtype == np.float32
    if value.elements.size != 1 or not value.kind:
        return False
    stated = value.fields.get("DataType")
    is_text = isinstance(stated, np.ndarray) and stated.dtype.kind == "U"
    written = "".join(stated.ravel()) if is_text and isinstance(stated, np.ndarray) else ""
    return written == "single" or _is_single(value.fields.get("Value"))


def _table(meant: LookupTable) -> dict[str, ParameterValue]:
    points = {f"Breakpoints{i + 1}": np.asarray(item.value) for i, item in enumerate(meant.breakpoints)}
    return {"Table": np.asarray(meant.value, dtype=np.float64), **points}


def _plain(value: Any) -> ParameterValue | None:
    if isinstance(value, MatlabStruct):
        return _struct(value)
    if isinstance(value, MatlabCell):
        # by columns, as MATLAB numbers cells
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
    return elements[0] if len(elements) == 1 else StructArray.of(elements, value.elements.shape)


def run_parameter_script(variables: VariableTable, path: Path, load: Load) -> None:
    """Run a parameter script and add its variables to `variables`; raise `InputError` if it cannot be read."""
    text = read_file(path).decode("utf-8", "replace")
    if not is_class(text):
        run_text(variables, text, path.name, load)
    elif (enumeration := enumeration_of(text)) is not None:
        variables[enumeration.name] = class_variable(enumeration, path.name)
    else:
        message = "is a class, but not an enumeration of integers"
        raise InputError.of(Location(path.name), message, "Use scripts and enumerations.")


def run_text(variables: VariableTable, text: str, name: str, load: Load) -> None:
    """Run MATLAB code and add its variables to `variables`; variables it leaves without a value are removed.

    Variables given by the user stay, so that they can replace what a script cannot compute. `load` returns the content
    of a file that the code loads or calls, None if there is none.
    """
    values = {key: _script_value(variable) for key, variable in variables.items()}
    outcome = run_script(text, name, values, load)
    variables.missing_files.update(dict.fromkeys(outcome.missing_files, name))
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
        # a script returns all variables: those it left unchanged keep their source, limits and unit
        before = variables.get(key)
        if before is None or before.kind != result.kind or not equal_values(before.value, result.value):
            comment = result.description or outcome.comments.get(key, "")
            variables[key] = replace(result, description=comment)
    for key, place in outcome.undefined.items():
        variables.undefined[key] = place
        # an old value must not stand for one that the script fails to compute
        if key in variables and variables[key].source != USER_SOURCE:
            del variables[key]


def _script_value(variable: Variable) -> Any:
    """Return a variable for a script, in which an enumeration converts numbers and a data type is an object."""
    if variable.kind:
        return _type_object(variable)
    if not (variable.fixed and isinstance(variable.value, Mapping)):
        return variable.value
    return MatlabStruct.of({name: from_python(value) for name, value in variable.value.items()}, ENUMERATION)


def _type_object(variable: Variable) -> MatlabStruct:
    """Return the object of a data type, which a later script may extend."""
    properties = variable.value if isinstance(variable.value, Mapping) else {}
    fields = {name: from_python(value) for name, value in properties.items()}
    if variable.kind == BUS:
        listed = properties.get("Elements", ())
        elements = [from_python(part) for part in (listed if isinstance(listed, tuple) else (listed,))]
        structs = [part.fields for part in elements if isinstance(part, MatlabStruct)]
        names = tuple(dict.fromkeys(name for part in structs for name in part))
        fields["Elements"] = MatlabStruct(object_array(structs, (len(structs), 1)), names, BUS_ELEMENT)
    return MatlabStruct.of(fields, variable.kind)
