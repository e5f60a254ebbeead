"""Reads, writes and describes calibration files; `_FORMATS` lists the formats."""

import gc
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kennfeld.atomic_files import write_whole
from kennfeld.calfiles.flash.description import IMAGE_ENDINGS, fragment_of_a2l, recognises_a2l
from kennfeld.calfiles.format import CalibrationSource, Format, ReadResult
from kennfeld.calfiles.unsupported_files import explain_unsupported, identify_content
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

_SCRIPT = "MATLAB script"
_SETTINGS = ("bounds", "locks", "free axes")  # of a calibration, which files of values do not hold
_PLAIN_LOSSES = ("inputs", "extrapolation", "line breaks", *_SETTINGS)
# What tells, reads and writes a format, as module:function in this room. The script is the last one: it knows no mark.
_FORMATS = (
    Format(
        "JSON",
        (".json",),
        "json_file:recognises_json",
        "json_file:read_json",
        "json_file:write_json",
        lacks=("infinities", *_SETTINGS),
    ),
    Format(
        "CVX (INCA's CSV)",
        (".csv",),
        "cvx.reader:recognises_cvx",
        "cvx.reader:read_cvx",
        "cvx.writer:write_cvx",
        lacks=("kinds", "descriptions", "group units", *_PLAIN_LOSSES),
    ),
    Format(
        "CDFX",
        (".cdfx",),
        "cdfx.reader:recognises_cdfx",
        "cdfx.reader:read_cdfx",
        "cdfx.writer:write_cdfx",
        lacks=_PLAIN_LOSSES,
    ),
    Format(
        "DCM",
        (".dcm",),
        "dcm.lines:recognises_dcm",
        "dcm.reader:read_dcm",
        "dcm.update:write_dcm",
        lacks=("kinds", *_PLAIN_LOSSES),
    ),
    Format(
        "Intel HEX or S-records with an A2L file",
        IMAGE_ENDINGS,
        "flash.description:recognises_flash",
        "flash.description:read_flash",
        "flash.description:write_flash",
        binary=True,
    ),
    Format("MSQ (TunerStudio)", (".msq",), "msq.reader:recognises_msq", "msq.reader:read_msq", "msq.update:write_msq"),
    Format(
        "Excel",
        (".xlsx",),
        "excel.layout:looks_like_a_workbook",
        "excel.reader:read_excel",
        "excel.writer:write_excel",
        binary=True,
        lacks=("extrapolation", *_SETTINGS),
    ),
    Format(
        "MATLAB data",
        (".mat",),
        "matlab_reader:recognises_mat",
        "matlab_reader:read_mat",
        "matlab_writer:write_mat",
        binary=True,
        lacks=("extrapolation", *_SETTINGS),
    ),
    Format(
        _SCRIPT,
        (".m",),
        "matlab_reader:recognises_script",
        "matlab_reader:read_script",
        "matlab_writer:write_script",
        lacks=("extrapolation", *_SETTINGS),
    ),
)
_HEAD = 65536  # bytes looked at before a file is read as a whole


@dataclass(frozen=True)
class ParameterSummary:
    """Kind, shape, unit and value range of a parameter."""

    name: str
    kind: str
    shape: tuple[int, ...]
    unit: str
    description: str
    minimum: float  # NaN where there is no value
    maximum: float
    functions: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()  # the first one is read


@dataclass(frozen=True)
class CalibrationFile:
    """The content of a calibration file; `remarks` lists what was skipped."""

    path: Path
    kind: str
    parameters: tuple[ParameterSummary, ...]
    axes: tuple[Axis, ...]  # group axes
    texts: tuple[Text, ...]
    remarks: tuple[Finding, ...]


def endings() -> tuple[str, ...]:
    """Return the file endings that `write` supports."""
    return tuple(ending for known in _FORMATS for ending in known.endings)


