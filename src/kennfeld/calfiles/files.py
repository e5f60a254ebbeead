"""Reads, writes and describes calibration files; `_FORMATS` lists the formats."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.atomic_files import write_whole
from kennfeld.calfiles.flash.recognition import IMAGE_ENDINGS, fragment_of_a2l, recognises_a2l
from kennfeld.calfiles.format import HEAD_SIZE, BinaryFormat, CalibrationSource, Format, Item, ReadResult
from kennfeld.calfiles.unsupported_files import explain_unsupported, identify_content
from kennfeld.errors import ArgumentError, Finding, InputError, Location
from kennfeld.file_errors import convert_errors
from kennfeld.foreign_content import identify_foreign
from kennfeld.formatting import nearest
from kennfeld.garbage_collection import no_collection
from kennfeld.lazy_dataclass import dataclass
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

_SCRIPT = "MATLAB script"
# the aspects that formats lack, by the keys of `loss_report`; no file of values holds the settings of a calibration
_SETTINGS = ("bounds", "locks", "free axes")
_JSON = ("infinities", *_SETTINGS)
_RICH = ("extrapolation", *_SETTINGS)
_PLAIN = ("inputs", "extrapolation", "line breaks", *_SETTINGS)
_DCM = ("kinds", *_PLAIN)
_CVX = ("kinds", "descriptions", "group units", *_PLAIN)
# The script is the last one: it has no signature.
_FORMATS = (
    Format("JSON", (".json",), "json", ("json_file", "json_file", "json_file"), _JSON),
    Format("CVX (INCA's CSV)", (".csv",), "cvx", ("cvx.reader", "cvx.reader", "cvx.writer"), _CVX),
    Format("CDFX", (".cdfx",), "cdfx", ("cdfx.reader", "cdfx.reader", "cdfx.writer"), _PLAIN),
    Format("DCM", (".dcm",), "dcm", ("dcm.lines", "dcm.reader", "dcm.update"), _DCM),
    BinaryFormat(
        "Intel HEX or S-records with an A2L file",
        IMAGE_ENDINGS,
        "flash",
        ("flash.recognition", "flash.description", "flash.description"),
    ),
    Format("MSQ (TunerStudio)", (".msq",), "msq", ("msq.reader", "msq.reader", "msq.update")),
    Format("PAR (CANape)", (".par",), "par", ("par.lines", "par.reader", "par.update")),
    Format("ESDL (ASCET)", (".esdl",), "esdl", ("esdl.reader", "esdl.reader", "esdl.update")),
    BinaryFormat("AXL and AMD (ASCET 6)", (".axl", ".amd"), "amd", ("amd.reader", "amd.reader", "amd.update")),
    BinaryFormat("Excel", (".xlsx",), "excel", ("excel.layout", "excel.reader", "excel.writer"), _RICH),
    BinaryFormat("MATLAB data", (".mat",), "mat", ("matlab_reader", "matlab_reader", "matlab_writer"), _RICH),
    Format(_SCRIPT, (".m",), "script", ("matlab_reader", "matlab_reader", "matlab_writer"), _RICH),
)


@dataclass(frozen=True)
class ParameterSummary:
    """Kind, shape, unit and value range of a parameter."""

    name: str
    kind: str
    shape: tuple[int, ...]
    unit: str
    description: str
    minimum: float  # NaN if there is no value
    maximum: float
    functions: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()  # the first one is read


@dataclass(frozen=True)
class CalibrationFile:
    """The content of a calibration file; `findings` list what was skipped."""

    path: Path
    kind: str
    parameters: tuple[ParameterSummary, ...]
    axes: tuple[Axis, ...]  # group axes
    texts: tuple[Text, ...]
    findings: tuple[Finding, ...]


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

    >>> from kennfeld import read_parameters
    >>> values = read_parameters("start.dcm")
    >>> values["MapOptTorque"].values.shape, values["MapOptTorque"].unit
    ((19, 13), 'Nm')
    """
    parameters = _read_content(Path(path), a2l).parameters
    return parameters if parameters.origin is not None else parameters.from_origin(Path(path).absolute())


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
    errors: list[Finding] = []
    for path in paths:
        try:
            contents.append(_read_content(Path(path), a2l))
        except InputError as error:
            errors += error.findings
    if errors:
        raise InputError(errors)
    findings = tuple(finding for content in contents for finding in content.findings)
    return [content.parameters for content in contents], findings


def write(
    parameters: ParameterSet, path: str | Path, image: str | Path | None = None, a2l: str | Path | None = None
) -> tuple[Finding, ...]:
    """Write a calibration file in the format of its ending (.dcm, .cdfx, .json, .xlsx, .csv for INCA's CVX, ...).

    The file is written completely or not at all. A set that was read from a DCM, PAR, ESDL or ASCET 6 file or a
    tune and is written in the same format keeps the rest of that file. An image is a copy of the one that the set was
    read from, with values rounded to what the control unit can store.

    Args:
        parameters: The set.
        path: The file to write.
        image: The image (.hex, .s19, ...) to modify, if the set was not read from one.
        a2l: The A2L file that describes `image`.

    Returns:
        FileFindings about the new file, such as rounding.

    Raises:
        ArgumentError: The ending is unknown.
        InputError: The format cannot store some parameters, or the file cannot be written.
    """
    target = Path(path)
    if image is not None:
        parameters = parameters.from_origin(_read_content(Path(image), a2l).parameters.origin)
    result = _format_for(target).write(parameters, target.name)
    with convert_errors(os.path.realpath(target), "cannot be written", "Choose another path."):
        write_whole(target, result.raw, follow=True)
    return result.findings


