"""Into the control unit: rounding to storage, code of the function, and the files that are written together."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from kennfeld.app.answer import finite
from kennfeld.app.questions.existing_files import ExistingFiles
from kennfeld.app.questions.exports import formats
from kennfeld.app.session.calibration_source import SourceName, calibration_files, initial_image
from kennfeld.app.session.control_unit import (
    FOLDER,
    Applied,
    applied_values,
    code_of,
    existing_files,
    rounded_set,
    rounding_of,
    storage_keys,
    unit_files,
    write_together,
)
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, Finding
from kennfeld.base.fmi_platform import platform_tuple
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import number
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.storage import MAX_SHIFT, RoundingMethod
from kennfeld.export.api import ExportSettings
from kennfeld.export.comparison import CodeComparison
from kennfeld.export.cross_compiler import PLATFORMS, CrossCompiler, Platform
from kennfeld.export.host_compiler import HostCompiler
from kennfeld.export.prepared import Precision
from kennfeld.optimize.rounding.outcome import LabelRounding, RoundingResult

MAX_PREVIEW = 300_000  # characters
MAX_ROWS = 5000  # labels that are listed


@dataclass(frozen=True)
class StorageRow:
    """A free parameter, and how it is stored.

    Attributes:
        values: number of its values.
        step: distance of storable values; null if it is not known.
        bits: of a stored number; 0 if unknown.
        least: the end of the range that can be stored; null if it is unknown.
        largest: its other end.
        typed: the step in the project file, which precedes that of the A2L file.
        reason: why it is not rounded, a clause; empty if it is.
    """

    name: str
    unit: str
    values: int
    step: float | None
    bits: int
    least: float | None
    largest: float | None
    typed: float | None
    reason: str


@dataclass(frozen=True)
class ControlUnit:
    """The choices of the screen of the control unit.

    Attributes:
        method: in the project file; empty if nothing is rounded.
        max_shift: the largest distance of a rounded value from the fit, in steps.
        storage: the A2L file in the project file.
        image: true if the initial values are those of an image, whose A2L file states their storage.
        descriptions: A2L files of the folder.
        rows: the free parameters, `count` of them.
        compiler: the C compiler of this computer; empty if there is none.
        platform: this machine, as FMI 3.0 names it.
        platforms: other machines for which an FMU can have a library.
        cross: why it cannot on this computer; empty if it can.
        formats: endings of calibration files that can be written, those of the project first.
        own: those of the project.
        folder: where files are written, unless another one is named.
    """

    method: Literal["", "nearest", "joint"]
    max_shift: float
    storage: str
    image: bool
    descriptions: Sequence[str]
    rows: Sequence[StorageRow]
    count: int
    compiler: str
    platform: str
    platforms: Sequence[Platform]
    cross: str
    formats: Sequence[str]
    own: Sequence[str]
    folder: str


@dataclass(frozen=True)
class StorageEdit:
    """Steps of parameters, null to remove one; the A2L file, empty to remove it, null to leave it as it is."""

    steps: Mapping[str, float | None]
    storage: str | None = None


@dataclass(frozen=True)
class AskedRounding:
    """A set of values that is rounded."""

    source: SourceName
    method: RoundingMethod


@dataclass(frozen=True)
class RoundedError:
    """RMSE of a criterion on a dataset, before and after rounding by either method."""

    criterion: str
    dataset: str
    use: str
    unit: str
    unrounded: float | None
    nearest: float | None
    joint: float | None


@dataclass(frozen=True)
class RoundedLabel:
    """The rounding of a parameter, or of the breakpoints of an axis.

    Attributes:
        moved: values that are not the storable ones nearest to the fit.
        largest_shift: the largest distance from the fit, in steps.
        share: of what rounding costs.
    """

    name: str
    step: float
    bits: int
    values: int
    moved: int
    largest_shift: float | None
    share: float | None


@dataclass(frozen=True)
class AskedTrial:
    """A set of values that is rounded with finer storage of some labels."""

    source: SourceName
    method: RoundingMethod
    labels: Sequence[str]


@dataclass(frozen=True)
class FinerRow:
    """Labels that are stored in 256 steps for each one.

    Attributes:
        steps: by name.
        bits: true if their bits are known to be 8.
        errors: in the order of those of the rounding.
        size: bytes of all rounded labels; null if unknown.
    """

    steps: Mapping[str, float]
    bits: bool
    errors: Sequence[RoundedError]
    size: int | None


@dataclass(frozen=True)
class RoundingReply:
    """A rounded set of values.

    Attributes:
        method: by which the values are rounded.
        labels: those with the largest share first.
        trials: labels whose finer storage is worth a trial.
        advice: the label that would profit most from it; empty if none stands out.
        size: bytes of all rounded labels; null if unknown.
        run: number of the run whose fit was rounded, in place of values that the run had rounded; 0 if none had.
    """

    method: RoundingMethod
    errors: Sequence[RoundedError]
    labels: Sequence[RoundedLabel]
    trials: Sequence[Sequence[str]]
    advice: str
    size: int | None
    findings: Sequence[str]
    seconds: float
    run: int


@dataclass(frozen=True)
class AskedCode:
    """The function as C code with a set of values.

    Attributes:
        rounding: how the values are rounded; empty for the values as they are.
        check: compile the code and compare it with the simulation.
    """

    source: SourceName
    rounding: Applied = ""
    precision: Precision = "double"
    name: str = ""
    check: bool = False


@dataclass(frozen=True)
class DeviationRow:
    """The largest deviation of an output from the simulation, null if only one of both is NaN; and its range."""

    name: str
    unit: str
    largest: float | None
    range: float


@dataclass(frozen=True)
class ComparedCode:
    """Compiled code over all datasets, in comparison with the simulation."""

    compiler: str
    samples: int
    exact: bool
    outputs: Sequence[DeviationRow]


@dataclass(frozen=True)
class CodeReply:
    """C code.

    Attributes:
        name: of the code.
        text: of its file.
        lines: of the whole file.
        size: bytes of its tables.
        compared: null if it was not compiled.
    """

    name: str
    text: str
    lines: int
    size: int
    findings: Sequence[str]
    compared: ComparedCode | None


@dataclass(frozen=True)
class UnitCommand:
    """Files that are written together.

    Attributes:
        rounding: how the values are rounded; empty for the values as they are.
        languages: in which the function is written.
        formats: endings of calibration files.
        fmi: version of FMI.
        inputs: whether inputs of an FMU that are set before a step count at its start or its end.
        step: of an FMU in s; null for that of the function or its data.
        platforms: machines for which an FMU has a library in addition to this one.
        folder: of the project's folder.
        signals: write what the function calculates over all data, as MDF.
        force: replace files that exist with another content.
    """

    source: SourceName
    languages: Sequence[Literal["c", "fmu", "m"]]
    formats: Sequence[str]
    rounding: Applied = ""
    precision: Precision = "double"
    name: str = ""
    fmi: Literal[2, 3] = 2
    inputs: Literal["start", "end"] = "end"
    step: float | None = None
    platforms: Sequence[Platform] = ()
    folder: str = FOLDER
    signals: bool = False
    force: bool = False


@dataclass(frozen=True)
class WrittenUnit:
    """Files that were written, relative to the folder of the project."""

    files: Sequence[str]
    findings: Sequence[str]
    compared: ComparedCode | None


def control_unit(session: Session) -> ControlUnit:
    """Return how the free parameters are stored, and what can be written."""
    view, rounding, known = session.require_view(), rounding_of(session), formats(session)
    calibration = session.settings.get("calibration")
    storage = str(calibration.get("storage", "")) if isinstance(calibration, dict) else ""
    problem = view.model.problem
    names = [name for name in problem.free_names if name in view.now.parameters]
    compiler = HostCompiler.find()
    return ControlUnit(
        method="" if rounding is None else rounding.method,
        max_shift=MAX_SHIFT if rounding is None else rounding.max_shift,
        storage=storage,
        image=initial_image(session) is not None,
        descriptions=[name for name, kind in calibration_files(session.path.parent) if kind == "A2L"],
        rows=[_storage_row(session, view.now.parameters[name]) for name in names[:MAX_ROWS]],
        count=len(names),
        compiler="" if compiler is None else compiler.name,
        platform=platform_tuple(),
        platforms=[each for each in PLATFORMS if each != platform_tuple()],
        cross=_why_no_cross_compiler(),
        formats=known.formats,
        own=known.own,
        folder=FOLDER,
    )


def _storage_row(session: Session, table: Parameter) -> StorageRow:
    rounding = rounding_of(session)
    grid = None if rounding is None or table.kind == "rbf" else rounding.grids.get(table.name)
    least, largest = (None, None) if grid is None else map(finite, grid.range)
    return StorageRow(
        name=table.name,
        unit=table.unit,
        values=table.size,
        step=None if grid is None else grid.step,
        bits=0 if grid is None else grid.bits,
        least=least,
        largest=largest,
        typed=_typed_step(session, table.name),
        reason="" if grid is not None else _reason(session, table),
    )


def _typed_step(session: Session, name: str) -> float | None:
    parameters = session.settings.get("parameters")
    entry = parameters.get(name) if isinstance(parameters, dict) else None
    step = entry.get("step") if isinstance(entry, dict) else None
    return float(step) if isinstance(step, int | float) else None


def _reason(session: Session, table: Parameter) -> str:
    rounding = rounding_of(session)
    if table.kind == "rbf":
        return "it is an expansion"
    if rounding is None:
        return "its step is not known"
    missing = f"{rounding.source} does not define it" if rounding.source else "its step is not known"
    return rounding.unrounded.get(table.name, missing)


def set_storage(session: Session, asked: StorageEdit) -> None:
    """Set steps of parameters, or the A2L file that states them, as one change of the project file."""
    for name, step in asked.steps.items():
        if name not in session.parameters:
            raise ArgumentError(f"{name[:100]} is not a parameter of the project")
        if step is not None:
            number(step, "step", name, above=0)
    session.do(storage_keys(session, asked.steps, asked.storage))


def rounding(session: Session, asked: AskedRounding) -> RoundingReply:
    """Round a set of values; nothing is changed."""
    rounded = rounded_set(session, asked.source, asked.method)
    outcome = rounded.outcome
    return RoundingReply(
        method=outcome.method,
        errors=_errors(session, outcome, rounded.uses),
        labels=[_label(each) for each in sorted(outcome.labels, key=lambda each: -each.share)],
        trials=rounded.trials,
        advice=outcome.finer,
        size=rounded.size,
        findings=_texts(rounded.findings),
        seconds=rounded.seconds,
        run=rounded.run,
    )


def _errors(session: Session, outcome: RoundingResult, uses: Mapping[str, str]) -> list[RoundedError]:
    model = session.require_view().model
    units = {each.node: model.unit(k) for k, each in enumerate(model.problem.criteria)}
    rows = []
    for key, unrounded in outcome.unrounded.items():
        criterion, _, dataset = key.partition("/")
        errors = (finite(each[key]) for each in (outcome.nearest, outcome.joint))
        unit = units.get(criterion.partition(" (")[0], "")
        rows.append(RoundedError(criterion, dataset, uses.get(dataset, ""), unit, finite(unrounded), *errors))
    return rows


def _label(own: LabelRounding) -> RoundedLabel:
    shift, share = finite(own.largest_shift), finite(own.share)
    return RoundedLabel(own.name, own.step, own.bits, own.values, own.moved, shift, share)


def finer_storage(session: Session, asked: AskedTrial) -> FinerRow:
    """Round a set of values with finer storage of some labels; nothing is changed."""
    rounded = rounded_set(session, asked.source, asked.method)
    if tuple(asked.labels) not in rounded.trials:
        raise ArgumentError("the labels have changed; round the values again")
    own = rounded.try_finer(asked.labels)
    bits = {each.name: each.bits for each in own.outcome.labels}
    known = all(bits.get(name, 0) for name in own.labels)
    return FinerRow(own.labels, known, _errors(session, own.outcome, rounded.uses), own.size)


def code(session: Session, asked: AskedCode) -> CodeReply:
    """Return the C code of the function with a set of values; on request, compiled and compared."""
    values = applied_values(session, asked.source, asked.rounding)
    settings = ExportSettings("c", asked.name.strip(), precision=asked.precision, check=asked.check)
    contents = code_of(session, values, settings)
    text = str(contents.files[f"{contents.name}.c"])
    numbers = sum(table.size + sum(len(axis) for axis in table.axes) for table in _tables(session, values))
    return CodeReply(
        name=contents.name,
        text=text[:MAX_PREVIEW],
        lines=text.count("\n"),
        size=numbers * (8 if asked.precision == "double" else 4),
        findings=_texts(contents.findings),
        compared=_compared(contents.comparison),
    )


def _tables(session: Session, values: Mapping[str, Parameter]) -> list[Parameter]:
    return [values[name] for name in session.require_view().model.problem.model.graph.parameters]


def _compared(own: CodeComparison | None) -> ComparedCode | None:
    if own is None:
        return None
    rows = [DeviationRow(each.name, each.unit, finite(each.largest), each.range) for each in own.outputs]
    return ComparedCode(own.compiler, own.samples, own.is_exact, rows)


def write_unit(session: Session, asked: UnitCommand) -> WrittenUnit | ExistingFiles:
    """Write the chosen files together; those that exist with another content are replaced only with `force`."""
    values = applied_values(session, asked.source, asked.rounding)
    languages = [_settings(asked, language) for language in dict.fromkeys(asked.languages)]
    known = {*formats(session).formats}
    if unknown := [each for each in asked.formats if each not in known]:
        raise ArgumentError(f"unknown format {unknown[0][:20]!r}")
    own = unit_files(session, values, languages, list(dict.fromkeys(asked.formats)), signals=asked.signals)
    if not asked.force and (existing := existing_files(session, asked.folder, own.files)):
        return ExistingFiles(existing)
    written = write_together(session, asked.folder, own.files)
    return WrittenUnit(written, _texts(own.findings), _compared(own.comparison))


def _settings(asked: UnitCommand, language: Literal["c", "fmu", "m"]) -> ExportSettings:
    options: dict[str, Any] = {"fmi": asked.fmi, "inputs": asked.inputs, "step": asked.step}
    options["platforms"] = tuple(dict.fromkeys(asked.platforms))
    settings = ExportSettings(language, asked.name.strip(), check=language == "c")
    if language == "c":
        return replace(settings, precision=asked.precision)
    return replace(settings, **options) if language == "fmu" else settings


def _why_no_cross_compiler() -> str:
    try:
        CrossCompiler.of(PLATFORMS[0])
    except ArgumentError as error:
        return str(error)
    return ""


def _texts(findings: Iterable[Finding]) -> list[str]:
    return list(map(str, findings))
