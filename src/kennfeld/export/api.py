"""Export of a function with its calibration: `export_function`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.fmi_platform import platform_tuple
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import StorageRounding
from kennfeld.export.c_code import write_c
from kennfeld.export.comparison import CodeComparison, compare
from kennfeld.export.cross_compiler import PLATFORMS, CrossCompiler, Platform
from kennfeld.export.host_compiler import HostCompiler
from kennfeld.export.names import c_identifier
from kennfeld.export.prepared import Precision, PreparedFunction, prepare
from kennfeld.export.stored_numbers import with_stored_numbers
from kennfeld.models import Model
from kennfeld.models.model import bind_scalars
from kennfeld.optimize.problem.arguments import Start, parameters_of
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.setup import start_parameters
from kennfeld.project import Project
from kennfeld.project.folder_replacement import move, scratch_folder
from kennfeld.project.replaced_values import replaced_value_findings
from kennfeld.project.simulation import replace_parameters

Language = Literal["c", "fmu", "m"]
NO_COMPILER = "this machine has no C compiler"


@dataclass(frozen=True)
class ExportSettings:
    """Settings of an export.

    Attributes:
        to: "c" for C99, "fmu" for an FMU, "m" for a function of MATLAB.
        name: identifier with which the names of the code begin; by default that of the function.
        outputs: named nodes that are computed; by default the outputs of the function.
        precision: "double", or "float" for C.
        fmi: version of FMI, 2 or 3.
        inputs: of an FMU, "end" if inputs that are set before a step are those at its end, "start" if at its start.
        step: of an FMU in s; by default the step of the function.
        platforms: machines for which an FMU has a library in addition to this one, such as "x86_64-windows".
        stored: C code holds values as a control unit stores them, by the rounding of the project.
        check: compile the code and compare it with a simulation, if there are data and a compiler.
    """

    to: Language = "c"
    name: str = ""
    outputs: tuple[str, ...] = ()
    precision: Precision = "double"
    fmi: Literal[2, 3] = 2
    inputs: Literal["start", "end"] = "end"
    step: float | None = None
    platforms: tuple[Platform, ...] = ()
    stored: bool = False
    check: bool = True

    def __post_init__(self) -> None:
        choices = {"to": Language, "precision": Precision, "inputs": Literal["start", "end"], "fmi": Literal[2, 3]}
        for name, kind in choices.items():
            value, allowed = getattr(self, name), get_args(kind)
            if value not in allowed:
                raise ArgumentError(f"{name}={value!r} must be {' or '.join(map(repr, allowed))}")
        if self.name and c_identifier(self.name) != self.name:
            # a path in particular: its folder would be dropped without a word
            remedy = f"for example {c_identifier(self.name)!r}"
            raise ArgumentError(f"name={self.name!r} must be an identifier of C, {remedy}")
        if unknown := [platform for platform in self.platforms if platform not in PLATFORMS]:
            raise ArgumentError(f"platforms: unknown {unknown[0]!r}; known are {', '.join(PLATFORMS)}")
        if self.platforms and self.to != "fmu":
            raise ArgumentError(f"platforms={list(self.platforms)} is for to='fmu', not for to={self.to!r}")
        for platform in self.platforms:
            if platform != platform_tuple():
                CrossCompiler.of(platform)  # before anything else takes time
        if self.precision == "float" and self.to != "c":
            raise ArgumentError(f"precision='float' is for to='c', not for to={self.to!r}")
        if self.stored and self.to != "c":
            raise ArgumentError(f"stored=True is for to='c', not for to={self.to!r}")
        if self.step is not None and not self.step > 0:
            raise ArgumentError(f"step={self.step!r} must be > 0")


@dataclass(frozen=True)
class Export:
    """Files that were written, and what is worth knowing about them.

    Attributes:
        files: their paths.
        findings: remarks and warnings, such as on names that are not identifiers of C.
        comparison: deviations of the compiled code from the simulation; None without data or compiler.

    >>> export_function("y = 2 * %n rpm%", folder="exported", name="line").findings[0].severity
    'remark'
    """

    files: tuple[Path, ...]
    findings: tuple[Finding, ...] = ()
    comparison: CodeComparison | None = None


@dataclass(frozen=True)
class ExportContents:
    """Files of an export that are not written yet, by their names; see `Export`."""

    name: str
    files: Mapping[str, str | bytes]
    findings: tuple[Finding, ...] = ()
    comparison: CodeComparison | None = None

    def written(self, folder: Path) -> Export:
        """Write the files together."""
        return Export(write_files(self.files, folder), self.findings, self.comparison)


def export_function(
    function: Project | Model | str,
    parameters: Start | None = None,
    folder: str | Path = ".",
    *,
    to: Language = "c",
    name: str = "",
    outputs: Sequence[str] = (),
    precision: Precision = "double",
    fmi: Literal[2, 3] = 2,
    inputs: Literal["start", "end"] = "end",
    step: float | None = None,
    platforms: Sequence[Platform] = (),
    stored: bool = False,
) -> Export:
    """Write a function with its calibration as C99, as an FMU or as a function of MATLAB.

    Files are replaced together: all of them or none. Code in double precision computes the same bits as `simulate` if
    no function of the C library is involved, such as exp.

    Args:
        function: a project, whose data check the code, a model, or formula text.
        parameters: the calibration, or numbers by name; by default the values of the project or model.
        folder: where to write.
        to: "c" for C99, "fmu" for an FMU, "m" for a function of MATLAB.
        name: identifier with which the names of the code begin; by default that of the function.
        outputs: named nodes that are computed; by default the outputs of the function.
        precision: "double", or "float" for C.
        fmi: version of FMI, 2 or 3.
        inputs: of an FMU, "end" if inputs that are set before a step are those at its end, "start" if at its start.
        step: of an FMU in s; by default the step of the function.
        platforms: machines for which an FMU has a library in addition to this one: "x86_64-windows", "x86_64-linux",
            "aarch64-linux", "x86_64-darwin", "aarch64-darwin". They need the extra `platforms`.
        stored: C code holds values as a control unit stores them, by the rounding of the project: as whole numbers of
            8, 16 or 32 bits, which a lookup converts.

    Returns:
        The files written, with remarks.

    Raises:
        InputError: the function calls code that cannot be written, or a name or value does not fit the language.

    >>> done = export_function("y = 2 * x + k", {"k": 1.0}, "exported", name="line")
    >>> [path.name for path in done.files]
    ['line.c', 'line.h']
    """
    settings = ExportSettings(to, name, tuple(outputs), precision, fmi, inputs, step, tuple(platforms), stored)
    if isinstance(function, Project):
        values = None if parameters is None else start_parameters(parameters, function.problem().model)
        return export_project(function, values, Path(folder), settings)
    model = _model(function, parameters)
    values = start_parameters(parameters or {}, model)
    model = bind_scalars(model, values)
    return _contents(model, values, settings, Location(model.name), model.name, None).written(Path(folder))


def export_project(project: Project, parameters: ParameterSet | None, folder: Path, settings: ExportSettings) -> Export:
    """Write the function of a project; see `export_function`."""
    return project_contents(project, parameters, settings).written(folder)


def project_contents(project: Project, parameters: ParameterSet | None, settings: ExportSettings) -> ExportContents:
    """Return the files of the function of a project; see `export_function`."""
    problem = project.problem()
    values = replace_parameters(problem, parameters)
    file = project.file.model.file
    name = Path(file.rpartition(":")[0] or file).stem
    location = Location(project.path.name)
    data = None if project.is_partitioned else problem
    contents = _contents(problem.model, values, settings, location, name, data, problem.rounding)
    replaced = () if parameters is None else replaced_value_findings(problem, parameters, location)
    return replace(contents, findings=(*replaced, *contents.findings))


def _model(function: Model | str, parameters: Start | None) -> Model:
    if isinstance(function, Model):
        return function
    from kennfeld.models.formula import formula

    return formula(function, parameters=[*parameters_of(parameters or {})])


def _contents(
    model: Model,
    values: ParameterSet,
    settings: ExportSettings,
    location: Location,
    name: str,
    problem: Problem | None,
    rounding: StorageRounding | None = None,
) -> ExportContents:
    findings = Findings()
    # an FMU has the names of the function
    renamed = Findings() if settings.to == "fmu" else findings
    function = prepare(model, values, settings.name or name, location, renamed, settings.outputs, settings.precision)
    # what is compared is the C code, which says nothing about a function of MATLAB
    checked = settings.check and settings.to != "m"
    if settings.stored:
        if rounding is None:
            remedy = 'Write rounding = "joint" and storage = "....a2l" in [calibration], or a step for each parameter.'
            raise InputError.of(location, "it is not known how a control unit stores the values", remedy)
        function, remarks = with_stored_numbers(function, rounding)
        findings.add(*remarks)
    comparison = _checked(function, settings, problem, location, findings) if checked else None
    files = _files(function, settings, model.step or _step_of(problem), location, findings)
    return ExportContents(function.name, files, tuple(findings), comparison)


def _files(
    function: PreparedFunction, settings: ExportSettings, step: float | None, location: Location, findings: Findings
) -> Mapping[str, str | bytes]:
    if settings.to == "c":
        return write_c(function, settings.precision)
    if settings.to == "m":
        from kennfeld.export.matlab_code import write_matlab

        return write_matlab(function)
    from kennfeld.export.fmu import FmuSettings, is_fixed_step, require_step, write_fmu

    fixed = is_fixed_step(function)
    length = require_step(settings.step or step, fixed, location)
    return write_fmu(
        function, FmuSettings(settings.fmi, settings.inputs, length, fixed, settings.platforms), location, findings
    )


def _step_of(problem: Problem | None) -> float | None:
    """Return the usual distance of the samples of a problem in s; None if none has time stamps."""
    times = [data.time for data in problem.datasets if data.time is not None] if problem is not None else []
    steps = np.concatenate([np.diff(time) for time in times if time.size > 1] or [np.zeros(0)])
    # rounded, as time stamps carry the rounding of their sums
    return float(f"{np.median(steps):.9g}") if steps.size else None


def _checked(
    function: PreparedFunction,
    settings: ExportSettings,
    problem: Problem | None,
    location: Location,
    findings: Findings,
) -> CodeComparison | None:
    if problem is None:
        return None
    compiler = HostCompiler.find()
    if compiler is None:
        findings.remark(location, f"the code is not checked: {NO_COMPILER}", "Install gcc or clang, or set CC.")
        return None
    return compare(function, settings.precision, compiler, problem)


def write_files(files: Mapping[str, str | bytes], folder: Path) -> tuple[Path, ...]:
    """Write files of a folder together: all or none.

    Raises:
        InputError: they cannot be written.
    """
    names = sorted(files)
    with convert_errors(folder, "cannot be written", "Name another folder with -o."), scratch_folder(folder) as scratch:
        for name in names:
            content = files[name]
            (scratch / name).write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        move(names, scratch, folder)
    return tuple(folder / name for name in names)
