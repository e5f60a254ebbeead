"""Reads, writes and describes calibration files of all formats."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location, warn
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import nearest
from kennfeld.base.garbage_collection import no_collection
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.streams import Source, local_file
from kennfeld.calfiles.format import CalibrationSource, Item, ReadResult, WriteResult
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text
from kennfeld.files.descriptions import A2L, A2L_FRAGMENT, fragment_of_a2l
from kennfeld.files.file_format import CalibrationConverter, FileFormat, Role, call
from kennfeld.files.formats import BINARY, XML, calibration_formats
from kennfeld.files.head import FileHead
from kennfeld.files.identification import Identity, identify
from kennfeld.files.recordings import CSV
from kennfeld.files.unpacking import unpacked


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
    return tuple(ending for known in calibration_formats() for ending in _endings(known))


def read(path: Source, a2l: str | Path | None = None) -> ParameterSet:
    """Read the parameters of a calibration file of any format, which is recognised by its content.

    Args:
        path: The file, or an open stream such as `io.BytesIO`.
        a2l: The A2L file that describes an image (Intel HEX, S-records). By default the one with the same name in its
            folder, or the only one there.

    Returns:
        The parameters, texts and group axes, in file order.

    Raises:
        InputError: The file cannot be read; with all findings.

    Warns:
        InputWarning: Part of the file was skipped, such as a table whose axis neither rises nor falls.

    >>> from kennfeld import read_parameters
    >>> values = read_parameters("start.dcm")
    >>> values["MapOptTorque"].values.shape, values["MapOptTorque"].unit
    ((19, 13), 'Nm')
    """
    parameters, findings = read_with_findings(path, a2l)
    warn(finding for finding in findings if finding.severity == "warning")
    return parameters


def read_with_findings(path: Source, a2l: str | Path | None = None) -> tuple[ParameterSet, tuple[Finding, ...]]:
    """Read the parameters as `read` does; return the findings on what was skipped in place of warnings."""
    with local_file(path) as file:
        content = _read_content(Path(file), a2l)
    parameters = content.parameters
    # formats that keep the rest of a file state an origin of their own; a stream has none to return to
    if isinstance(path, str | Path) and parameters.origin is None:
        parameters = parameters.from_origin(Path(path).absolute())
    return parameters, content.findings


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
        Findings on the new file, such as rounding.

    Raises:
        ArgumentError: The ending is unknown.
        InputError: The format cannot store some parameters, or the file cannot be written.
    """
    target = Path(path)
    if image is not None:
        parameters = parameters.from_origin(_read_content(Path(image), a2l).parameters.origin)
    result = _written(_converter_for(target), parameters, target.name)
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

    >>> from kennfeld.domain.parameters import Scalar
    >>> print(*losses(ParameterSet([Scalar("Kp", 2.0, description="gain")]), "a.csv"))
    a.csv: descriptions are left out: 1 label (Kp). Write it as .json to keep them.
    """
    from kennfeld.calfiles.loss_report import find_losses

    return find_losses(parameters, _converter_for(Path(path)).lacks, Path(path).name)


def unwritable(parameters: ParameterSet, ending: str) -> dict[str, Finding]:
    """Return the parameters that a format cannot store, by name, each with the first reason.

    Raises `ArgumentError` for an unknown ending.

    >>> from kennfeld.domain.parameters import Scalar
    >>> list(unwritable(ParameterSet([Scalar("Gain", 2.0), Scalar("Main Path/Gain:Gain", 1.0)]), ".dcm"))
    ['Main Path/Gain:Gain']
    """
    file, reasons = f"parameters{ending}", {}
    converter = _converter_for(Path(file))
    for member in parameters.values():
        try:
            # one by one: a converter refuses a set as a whole
            _written(converter, ParameterSet([member], origin=parameters.origin), file)
        except InputError as error:
            reasons[member.name] = error.findings[0]
    return reasons


def recognise(path: str | Path) -> str:
    """Return the name of the format of a file by its content; empty if it is not a calibration file.

    >>> recognise("kennfeld.toml")
    ''
    """
    try:
        identity = identify(path)
    except InputError:
        return ""
    converter = identity.format.calibration
    is_one = converter is not None and identity.role in (Role.CALIBRATION, Role.PROGRAM)
    return _label(identity.format) if is_one else ""


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
    identity = identify(path, Role.CALIBRATION)
    converter = identity.format.calibration
    if converter is None or identity.role is not Role.CALIBRATION or identity.head.is_blank:
        raise InputError([_other_file(identity)])
    source = _source(identity.head, None if a2l is None else Path(a2l))
    with no_collection():
        content: ReadResult = call(converter.read, source)
    return replace(content, parameters=content.parameters.read_without(converter.unstated))


def _source(head: FileHead, a2l: Path | None) -> CalibrationSource:
    """Return the whole file, unpacked; the files that belong to it are looked for beside it, by its own name."""
    if not head.packing and not head.member:
        with convert_errors(head.path, "cannot be read"):
            return CalibrationSource(head.name, head.path.read_bytes(), head.path, a2l)
    with unpacked(head, head.member) as (path, _):
        return CalibrationSource(head.name, path.read_bytes(), head.path.with_name(head.name), a2l)


def _other_file(identity: Identity) -> Finding:
    """Return why a file is not read as a calibration: what it is instead."""
    known, head = identity.format, identity.head
    location, expected = Location(head.name), f"Expected {_describe_formats()}."
    if head.is_blank:
        return Finding(location, "is empty", expected)
    if known is A2L_FRAGMENT:
        return Finding(location, *(fragment_of_a2l(head.text) or ("", "")))
    if known is A2L or (known.remedy and known.recording is None):
        return Finding(location, f"is {known.phrase}", known.remedy)
    return Finding(location, f"is not a calibration file: it {_impression(identity)}", expected)


def _impression(identity: Identity) -> str:
    known, head = identity.format, identity.head
    if known is XML:
        return f"looks like XML with the root {head.root}" if head.root else "looks like XML"
    if known is BINARY:
        return "holds binary data"
    if known is CSV:
        # there is a line, as `_other_file` has reported blank files
        return f"begins with {head.text.strip().splitlines()[0][:60]!r}"
    return f"looks like {known.phrase}"


def _describe_formats() -> str:
    return ", ".join(f"{_label(known)} ({', '.join(_endings(known))})" for known in calibration_formats())


def _label(known: FileFormat) -> str:
    return known.calibration.label if known.calibration and known.calibration.label else known.name


def _endings(known: FileFormat) -> tuple[str, ...]:
    """Return the endings of the files of a format that can be written."""
    converter = known.calibration
    return (converter.endings or known.endings) if converter is not None and converter.write else ()


def _converter_for(path: Path) -> CalibrationConverter:
    """Return the converter of the format that the ending of a file to be written selects."""
    ending = path.suffix.lower()
    for known in calibration_formats():
        if known.calibration is not None and ending in _endings(known):
            return known.calibration
    guess = nearest(ending, endings())
    raise ArgumentError(f"path={str(path)!r} must end like a calibration file: {_describe_formats()}. {guess}".strip())


def _written(converter: CalibrationConverter, parameters: ParameterSet, name: str) -> WriteResult:
    """Convert a set to a file; raises `InputError` naming what the format cannot store."""
    result: str | WriteResult = call(converter.write, parameters, name)
    # only lone surrogates cannot be encoded
    return WriteResult(result.encode("utf-8", errors="replace")) if isinstance(result, str) else result