def read(path: str | Path, a2l: str | Path | None = None) -> ParameterSet:
    """Read the parameters of a calibration file of any format, which is recognised by its content.

    Args:
        path: The file.
        a2l: The A2L file that describes an image (Intel HEX, S-records). By default the one with the same name in its
            folder, or the only one there.

    Returns:
        The parameters, texts and group axes, in file order.

    Raises:
        InputError: The file cannot be read; with all findings.
    """
    parameters = _read_content(Path(path), a2l).parameters
    return parameters if parameters.origin is not None else parameters.from_origin(Path(path))


def read_several(
    paths: Iterable[str | Path], a2l: str | Path | None = None
) -> tuple[list[ParameterSet], tuple[Finding, ...]]:
    """Read several calibration files.

    Args:
        paths: The files.
        a2l: The A2L file that describes the images among them.

    Returns:
        One set per file, and the findings on what was skipped.

    Raises:
        InputError: With the findings of all files that cannot be read.
    """
    contents: list[ReadResult] = []
    findings: list[Finding] = []
    for path in paths:
        try:
            contents.append(_read_content(Path(path), a2l))
        except InputError as error:
            findings += error.findings
    if findings:
        raise InputError(findings)
    return [content.parameters for content in contents], tuple(one for content in contents for one in content.remarks)


def write(
    parameters: ParameterSet, path: str | Path, image: str | Path | None = None, a2l: str | Path | None = None
) -> tuple[Finding, ...]:
    """Write a calibration file in the format of its ending (.dcm, .cdfx, .json, .xlsx, .csv for INCA's CVX, ...).

    The file is written completely or not at all. A set that was read from a DCM file or a tune and is written in the
    same format keeps the rest of that file. An image is a copy of the one that the set was read from, with values
    rounded to what the control unit can store.

    Args:
        parameters: The set.
        path: The file to write.
        image: The image (.hex, .s19, ...) to modify, if the set was not read from one.
        a2l: The A2L file that describes `image`.

    Returns:
        Findings about the new file, such as rounding.

    Raises:
        ArgumentError: The ending is unknown.
        InputError: The format cannot store some parameters, or the file cannot be written.
    """
    target = Path(path)
    if image is not None:
        parameters = parameters.from_origin(_read_content(Path(image), a2l).parameters.origin)
    result = _format_for(target).write(parameters, target.name)
    _write_bytes(target, result.raw)
    return result.remarks


def losses(parameters: ParameterSet, path: str | Path) -> tuple[Finding, ...]:
    """Return a warning for each aspect of a set that the format of a file cannot store.

    Args:
        parameters: The set that is written.
        path: The file, whether or not it exists.

    Returns:
        One remark an aspect, such as descriptions or bounds, with the names of the parameters that lose it.

    Raises:
        ArgumentError: The ending is that of no calibration format.

    >>> from kennfeld.parameters import Scalar
    >>> print(*losses(ParameterSet([Scalar("Kp", 2.0, description="gain")]), "a.csv"))
    a.csv: descriptions are left out: 1 label (Kp). Write it as .json to keep them.
    """
    from kennfeld.calfiles.loss_report import loss_remarks

    return loss_remarks(parameters, _format_for(Path(path)).lacks, Path(path).name)


def unwritable(parameters: ParameterSet, ending: str) -> dict[str, Finding]:
    """Return the parameters that a format cannot store, by name, each with the first reason.

    Raises `ArgumentError` for an unknown ending.

    >>> from kennfeld.parameters import Scalar
    >>> list(unwritable(ParameterSet([Scalar("Gain", 2.0), Scalar("Main Path/Gain:Gain", 1.0)]), ".dcm"))
    ['Main Path/Gain:Gain']
    """
    known, found = _format_for(Path(f"parameters{ending}")), {}
    for one in parameters.values():
        try:
            known.write(ParameterSet([one]), f"parameters{ending}")
        except InputError as error:
            found[one.name] = error.findings[0]
    return found


