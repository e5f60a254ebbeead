"""Reads MATLAB scripts (.m) and data files (.mat, versions 4 to 7.3) as calibrations.

Scripts are interpreted, never executed by MATLAB. Objects such as Simulink.Parameter are supported.
"""

import re
from collections.abc import Mapping

import numpy as np

from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_state import note_opened
from kennfeld.base.formatting import reason_of
from kennfeld.calfiles.format import CalibrationSource, FileFindings, ReadResult
from kennfeld.calfiles.matlab_parameters import INFO, StructValue, UnreadableObject, Value, holds_samples, parameters_of
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.files.calibrations import SCRIPT_TITLE
from kennfeld.files.head import FileHead
from kennfeld.matlab import values as m
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.mat_reader import read_nodes, to_value
from kennfeld.matlab.mat_v73 import is_matlab_guarded
from kennfeld.matlab.script_files import Files
from kennfeld.matlab.script_runner import run_script
from kennfeld.matlab.simulink_objects import LookupTable, StructParameter, to_calibration_parameter

_MAX_DEPTH = 40

_COMMENT = re.compile(r"(?:\[([^\[\]]*)\])?[ \t]*(.*)", re.DOTALL)
_VALUES = frozenset({"value", "values", "data"})
_MAX_VALUES = 20_000_000  # that a script assigns
_MAX_FILE_BYTES = 200_000_000  # bytes of a file in its folder

_MAX_SEARCHED = 100_000_000  # bytes of a file that is searched for parameters
_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_MAX_UNPACKED_BYTES = 200_000_000  # unpacked


def to_plain_value(value: m.Value, depth: int = 0) -> Value:
    """Convert a value of the interpreter; objects such as Simulink.Parameter become structs of their attributes."""
    if isinstance(value, np.ndarray):
        return _to_array(value)
    if depth > _MAX_DEPTH or isinstance(value, m.MatlabFunctionHandle | m.OpaqueValue):
        kind = getattr(value, "kind", "value too deep within others")
        kind = "function" if isinstance(value, m.MatlabFunctionHandle) else kind
        return UnreadableObject("complex number" if kind == "complex numbers" else kind)
    if isinstance(value, m.MatlabCell):
        return [to_plain_value(element, depth + 1) for element in value.values.ravel(order="F")]
    if value.kind:
        return _to_struct(value, depth)
    elements = [
        StructValue({name: to_plain_value(field, depth + 1) for name, field in element.items()})
        for element in value.elements.ravel(order="F")
    ]
    return elements[0] if len(elements) == 1 else list(elements)


def _to_array(value: m.Array) -> Value:
    if value.dtype.kind == "U":
        # numpy stores the character NUL as an empty one
        return "\n".join("".join(character or "\0" for character in line) for line in value.tolist() if value.ndim == 2)
    if value.dtype.kind == "O":
        return str(value.flat[0]) if value.size == 1 else list(map(str, value.ravel(order="F")))
    return value.astype(np.float64)


def _to_struct(value: m.MatlabStruct, depth: int) -> Value:
    content = to_calibration_parameter(value)
    if content is None:
        return UnreadableObject(value.kind)
    # each field is a parameter of its own, as those of a plain struct
    if isinstance(content, StructParameter):
        return to_plain_value(content.value, depth + 1)
    attributes: dict[str, Value] = {"Unit": content.unit, "Description": content.description}
    attributes = {name: word for name, word in attributes.items() if word}
    if not isinstance(content, LookupTable):
        return StructValue({"Value": content.value, **attributes})
    axes = dict(zip(AXIS_LETTERS, content.breakpoints, strict=False))
    units: dict[str, Value] = {f"{letter}_unit": axis.unit for letter, axis in axes.items() if axis.unit}
    points: dict[str, Value] = {letter: axis.value for letter, axis in axes.items()}
    return StructValue({**points, **units, "values": content.value, **attributes})


def read_script(source: CalibrationSource) -> ReadResult:
    """Return the parameters that a script assigns: numbers, matrices, texts, structs with axes and values.

    The comment after a value, `% [Nm] torque at full load`, gives its unit and description. Other statements are
    reported with their line and skipped, with the variables they would change. Raises `InputError` with all findings.
    """
    findings = FileFindings(source.name)
    text = source.text.lstrip("\ufeff")
    outcome = run_script(text, source.name, files=_neighbouring_files(source), budget=Budget(elements=_MAX_VALUES))
    findings.add(*outcome.findings)
    variables = {name: to_plain_value(value) for name, value in outcome.variables.items()}
    _apply_comments(variables, outcome.comments)
    parameters = parameters_of(variables, findings, outcome.lines)
    if not parameters.chosen and not text.startswith(SCRIPT_TITLE):
        findings.error(0, "", "assigns no numbers", "A parameter looks like: K = 0.08;")
    return ReadResult("MATLAB script", parameters, findings.finish())


