"""MATLAB scripts (.m) as parameters: their assignments are read, nothing is executed.

MATLAB data files (.mat), versions 4 to 7.3, as calibrations; objects such as Simulink.Parameter included.

Values of the MATLAB language in the form that calibrations are made of: plain numbers, texts, structs.
"""

import re
from collections.abc import Mapping

import numpy as np

from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult
from kennfeld.calfiles.matlab_parameters import INFO, StructValue, UnreadableObject, Value, holds_samples, parameters_of
from kennfeld.errors import InputError
from kennfeld.matlab import values as m
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.mat_reader import nodes_of, value_of
from kennfeld.matlab.script_runner import Files, run_script
from kennfeld.matlab.simulink_objects import Breakpoint, LookupTable, SimulinkParameter, to_calibration_parameter

__all__ = ["TITLE", "comment_of", "is_calibration_mat", "recognises_mat", "recognises_script", "said_by"]

_LETTERS = "xyzw"
_WORDS = {"complex numbers": "complex number"}
_DEEPEST = 40

TITLE = "% Kennfeld calibration"
_ASSIGNMENT = re.compile(r"[A-Za-z]\w*(?:\.\w+|\(\d+\)|\{\d+\})*[ \t]*=[ \t]*(?:\[|(?!=)[^;\n]*(?:;|\.\.\.))")
_HARMLESS = re.compile(r"(?:clear|clc|close|function|format|clearvars)\b[^:]*")
_NAME = re.compile(r"[A-Za-z]\w*")
_BLOCKS = frozenset({"if", "for", "while", "switch", "try", "parfor", "spmd", "classdef"})
_COMMENT = re.compile(r"(?:\[([^\[\]]*)\])?[ \t]*(.*)", re.DOTALL)
_VALUES = frozenset({"value", "values", "data"})
_MOST_INDEX = 1000
_MOST_DEPTH = 50
_FIELD = 100  # values that take the memory of one field
_MOST_VALUES = 20_000_000  # that a script assigns
_LARGEST = 200_000_000  # bytes of a file beside it
_HEAD_LINES = 400
_EXCERPT = 60
_LONGEST_LINE = 500  # characters of a command that is no assignment

Step = str | int  # a field, or a place in a list

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_MOST_BYTES = 200_000_000  # unpacked
_OLD_TYPES = 6  # of numbers, in version 4
_OLD_NAME = re.compile(rb"[A-Za-z]\w{0,62}\0")


