"""Today's calibration: the files of `[calibration] initial`, merged."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.calfiles import read_several
from kennfeld.calfiles.flash.description import IMAGE_ENDINGS, unwritable
from kennfeld.calfiles.format import Findings, FlashOrigin
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.project.schema import ProjectFile
from kennfeld.rbf import RBF

__all__ = ["described", "read_initial", "sized"]

_MOST_REMARKS = 5  # on one file


def read_initial(file: ProjectFile, findings: list[Finding]) -> ParameterSet | None:
    """The parameters of all initial files, later files winning; None, and findings, where one cannot be used."""
    return _Start(file, findings).parameters()


class _Start:
    """The files on their way to one set."""

    def __init__(self, file: ProjectFile, findings: list[Finding]) -> None:
        self.file, self.findings = file, findings
        self.merged = ParameterSet()
        self.origin: dict[str, str] = {}  # the file that each parameter is from
        self.image: FlashOrigin | None = None
        self.good = True

    def parameters(self) -> ParameterSet | None:
        """All of them; None where a finding says why there are none."""
        for name in self.file.calibration.initial:
            given = self._read(name)
            if given is not None:
                self._take(name, given)
        if self.good and any(ending in IMAGE_ENDINGS for ending in self.file.calibration.output):
            self.good = _has_image(self.file, self.image, self.findings)
            self.merged = self.merged.from_origin(self.image)
        return self._in_variant() if self.good else None

    def _wrong(self, *findings: Finding) -> None:
        self.findings += findings
        self.good = self.good and not findings

    def _read(self, name: str) -> ParameterSet | None:
        folder, description = self.file.folder, self.file.calibration.descriptions.get(name)
        absent = [one for one in (name, description) if one and not (folder / one).is_file()]
        if absent:
            self._wrong(*(_missing(self.file, one) for one in absent))
            return None
        try:
            given, remarks = _read(folder / name, folder / description if description else None)
        except InputError as error:
            self._wrong(*error.findings)
            return None
        self.findings += _told(name, remarks)
        return given

    def _take(self, name: str, given: ParameterSet) -> None:
        """Put the parameters of a file over those of the files before."""
        self._wrong(
            *(
                _clash(self.file, self.merged[member.name], member, self.origin[member.name], name)
                for member in given.parameters
                if member.name in self.merged and not _alike(self.merged[member.name], member)
            )
        )
        try:
            self.merged = self.merged.merged(given)
        except ArgumentError as error:
            self._wrong(Finding(name, str(error), "Files that share a group axis must agree on it."))
        self.origin |= dict.fromkeys(given, name)
        if isinstance(given.origin, FlashOrigin):
            self.image = given.origin
            self.findings += _identity(self.image)

    def _in_variant(self) -> ParameterSet | None:
        """The values of the variant that the project asks for."""
        variant = self.file.calibration.variant
        if not variant:
            return self.merged
        try:
            return self.merged.in_variant(variant)
        except ArgumentError as error:
            self._wrong(Finding(self.file.place("[calibration] variant"), str(error)))
            return None


def _told(name: str, remarks: Sequence[Finding]) -> list[Finding]:
    """What was left aside of a file, as long as it is little."""
    if len(remarks) > _MOST_REMARKS:
        message = f"{len(remarks)} remarks on what is left aside or not as usual"
        return [Finding(name, message, f"kennfeld info {name} lists them.", severity="remark")]
    return [replace(remark, severity="remark") for remark in remarks]


def _identity(flash: FlashOrigin) -> tuple[Finding, ...]:
    """A warning where the image is of another program than the A2L file."""
    from kennfeld.calfiles.a2l.reader import check_epk

    notes = Findings(flash.a2l.file)
    check_epk(flash.a2l, flash.image, notes)
    return notes.settle()


def _has_image(file: ProjectFile, image: FlashOrigin | None, findings: list[Finding]) -> bool:
    """Whether the images to be written have one to start from, of their kind."""
    wanted = [ending for ending in file.calibration.output if ending in IMAGE_ENDINGS]
    wrong = [found for ending in wanted if (found := unwritable(image, ending))]
    findings += [Finding(file.place("[calibration] output"), *found) for found in wrong]
    return not wrong


def _read(path: Path, a2l: Path | None) -> tuple[ParameterSet, tuple[Finding, ...]]:
    """The parameters of a calibration file, or the expansion of a static surrogate as one that may be fitted."""
    if path.suffix.casefold() != ".json" or not _is_surrogate(path):
        [given], remarks = read_several([path], a2l)
        return given, remarks
    from kennfeld.surrogate import StaticSurrogate, read_surrogate

    made = read_surrogate(path)
    if not isinstance(made, StaticSurrogate):
        message = f"{made.name} is a dynamic surrogate, which cannot be a parameter"
        raise InputError.of(path.name, message, f'Write [surrogates] and {made.name} = "{path.name}".')
    unit = made.units[-1] if made.units else ""
    return ParameterSet([RBF(made.name, made.expansion, made.inputs, unit=unit)]), ()


def _is_surrogate(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(200).decode("utf-8", errors="replace")
    from kennfeld.surrogate import recognises_surrogate

    return recognises_surrogate(head)


def _missing(file: ProjectFile, name: str) -> Finding:
    path = file.folder / name
    beside = [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []
    message = f"{name} is a folder" if path.is_dir() else f"there is no file {name}"
    return Finding(file.place("[calibration] initial"), message, nearest(path.name, beside) or "Check the path.")


def _alike(one: Parameter, other: Parameter) -> bool:
    """Whether both define the same table, whatever its values."""
    same = one.kind == other.kind and one.values.shape == other.values.shape
    return same and all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(one.axes, other.axes, strict=True))


def _clash(file: ProjectFile, one: Parameter, other: Parameter, first: str, second: str) -> Finding:
    if one.kind == other.kind and one.values.shape == other.values.shape:
        message = f"{one.name} has other breakpoints in {second} than in {first}"
    else:
        message = f"{one.name} is {described(one)} in {first} and {described(other)} in {second}"
    remedy = "Leave one of the files out, or remove the parameter from one of them."
    return Finding(file.place("[calibration] initial"), message, remedy)


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