def _neighbouring_files(source: CalibrationSource) -> Files:
    """Return the scripts and data files in the folder of a script, which it may call and load."""
    folder = None if source.path is None else source.path.parent

    def content(name: str) -> bytes | None:
        # a script reaches no other folder
        if folder is None or "/" in name or "\\" in name:
            return None
        file = folder / name
        note_opened(file)
        return file.read_bytes() if file.is_file() and file.stat().st_size < _MAX_FILE_BYTES else None

    return content


def _apply_comments(variables: dict[str, Value], comments: Mapping[str, str]) -> None:
    """Apply the comments after values as units and descriptions, unless fields define them."""
    info = variables.setdefault(INFO, StructValue())
    for path, comment in comments.items():
        name, _, step = path.partition(".")
        unit, description = parse_comment(comment)
        value = variables.get(name)
        if not step or step.casefold() in _VALUES:
            own = info.fields.setdefault(name, StructValue()) if isinstance(info, StructValue) else value
            _add_missing(value if isinstance(value, StructValue) else own, {"unit": unit, "description": description})
        elif step in AXIS_LETTERS and isinstance(value, StructValue) and f"{step}unit" not in value.folded():
            _add_missing(value, {f"{step}_unit": unit})


def _add_missing(target: Value | None, labels: Mapping[str, str]) -> None:
    if isinstance(target, StructValue):
        known = target.folded()
        target.fields.update({key: word for key, word in labels.items() if word and key not in known})


def parse_comment(comment: str) -> tuple[str, str]:
    """Return the unit and description in the comment after a value.

    >>> parse_comment(" [Nm] torque at full load")
    ('Nm', 'torque at full load')
    """
    match = _COMMENT.fullmatch(comment.strip())
    return ((match[1] or "").strip(), match[2].strip()) if match else ("", "")


def format_comment(unit: str, description: str) -> str | None:
    """Return the comment with a unit and description; None if it would be read differently."""
    words = [f"[{unit}]"] if unit else []
    result = " ".join([*words, description]) if description else "".join(words)
    plain = not re.search(r"[\x00-\x1f\x7f\ud800-\udfff]", result)
    return result if plain and parse_comment(result) == (unit, description) else None


def _is_hdf5(raw: bytes) -> bool:
    return raw.startswith(_HDF5) or raw[_USER_BLOCK : _USER_BLOCK + len(_HDF5)] == _HDF5


def read_mat(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a data file: plain numbers, vectors, matrices, texts, structs with axes and values.

    Raises `InputError` if it is damaged or holds recorded samples; objects that only MATLAB reads are skipped.
    """
    version, variables = _variables(source)
    samples = holds_samples(variables)
    if samples:
        message = f"contains recorded samples ({samples}), not a calibration"
        raise InputError.of(Location(source.name), message, "Use it as a dataset file.")
    findings = FileFindings(source.name)
    return ReadResult(f"MATLAB {version}", parameters_of(variables, findings), findings.finish())


def holds_calibration(head: FileHead) -> bool:
    """Check whether a data file holds a calibration rather than recorded samples."""
    if not (head.packing or head.member) and head.path.stat().st_size > _MAX_SEARCHED:
        return False
    content = head.whole(_MAX_SEARCHED)
    if _is_hdf5(content) and not is_matlab_guarded(content):
        return False
    try:
        variables = _variables(CalibrationSource(head.name, content))[1]
    except InputError:
        return False
    plain = any(isinstance(value, (StructValue, np.ndarray)) for value in variables.values())
    return plain and not holds_samples(variables)


def _variables(source: CalibrationSource) -> tuple[str, dict[str, Value]]:
    raw = source.raw
    try:
        nodes = read_nodes(raw, _MAX_UNPACKED_BYTES)
    except Exception as error:  # of many kinds: the library for version 7.3 does not check what it reads
        message = reason_of(error)
    else:
        version = "7.3" if _is_hdf5(raw) else "5" if raw.startswith(b"MATLAB") else "4"
        return version, {name: to_plain_value(to_value(node)) for name, node in nodes.items()}
    remedy = "The file may be truncated or damaged: save it again in MATLAB."
    raise InputError.of(Location(source.name), f"cannot be read as MATLAB data: {message}", remedy) from None