def losses(parameters: ParameterSet, path: str | Path) -> tuple[Finding, ...]:
    """Return a warning for each aspect of a set that the format of a file cannot store.

    Args:
        parameters: The set that is written.
        path: The file, whether or not it exists.

    Returns:
        One finding an aspect, such as descriptions or bounds, with the names of the parameters that lose it.

    Raises:
        ArgumentError: The ending is that of no calibration format.

    >>> from kennfeld.parameters import Scalar
    >>> print(*losses(ParameterSet([Scalar("Kp", 2.0, description="gain")]), "a.csv"))
    a.csv: descriptions are left out: 1 label (Kp). Write it as .json to keep them.
    """
    from kennfeld.calfiles.loss_report import find_losses

    return find_losses(parameters, _format_for(Path(path)).lacks, Path(path).name)


def unwritable(parameters: ParameterSet, ending: str) -> dict[str, Finding]:
    """Return the parameters that a format cannot store, by name, each with the first reason.

    Raises `ArgumentError` for an unknown ending.

    >>> from kennfeld.parameters import Scalar
    >>> list(unwritable(ParameterSet([Scalar("Gain", 2.0), Scalar("Main Path/Gain:Gain", 1.0)]), ".dcm"))
    ['Main Path/Gain:Gain']
    """
    file, reasons = f"parameters{ending}", {}
    known = _format_for(Path(file))
    for member in parameters.values():
        try:
            known.write(ParameterSet([member]), file)
        except InputError as error:
            reasons[member.name] = error.findings[0]
    return reasons


def recognise(path: str | Path) -> str:
    """Return the name of the format of a file by its content; empty if it is not a calibration file.

    >>> recognise("kennfeld.toml")
    ''
    """
    try:
        source = CalibrationSource(Path(path).name, _bytes(Path(path)), Path(path))
    except InputError:
        return ""
    ending = Path(path).suffix.lower()
    known = (known for known in _FORMATS if ending in known.endings)
    return next((each.name for each in known if each.recognises(source)), "")


def describe(path: str | Path, a2l: str | Path | None = None) -> CalibrationFile:
    """Return the kind, parameters, group axes and texts of a calibration file, and what was skipped.

    Raises `InputError` if the file cannot be read.
    """
    content = _read_content(Path(path), a2l)
    members = content.parameters
    others = members.others_by_name
    summaries = tuple(_summarise(member, others.get(member.name, [])) for member in members.parameters)
    return CalibrationFile(Path(path), content.kind, summaries, members.axes, members.texts, content.findings)


def _summarise(member: Parameter, others: Sequence[Item]) -> ParameterSummary:
    known = member.values[~np.isnan(member.values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)
    variants = (member.variant, *(item.variant for item in others)) if others or member.variant else ()
    labels = member.name, member.kind, member.values.shape, member.unit, member.description
    return ParameterSummary(*labels, low, high, member.functions, variants)


def _read_content(path: Path, a2l: str | Path | None = None) -> ReadResult:
    source = CalibrationSource(path.name, _bytes(path), path, None if a2l is None else Path(a2l))
    ending = path.suffix.lower()
    # that of the file's ending first, so that the others need not be loaded
    for known in sorted(_FORMATS, key=lambda known: ending not in known.endings or known.name == _SCRIPT):
        if known.recognises(source):
            with no_collection():
                content = known.read(source)
            return replace(content, parameters=content.parameters.read_without(known.unstated))
    raise InputError([_unrecognised_file(path, source)])


def _bytes(path: Path) -> bytes:
    """Read a file; a large one of another kind is refused by its head."""
    with convert_errors(path, "cannot be read", missing="there is no such file"), path.open("rb") as file:
        head = CalibrationSource(path.name, file.read(HEAD_SIZE), path)
        content = identify_foreign(head.raw)
        if content is not None and explain_unsupported(path) is None:
            raise InputError.of(Location(path.name), f"this is {content.description}", content.remedy)
        if head.is_binary and not any(known.recognises(head) for known in _FORMATS if isinstance(known, BinaryFormat)):
            raise InputError([_unsupported_file(path, head.raw, "holds binary data")])
        return head.raw + file.read()


def _unrecognised_file(path: Path, source: CalibrationSource) -> Finding:
    lines, location = source.text.strip().splitlines(), Location(path.name)
    if not lines:
        return Finding(location, "is empty", f"Expected {_describe_formats()}.")
    fragment = fragment_of_a2l(source.text)
    if fragment:
        return Finding(location, *fragment)
    if recognises_a2l(source.text):
        message = "is an A2L description, which contains no values"
        return Finding(location, message, "Pass the image that it describes (.hex, .s19), with --a2l if needed.")
    return _unsupported_file(path, source.raw, f"begins with {lines[0][:60]!r}")


def _unsupported_file(path: Path, head: bytes, message: str) -> Finding:
    known = explain_unsupported(path)
    if known is not None:
        return known
    kind = identify_content(head)
    message = f"is not a calibration file: it {f'looks like {kind}' if kind else message}"
    return Finding(Location(path.name), message, f"Expected {_describe_formats()}.")


def _describe_formats() -> str:
    return ", ".join(f"{known.name} ({', '.join(known.endings)})" for known in _FORMATS)


def _format_for(path: Path) -> Format:
    ending = path.suffix.lower()
    for known in _FORMATS:
        if ending in known.endings:
            return known
    guess = nearest(ending, endings())
    raise ArgumentError(f"path={str(path)!r} must end like a calibration file: {_describe_formats()}. {guess}".strip())