def plain_of(value: m.Value, depth: int = 0) -> Value:
    """A value as a calibration reads it; objects such as Simulink.Parameter as structs of what they say."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if depth > _DEEPEST or isinstance(value, m.MatlabFunctionHandle | m.OpaqueValue):
        kind = (
            "function"
            if isinstance(value, m.MatlabFunctionHandle)
            else getattr(value, "kind", "value too deep within others")
        )
        return UnreadableObject(_WORDS.get(kind, kind))
    if isinstance(value, m.MatlabCell):
        return [plain_of(one, depth + 1) for one in value.values.ravel(order="F")]
    if value.kind:
        return _object(value)
    elements = [
        StructValue({k: plain_of(v, depth + 1) for k, v in one.items()}) for one in value.elements.ravel(order="F")
    ]
    return elements[0] if len(elements) == 1 else list(elements)


def _array(value: m.Array) -> Value:
    if value.dtype.kind == "U":
        return "\n".join("".join(one or "\0" for one in line) for line in value.tolist()) if value.ndim == 2 else ""
    if value.dtype.kind == "O":
        return str(value.flat[0]) if value.size == 1 else [str(one) for one in value.ravel(order="F")]
    return value.astype(np.float64)


def _object(value: m.MatlabStruct) -> Value:
    meant = to_calibration_parameter(value)
    if meant is None:
        return UnreadableObject(value.kind)
    if not isinstance(meant, LookupTable):
        return StructValue({"Value": meant.value, **_said(meant)})
    axes = dict(zip(_LETTERS, meant.breakpoints, strict=False))
    units: dict[str, Value] = {f"{letter}_unit": axis.unit for letter, axis in axes.items() if axis.unit}
    points: dict[str, Value] = {letter: axis.value for letter, axis in axes.items()}
    return StructValue({**points, **units, "values": meant.value, **_said(meant)})


def _said(meant: SimulinkParameter | LookupTable | Breakpoint) -> dict[str, Value]:
    said = {"Unit": meant.unit, "Description": meant.description}
    return {name: word for name, word in said.items() if word}


def recognises_script(text: str) -> bool:
    """Whether a text begins like a script that assigns numbers."""
    text = text.lstrip("\ufeff")
    if text.startswith(TITLE):
        return True
    for line in text.split("\n", _HEAD_LINES)[:_HEAD_LINES]:
        line = line.strip()
        if _ASSIGNMENT.match(line):
            return True
        if line and line[0] not in "%#" and not _HARMLESS.fullmatch(line[:_LONGEST_LINE]):
            return False
    return False


def read_script(source: CalibrationSource) -> ReadResult:
    """The parameters that a script assigns: numbers, matrices, texts, structs with axes and values.

    The comment behind a value, `% [Nm] torque at full load`, gives its unit and description. Other statements are told
    with their line and left aside, with the variables they would change. Raises `InputError` with every finding.
    """
    notes = Findings(source.name)
    text = source.text.lstrip("\ufeff")
    outcome = run_script(text, source.name, files=_beside(source), budget=Budget(elements=_MOST_VALUES))
    for finding in outcome.findings:
        notes.take(finding)
    variables = {name: plain_of(value) for name, value in outcome.variables.items()}
    _heed(variables, outcome.comments)
    parameters = parameters_of(variables, notes, outcome.lines)
    if not parameters.chosen and not text.startswith(TITLE):
        notes.error(0, "", "assigns no numbers", "A parameter looks like: K = 0.08;")
    return ReadResult("MATLAB script", parameters, notes.settle())


def _beside(source: CalibrationSource) -> Files:
    """The scripts and data files in the folder of a script, which it may call and load."""
    folder = None if source.path is None else source.path.parent

    def content(name: str) -> bytes | None:
        if folder is None or "/" in name or "\\" in name or not (folder / name).is_file():
            return None
        file = folder / name
        return file.read_bytes() if file.stat().st_size < _LARGEST else None

    return content


def _heed(variables: dict[str, Value], comments: Mapping[str, str]) -> None:
    """What the comments behind values say, unless fields say it: unit and description of a value, units of axes."""
    info = variables.setdefault(INFO, StructValue())
    for path, comment in comments.items():
        name, _, step = path.partition(".")
        unit, description = said_by(comment)
        value = variables.get(name)
        if not step or step.casefold() in _VALUES:
            own = info.fields.setdefault(name, StructValue()) if isinstance(info, StructValue) else value
            _add(value if isinstance(value, StructValue) else own, {"unit": unit, "description": description})
        elif step in tuple("xyzw") and isinstance(value, StructValue) and f"{step}unit" not in value.folded():
            _add(value, {f"{step}_unit": unit})


def _add(target: Value | None, said: Mapping[str, str]) -> None:
    if isinstance(target, StructValue):
        known = target.folded()
        target.fields.update({key: word for key, word in said.items() if word and key not in known})


def said_by(comment: str) -> tuple[str, str]:
    """Unit and description in the comment behind a value.

    >>> said_by(" [Nm] torque at full load")
    ('Nm', 'torque at full load')
    """
    found = _COMMENT.fullmatch(comment.strip())
    return ((found[1] or "").strip(), found[2].strip()) if found else ("", "")


def comment_of(unit: str, description: str) -> str | None:
    """The comment that says so; None where it would be read otherwise."""
    words = [f"[{unit}]"] if unit else []
    made = " ".join([*words, description]) if description else "".join(words)
    plain = not re.search(r"[\x00-\x1f\x7f\ud800-\udfff]", made)
    return made if plain and said_by(made) == (unit, description) else None


def recognises_mat(source: CalibrationSource) -> bool:
    """Whether a file, of which the beginning may suffice, is a MATLAB data file."""
    raw = source.raw
    return raw.startswith(b"MATLAB 5.0 MAT-file") or _is_hdf5(raw) or _is_old(raw)


def _is_hdf5(raw: bytes) -> bool:
    return raw.startswith(_HDF5) or raw[_USER_BLOCK : _USER_BLOCK + len(_HDF5)] == _HDF5


def _is_old(raw: bytes) -> bool:
    """Whether a variable of version 4 stands at the beginning, which no mark tells."""
    if len(raw) < 22:
        return False
    for order in "<>":
        code, rows, columns, is_complex, length = (int(n) for n in np.frombuffer(raw[:20], f"{order}i4"))
        thousands, rest = divmod(code, 1000)
        fits = thousands == "<>".index(order) and rest < 10 * _OLD_TYPES and rest % 10 < 3
        plain = is_complex in (0, 1) and min(rows, columns) >= 0 and 1 < length < 65
        if fits and plain and _OLD_NAME.fullmatch(raw[20 : 20 + length]):
            return True
    return False


def read_mat(source: CalibrationSource) -> ReadResult:
    """The parameters of a data file: plain numbers, vectors, matrices, texts, structs with axes and values.

    Raises `InputError` where it is damaged or holds recorded samples; objects that only MATLAB reads are remarked.
    """
    notes = Findings(source.name)
    version, variables = _variables(source)
    samples = holds_samples(variables)
    if samples:
        message = f"holds recorded samples ({samples}), not a calibration"
        notes.error(0, "", message, "Name it as a file of a dataset.")
        notes.settle()
    return ReadResult(f"MATLAB {version}", parameters_of(variables, notes), notes.settle())


def is_calibration_mat(source: CalibrationSource) -> bool:
    """Whether a data file holds a calibration rather than recorded samples."""
    try:
        variables = _variables(source)[1]
    except InputError:
        return False
    plain = any(isinstance(value, (StructValue, np.ndarray)) for value in variables.values())
    return plain and not holds_samples(variables)


def _variables(source: CalibrationSource) -> tuple[str, dict[str, Value]]:
    raw = source.raw
    try:
        nodes = nodes_of(raw, _MOST_BYTES)
    except Exception as error:  # of many kinds: the library for version 7.3 trusts what it reads
        message = " ".join(str(error).split())[:160] or type(error).__name__
    else:
        version = "7.3" if _is_hdf5(raw) else "5" if raw.startswith(b"MATLAB") else "4"
        return version, {name: plain_of(value_of(node)) for name, node in nodes.items()}
    remedy = "The file may be cut off or damaged: save it anew in MATLAB."
    raise InputError.of(source.name, f"cannot be read as MATLAB data: {message}", remedy) from None
