"""Read, write and describe calibration files; the formats are one line each in `_FORMATS`."""

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
from kennfeld.calfiles.unsupported_files import foreign_calibration, look_of
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["CalibrationFile", "ParameterSummary", "describe", "endings", "losses", "read", "read_several", "write"]

_SCRIPT = "MATLAB script"
_SETTINGS = ("bounds", "locks", "free axes")  # of a calibration, which files of values do not hold
_PLAIN = ("inputs", "extrapolation", "line breaks", *_SETTINGS)
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
        lacks=("kinds", "descriptions", "group units", *_PLAIN),
    ),
    Format(
        "CDFX",
        (".cdfx",),
        "cdfx.reader:recognises_cdfx",
        "cdfx.reader:read_cdfx",
        "cdfx.writer:write_cdfx",
        lacks=_PLAIN,
    ),
    Format(
        "DCM",
        (".dcm",),
        "dcm.lines:recognises_dcm",
        "dcm.reader:read_dcm",
        "dcm.update:write_dcm",
        lacks=("kinds", *_PLAIN),
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
    """One parameter in a line: what it is and between which values it moves."""

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
    """What is in a calibration file; `remarks` tells what a reader leaves aside."""

    path: Path
    kind: str
    parameters: tuple[ParameterSummary, ...]
    axes: tuple[Axis, ...]  # group axes
    texts: tuple[Text, ...]
    remarks: tuple[Finding, ...]


def endings() -> tuple[str, ...]:
    """The file endings that `write` knows."""
    return tuple(ending for known in _FORMATS for ending in known.endings)


def read(path: str | Path, a2l: str | Path | None = None) -> ParameterSet:
    """The parameters of a calibration file; its content, not its name, tells the format.

    `a2l` is the description of an image (Intel HEX, S-records); by default the A2L file of the same name beside it,
    or the only one there. Raises `InputError` with every finding: the thing, its value, the line, the mend.
    """
    parameters = _content(Path(path), a2l).parameters
    return parameters if parameters.origin is not None else parameters.from_origin(Path(path))


def read_several(
    paths: Iterable[str | Path], a2l: str | Path | None = None
) -> tuple[list[ParameterSet], tuple[Finding, ...]]:
    """The parameters of several files, and the remarks on what was left aside in them.

    `a2l` describes the images among them. Raises `InputError` with the findings of all files that cannot be read.
    """
    contents: list[ReadResult] = []
    findings: list[Finding] = []
    for path in paths:
        try:
            contents.append(_content(Path(path), a2l))
        except InputError as error:
            findings += error.findings
    if findings:
        raise InputError(findings)
    return [content.parameters for content in contents], tuple(one for content in contents for one in content.remarks)


def write(
    parameters: ParameterSet, path: str | Path, image: str | Path | None = None, a2l: str | Path | None = None
) -> tuple[Finding, ...]:
    """Write a calibration file; the ending (.dcm, .cdfx, .json, .xlsx, .csv for INCA's CVX, ...) chooses the format.

    The file is complete or untouched. A set that was read from a DCM file or a tune and is written as one gives the
    same file with other numbers. What should be said about the new file is returned. Raises `ArgumentError` for an
    unknown ending and `InputError` naming each parameter that the format cannot hold.

    An image (.hex, .s19, ...) is written over the one that the set was read from, or over `image`, which `a2l`
    describes; values are rounded to what the control unit can store.
    """
    target = Path(path)
    if image is not None:
        parameters = parameters.from_origin(_content(Path(image), a2l).parameters.origin)
    made = _format_for(target).write(parameters, target.name)
    _replace(target, made.raw)
    return made.remarks


def losses(parameters: ParameterSet, path: str | Path) -> tuple[Finding, ...]:
    """Return a remark on all that the format of a file has no place for, by the ending of its name.

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
    """The parameters that a format cannot hold, by name, each with the first reason.

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
    """What is in a calibration file: kind, parameters, group axes, texts, and what was left aside.

    Raises `InputError` where the file cannot be read.
    """
    content = _content(Path(path), a2l)
    members = content.parameters
    others: dict[str, list[str]] = {}
    for thing in members.others:
        others.setdefault(thing.name, []).append(thing.variant)
    summaries = tuple(_summary(member, others.get(member.name, [])) for member in members.parameters)
    return CalibrationFile(Path(path), content.kind, summaries, members.axes, members.texts, content.remarks)


def _summary(member: Parameter, others: Sequence[str]) -> ParameterSummary:
    known = member.values[~np.isnan(member.values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)
    shape, variants = member.values.shape, (member.variant, *others) if others or member.variant else ()
    said = member.unit, member.description
    return ParameterSummary(member.name, member.kind, shape, *said, low, high, member.functions, variants)


def _content(path: Path, a2l: str | Path | None = None) -> ReadResult:
    source = CalibrationSource(path.name, _bytes(path), path, None if a2l is None else Path(a2l))
    for known in _in_order(path):
        if known.recognises(source):
            with _no_collection():
                return known.read(source)
    raise InputError([_unknown(path, source)])


def _in_order(path: Path) -> list[Format]:
    """The formats, that of the file's ending first: the content decides, but others need not be loaded then."""
    ending = path.suffix.lower()
    return sorted(_FORMATS, key=lambda known: ending not in known.endings or known.name == _SCRIPT)


@contextmanager
def _no_collection() -> Iterator[None]:
    """A large file makes a million objects, all of them in use; looking for garbage takes a third of the time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _bytes(path: Path) -> bytes:
    """What the file holds; a large file of another kind is refused by its head."""
    try:
        with path.open("rb") as file:
            head = CalibrationSource(path.name, file.read(_HEAD), path)
            if head.is_binary and not any(known.recognises(head) for known in _FORMATS if known.binary):
                raise InputError([_foreign(path, head.raw, "holds binary data")])
            return head.raw + file.read()
    except FileNotFoundError:
        raise InputError([_missing(path)]) from None
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise InputError.of(str(path), message) from None


def _missing(path: Path) -> Finding:
    beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
    return Finding(str(path), "there is no such file", nearest(path.name, beside))


def _unknown(path: Path, source: CalibrationSource) -> Finding:
    lines = source.text.strip().splitlines()
    if not lines:
        return Finding(path.name, "is empty", f"Expected {_known()}.")
    fragment = fragment_of_a2l(source.text)
    if fragment:
        return Finding(path.name, *fragment)
    if recognises_a2l(source.text):
        message = "is an A2L description, which holds no values"
        return Finding(path.name, message, "Name the image that it describes (.hex, .s19), with --a2l where needed.")
    return _foreign(path, source.raw, f"begins with {lines[0][:60]!r}")


def _foreign(path: Path, head: bytes, message: str) -> Finding:
    known = foreign_calibration(path)
    if known is not None:
        return known
    look = look_of(head)
    return Finding(
        path.name, f"is no calibration file: it {f'looks like {look}' if look else message}", f"Expected {_known()}."
    )


def _known() -> str:
    return ", ".join(f"{known.name} ({', '.join(known.endings)})" for known in _FORMATS)


def _format_for(path: Path) -> Format:
    ending = path.suffix.lower()
    for known in _FORMATS:
        if ending in known.endings:
            return known
    guess = nearest(ending, endings())
    raise ArgumentError(f"path={str(path)!r} has no ending of a calibration file: {_known()}. {guess}".strip())


def _replace(target: Path, raw: bytes) -> None:
    try:
        write_whole(target, raw)
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise InputError.of(os.path.realpath(target), message, "Name another file.") from None
