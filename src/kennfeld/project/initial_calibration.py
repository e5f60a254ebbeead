"""Reads and merges the files of `[calibration] initial`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, Findings, Fix, InputError, Location
from kennfeld.base.file_errors import files_beside
from kennfeld.base.formatting import nearest, quoted, size_text, toml_text
from kennfeld.calfiles import read_several
from kennfeld.calfiles.a2l.origin import FlashOrigin
from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import RBF
from kennfeld.files import Role, identify
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.graph.interpolation import regrid
from kennfeld.project.schema import ProjectFile
from kennfeld.project.value_forms import DIRECTIONS

MAX_REMARKS = 5  # on one file


def read_initial(file: ProjectFile, findings: Findings) -> ParameterSet | None:
    """Return the merged parameters of all initial files; None, with findings, if one of them cannot be used.

    Later files override earlier ones.
    """
    return _InitialFiles(file, findings).parameters()


class _InitialFiles:
    """Merges the initial files one by one."""

    def __init__(self, file: ProjectFile, findings: Findings) -> None:
        self.file, self.findings = file, findings
        self.merged = ParameterSet()
        self.origin: dict[str, str] = {}  # the file that each parameter is from
        self.image: FlashOrigin | None = None
        self.is_valid = True

    def parameters(self) -> ParameterSet | None:
        """Return the merged parameters, None if a finding is an error."""
        for name in self.file.calibration.files:
            parameters = self._read(name)
            if parameters is not None:
                self._take(name, parameters)
        if self.is_valid and any(ending in IMAGE_ENDINGS for ending in self.file.calibration.output):
            self.is_valid = _has_image(self.file, self.image, self.findings)
            # an image is written as a change of the one that was read
            self.merged = self.merged.from_origin(self.image)
        return self._in_variant() if self.is_valid else None

    def _fail(self, *findings: Finding) -> None:
        self.findings.add(*findings)
        self.is_valid = self.is_valid and not findings

    def _read(self, name: str) -> ParameterSet | None:
        folder, description = self.file.folder, self.file.calibration.descriptions.get(name)
        missing = [path for path in (name, description) if path and not (folder / path).is_file()]
        if missing:
            self._fail(*(_missing(self.file, path) for path in missing))
            return None
        try:
            parameters, remarks = read_initial_file(folder / name, folder / description if description else None)
        except InputError as error:
            self._fail(*error.findings)
            return None
        self.findings.add(*_limit_remarks(name, remarks))
        return parameters

    def _take(self, name: str, parameters: ParameterSet) -> None:
        self._fail(
            *(
                _clash(self.file, self.merged[member.name], member, self.origin[member.name], name)
                for member in parameters.parameters
                if member.name in self.merged
                and not self.merged[member.name].has_grid_of(member)
                and not self._is_given_axes(self.merged[member.name], member)
            )
        )
        try:
            # what the format of a later file cannot state, such as limits, stays as an earlier one says
            later = parameters.completed(self.merged)
            self.merged = self._onto_group_axes(later).merged(later)
        except ArgumentError as error:
            remedy = "Files with the same group axis must agree on its breakpoints."
            self._fail(Finding(Location(name), str(error), remedy))
        self.origin |= dict.fromkeys(parameters, name)
        if isinstance(parameters.origin, FlashOrigin):
            self.image = parameters.origin
            self.findings.add(*_identity(self.image))

    def _is_given_axes(self, old: Parameter, new: Parameter) -> bool:
        """Return if the project states each axis in which two tables differ, or fits its breakpoints.

        The breakpoints of the files then do not matter, or are those of an earlier fit.
        """
        if old.kind != new.kind or isinstance(new, RBF) or len(old.axes) != len(new.axes):
            return False
        entry = self.file.parameters.get(new.name)
        stated = {} if entry is None else entry.axes
        return all(
            direction in stated or not {a.name, b.name}.isdisjoint(self.file.axes)
            for direction, a, b in zip(DIRECTIONS, old.axes, new.axes, strict=False)
            if not np.array_equal(a.breakpoints, b.breakpoints)
        )

    def _onto_group_axes(self, later: ParameterSet) -> ParameterSet:
        """Return the merged tables on the group axes of a later file that the project states or fits."""
        moved = {axis.name: axis for table in later.parameters for axis in table.axes if axis.name in self.file.axes}
        staying = [table for table in self.merged.parameters if table.name not in later]
        changed = []
        for table in staying:
            axes = tuple(moved.get(axis.name, axis) for axis in table.axes)
            if any(not np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(axes, table.axes, strict=True)):
                values = regrid(table.values, table.axes, axes, table.extrapolation)
                if values.shape == table.values.shape:
                    changed.append(table.changed(axes=axes, values=values))
                else:
                    # limits of single values have no counterpart on a grid of another size
                    changed.append(table.changed(axes=axes, values=values, lower=-np.inf, upper=np.inf, locked=False))
        if not changed:
            return self.merged
        names = [table.name for table in changed]
        replaced = [name for name in later if name in self.merged]
        return self.merged.without([*names, *replaced]).merged(ParameterSet(changed))

    def _in_variant(self) -> ParameterSet | None:
        variant = self.file.calibration.variant
        if not variant:
            return self.merged
        try:
            return self.merged.in_variant(variant)
        except ArgumentError as error:
            self._fail(Finding(self.file.location("calibration", "variant"), str(error)))
            return None


def _limit_remarks(name: str, remarks: Sequence[Finding]) -> list[Finding]:
    if len(remarks) > MAX_REMARKS:
        message = f"{len(remarks)} entries were skipped or are unusual"
        return [Finding(Location(name), message, f"List them with kennfeld info {name}.", severity="remark")]
    return [replace(remark, severity="remark") for remark in remarks]


def _identity(flash: FlashOrigin) -> tuple[Finding, ...]:
    """Return a warning if image and A2L file belong to different programs."""
    from kennfeld.calfiles.a2l.reader import check_epk

    findings = FileFindings(flash.a2l.file)
    check_epk(flash.a2l, flash.image, findings)
    return findings.finish()


def _has_image(file: ProjectFile, image: FlashOrigin | None, findings: Findings) -> bool:
    """Return if the initial files contain an image of each format to be written."""
    from kennfeld.calfiles.a2l.image_files import unwritable

    wanted = [ending for ending in file.calibration.output if ending in IMAGE_ENDINGS]
    reasons = [reason for ending in wanted if (reason := unwritable(image, ending))]
    for reason in reasons:
        findings.error(file.location("calibration", "output"), *reason)
    return not reasons


def read_initial_file(path: Path, a2l: Path | None) -> tuple[ParameterSet, tuple[Finding, ...]]:
    """Return the parameters of a calibration file, or the expansion of a static surrogate as a parameter."""
    if identify(path).role is not Role.SURROGATE:
        [parameters], remarks = read_several([path], a2l)
        return parameters, remarks
    from kennfeld.surrogate.surrogate_file import read_surrogate
    from kennfeld.surrogate.surrogate_models import StaticSurrogate

    surrogate = read_surrogate(path)
    if not isinstance(surrogate, StaticSurrogate):
        message = f"{surrogate.name} is a dynamic surrogate, which cannot be a parameter"
        remedy = f"Write [surrogates] and {quoted(surrogate.name)} = {toml_text(path.name)}."
        raise InputError.of(Location(path.name), message, remedy)
    unit = surrogate.units[-1] if surrogate.units else ""
    return ParameterSet([RBF(surrogate.name, surrogate.expansion, surrogate.inputs, unit=unit)]), ()


def _missing(file: ProjectFile, name: str) -> Finding:
    path = file.folder / name
    message = f"{name} is a folder" if path.is_dir() else f"file {name} does not exist"
    remedy = nearest(path.name, files_beside(path)) or "Check the path."
    return Finding(file.location("calibration", "initial"), message, remedy, fixes=_without_file(file, name))


def _without_file(file: ProjectFile, name: str) -> tuple[Fix, ...]:
    """Return the fixes of an initial file that is missing: each alternative beside it, or to start without it."""
    files, keys = list(file.calibration.files), ("calibration", "initial")
    if file.calibration.descriptions or name not in files:  # images belong to their A2L files
        return ()
    others = [other for other in file.alike(name) if other not in files]
    replaced = (Fix.exchange(f"Read {other}", keys, files, name, other) for other in others[:2])
    return (*replaced, Fix.exchange(f"Start without {name}", keys, files, name))


def _clash(file: ProjectFile, old: Parameter, new: Parameter, first: str, second: str) -> Finding:
    if old.kind == new.kind and old.values.shape == new.values.shape:
        message = f"{old.name} has {_difference(old, new)} in {first} and {second}"
    else:
        message = f"{old.name} is {describe_parameter(old)} in {first} and {describe_parameter(new)} in {second}"
    remedy = "Remove one of the files, or the parameter from one of them."
    return Finding(file.location("calibration", "initial"), message, remedy)


def _difference(old: Parameter, new: Parameter) -> str:
    """Return what differs between two parameters of the same kind and size."""
    if not isinstance(old, RBF) or not isinstance(new, RBF):
        return "different breakpoints"
    if old.coordinates != new.coordinates:
        return "different numbers of inputs"
    return "different kernels" if old.kernel != new.kernel else "different hinges"


def describe_parameter(parameter: Parameter) -> str:
    """Return kind and size of a parameter.

    >>> from kennfeld.domain.parameters import Curve
    >>> describe_parameter(Curve("C", [0, 1], [2, 3]))
    'a curve of 2 values'
    """
    if parameter.kind == "scalar":
        return "a scalar"
    return f"a {parameter.kind} of {format_shape(parameter.values.shape)} values"


def format_shape(shape: tuple[int, ...]) -> str:
    """Return a shape as `18 x 14`."""
    return size_text(shape) or "1"