def describe(path: str | Path, a2l: str | Path | None = None) -> CalibrationFile:
    """Return the kind, parameters, group axes and texts of a calibration file, and what was skipped.

    Raises `InputError` if the file cannot be read.
    """
    content = _read_content(Path(path), a2l)
    members = content.parameters
    others: dict[str, list[str]] = {}
    for item in members.others:
        others.setdefault(item.name, []).append(item.variant)
    summaries = tuple(_summary(member, others.get(member.name, [])) for member in members.parameters)
    return CalibrationFile(Path(path), content.kind, summaries, members.axes, members.texts, content.remarks)


def _summary(member: Parameter, others: Sequence[str]) -> ParameterSummary:
    known = member.values[~np.isnan(member.values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)
    shape, variants = member.values.shape, (member.variant, *others) if others or member.variant else ()
    said = member.unit, member.description
    return ParameterSummary(member.name, member.kind, shape, *said, low, high, member.functions, variants)


def _read_content(path: Path, a2l: str | Path | None = None) -> ReadResult:
    source = CalibrationSource(path.name, _bytes(path), path, None if a2l is None else Path(a2l))
    for known in _ordered_formats(path):
        if known.recognises(source):
            with _no_collection():
                return known.read(source)
    raise InputError([_unrecognised_file(path, source)])


def _ordered_formats(path: Path) -> list[Format]:
    """Return the formats, that of the file's ending first, so that the others need not be loaded."""
    ending = path.suffix.lower()
    return sorted(_FORMATS, key=lambda known: ending not in known.endings or known.name == _SCRIPT)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Pause garbage collection, which takes a third of the time with a million live objects."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _bytes(path: Path) -> bytes:
    """Read a file; a large one of another kind is refused by its head."""
    try:
        with path.open("rb") as file:
            head = CalibrationSource(path.name, file.read(_HEAD), path)
            if head.is_binary and not any(known.recognises(head) for known in _FORMATS if known.binary):
                raise InputError([_unsupported_file(path, head.raw, "holds binary data")])
            return head.raw + file.read()
    except FileNotFoundError:
        raise InputError([_missing_file(path)]) from None
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise InputError.of(str(path), message) from None


def _missing_file(path: Path) -> Finding:
    beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
    return Finding(str(path), "there is no such file", nearest(path.name, beside))


def _unrecognised_file(path: Path, source: CalibrationSource) -> Finding:
    lines = source.text.strip().splitlines()
    if not lines:
        return Finding(path.name, "is empty", f"Expected {_describe_formats()}.")
    fragment = fragment_of_a2l(source.text)
    if fragment:
        return Finding(path.name, *fragment)
    if recognises_a2l(source.text):
        message = "is an A2L description, which contains no values"
        return Finding(path.name, message, "Pass the image that it describes (.hex, .s19), with --a2l if needed.")
    return _unsupported_file(path, source.raw, f"begins with {lines[0][:60]!r}")


def _unsupported_file(path: Path, head: bytes, message: str) -> Finding:
    known = explain_unsupported(path)
    if known is not None:
        return known
    look = identify_content(head)
    return Finding(
        path.name,
        f"is not a calibration file: it {f'looks like {look}' if look else message}",
        f"Expected {_describe_formats()}.",
    )


def _describe_formats() -> str:
    return ", ".join(f"{known.name} ({', '.join(known.endings)})" for known in _FORMATS)


def _format_for(path: Path) -> Format:
    ending = path.suffix.lower()
    for known in _FORMATS:
        if ending in known.endings:
            return known
    guess = nearest(ending, endings())
    raise ArgumentError(f"path={str(path)!r} must end like a calibration file: {_describe_formats()}. {guess}".strip())


def _write_bytes(target: Path, raw: bytes) -> None:
    try:
        write_whole(target, raw)
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise InputError.of(os.path.realpath(target), message, "Choose another path.") from None
