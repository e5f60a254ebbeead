"""Today's calibration: the files of `[calibration] initial`, merged."""

from pathlib import Path

import numpy as np

from kennfeld.calfiles import read
from kennfeld.calfiles.flash import IMAGE_ENDINGS, Flash, unwritable
from kennfeld.calfiles.format import Notes
from kennfeld.errors import ArgumentError, Finding, InputError, nearest
from kennfeld.parameters import Parameter, ParameterSet
from kennfeld.project.schema import ProjectFile
from kennfeld.rbf import RBF

__all__ = ["described", "read_initial", "sized"]


def read_initial(file: ProjectFile, findings: list[Finding]) -> ParameterSet | None:
    """The parameters of all initial files, later files winning; None, and findings, where one cannot be used."""
    merged, origin, good = ParameterSet(), dict[str, str](), True
    image: Flash | None = None
    for name in file.calibration.initial:
        description = file.calibration.descriptions.get(name)
        absent = [one for one in (name, description) if one and not (file.folder / one).is_file()]
        if absent:
            findings += [_missing(file, one) for one in absent]
            good = False
            continue
        try:
            given = _read(file.folder / name, file.folder / description if description else None)
        except InputError as error:
            findings += error.findings
            good = False
            continue
        clashes = [
            _clash(file, merged[member.name], member, origin[member.name], name)
            for member in given.parameters
            if member.name in merged and not _alike(merged[member.name], member)
        ]
        findings += clashes
        try:
            merged = merged.merged(given)
        except ArgumentError as error:
            mend = "Files that share a group axis must agree on it."
            findings.append(Finding(name, str(error), mend))
            good = False
        good = good and not clashes
        origin |= dict.fromkeys(given, name)
        if isinstance(given.origin, Flash):
            image = given.origin
            findings += _identity(image)
    if good and any(ending in IMAGE_ENDINGS for ending in file.calibration.output):
        good = _has_image(file, image, findings)
        merged = merged.from_origin(image)
    return _in_variant(file, merged, findings) if good else None


def _in_variant(file: ProjectFile, given: ParameterSet, findings: list[Finding]) -> ParameterSet | None:
    """The values of the variant that the project asks for."""
    if not file.calibration.variant:
        return given
    try:
        return given.in_variant(file.calibration.variant)
    except ArgumentError as error:
        findings.append(Finding(file.place("[calibration] variant"), str(error)))
        return None


def _identity(flash: Flash) -> tuple[Finding, ...]:
    """A warning where the image is of another program than the A2L file."""
    from kennfeld.calfiles.a2l.reader import say_identity

    notes = Notes(flash.a2l.file)
    say_identity(flash.a2l, flash.image, notes)
    return notes.settle()


def _has_image(file: ProjectFile, image: Flash | None, findings: list[Finding]) -> bool:
    """Whether the images to be written have one to start from, of their kind."""
    wanted = [ending for ending in file.calibration.output if ending in IMAGE_ENDINGS]
    wrong = [found for ending in wanted if (found := unwritable(image, ending))]
    findings += [Finding(file.place("[calibration] output"), *found) for found in wrong]
    return not wrong


def _read(path: Path, a2l: Path | None) -> ParameterSet:
    """The parameters of a calibration file, or the expansion of a static surrogate as one that may be fitted."""
    if path.suffix.casefold() != ".json" or not _is_surrogate(path):
        return read(path, a2l)
    from kennfeld.surrogate import StaticSurrogate, read_surrogate

    made = read_surrogate(path)
    if not isinstance(made, StaticSurrogate):
        what = f"{made.name} is a dynamic surrogate, which cannot be a parameter"
        raise InputError.of(path.name, what, f'Write [surrogates] and {made.name} = "{path.name}".')
    unit = made.units[-1] if made.units else ""
    return ParameterSet([RBF(made.name, made.expansion, made.inputs, unit=unit)])


def _is_surrogate(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(200).decode("utf-8", errors="replace")
    from kennfeld.surrogate import recognises_surrogate

    return recognises_surrogate(head)


def _missing(file: ProjectFile, name: str) -> Finding:
    path = file.folder / name
    beside = [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []
    what = f"{name} is a folder" if path.is_dir() else f"there is no file {name}"
    return Finding(file.place("[calibration] initial"), what, nearest(path.name, beside) or "Check the path.")


def _alike(one: Parameter, other: Parameter) -> bool:
    """Whether both define the same table, whatever its values."""
    same = one.kind == other.kind and one.values.shape == other.values.shape
    return same and all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(one.axes, other.axes, strict=True))


def _clash(file: ProjectFile, one: Parameter, other: Parameter, first: str, second: str) -> Finding:
    if one.kind == other.kind and one.values.shape == other.values.shape:
        what = f"{one.name} has other breakpoints in {second} than in {first}"
    else:
        what = f"{one.name} is {described(one)} in {first} and {described(other)} in {second}"
    mend = "Leave one of the files out, or remove the parameter from one of them."
    return Finding(file.place("[calibration] initial"), what, mend)


def described(parameter: Parameter) -> str:
    """Kind and size, as a message gives them.

    >>> from kennfeld.parameters import Curve
    >>> described(Curve("C", [0, 1], [2, 3]))
    'a curve of 2 values'
    """
    if parameter.kind == "scalar":
        return "a scalar"
    return f"a {parameter.kind} of {sized(parameter.values.shape)} values"


def sized(shape: tuple[int, ...]) -> str:
    """A shape as a message gives it: `18 x 14`."""
    return " x ".join(map(str, shape)) or "1"
