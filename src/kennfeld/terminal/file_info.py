"""Recognises a file of any kind by its content and describes it."""

import re
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path

from kennfeld import calfiles, measurement
from kennfeld.calfiles.flash.recognition import recognises_a2l, recognises_flash
from kennfeld.calfiles.format import HEAD_SIZE, CalibrationSource
from kennfeld.calfiles.unsupported_files import explain_unsupported
from kennfeld.errors import InputError, Location
from kennfeld.file_errors import convert_errors
from kennfeld.foreign_content import identify_foreign
from kennfeld.lazy_dataclass import dataclass
from kennfeld.measurement.file_kind import FileKind, detect_kind, locate
from kennfeld.models.function_files import kind_of, split_reference
from kennfeld.models.simulink.reader.recognition import recognises_simulink
from kennfeld.project.toml_file import is_training, read_toml
from kennfeld.terminal import describers
from kennfeld.terminal.describers import FileInfo
from kennfeld.terminal.fmu_info import describe_fmu
from kennfeld.terminal.function_info import describe_function, describe_functions
from kennfeld.terminal.model_selection import WHOLE, ModelSelection

_SECTION = re.compile(
    r"^[ \t]*\[{1,2}(model|surrogate|dataset|calibration|criterion|optimizer|parameters\.\S+)\]", re.MULTILINE
)
_FORMULA_LINE = re.compile(
    r"\s*(?:(?:\d+\s+)?(?:[A-Za-z_]\w*|%[^%]+%)\s*(?:\[[^\]]*\])?\s*=[^=]"
    r"|(?:input|output|scalar|curve|map|cube|rbf|step|solver|def)\s+\S)"
)
_CALIBRATION_KINDS = (FileKind.DCM, FileKind.CVX, FileKind.JSON)
_MAX_MAT_SIZE = 100_000_000  # bytes of a MATLAB data file that is searched for parameters


def describe_file(
    path: str | Path, a2l: str | Path | None = None, selection: ModelSelection = WHOLE, dbc: Sequence[str] = ()
) -> FileInfo:
    """Describe a measurement, calibration, A2L, formula, Simulink, ASCET, ONNX, project or training file.

    Args:
        path: the file; a sheet of a workbook as `bench.xlsx#Sheet1`.
        a2l: the description of an image; by default the A2L file of the same name.
        selection: what to import of a Simulink model or an ASCET project.
        dbc: CAN databases of a bus log, see `kennfeld.measurement.read`.

    Raises:
        InputError: the file does not exist, or is of none of these kinds.
    """
    kind, (name, choice) = kind_of(str(path)), split_reference(str(path))
    if kind is not None and kind.named:
        return describe_function(str(path)) if choice else describe_functions(Path(path))
    if kind is not None and choice in kind.choices:
        return describe_fmu(Path(name), choice)
    file = _InputFile(Path(path), a2l, selection)
    if file.path.is_file():
        file.refuse_foreign()
        for recognises, describe in _DESCRIBERS:
            if recognises(file):
                return describe(file)
    try:
        return describers.describe_measurement(measurement.describe(path, dbc))
    except InputError:
        reason = explain_unsupported(file.path) if file.path.is_file() else None
        if reason is None:
            raise
    raise InputError([reason])


@dataclass(frozen=True)
class _InputFile:
    """A file to be described. Its beginning is read when first needed: a damaged model is known by its name alone."""

    path: Path
    a2l: str | Path | None
    selection: ModelSelection

    def refuse_foreign(self) -> None:
        """Raise `InputError` if the file is a pointer, a web page, a picture or the like."""
        with convert_errors(self.path, "cannot be read"), self.path.open("rb") as stream:
            content = identify_foreign(stream.read(HEAD_SIZE))
        if content is not None and explain_unsupported(self.path) is None:
            raise InputError.of(Location(self.path.name), f"this is {content.description}", content.remedy)

    @property
    def suffix(self) -> str:
        return self.path.suffix.lower()

    @property
    def kind(self) -> FileKind:
        return self._beginning[0]

    @property
    def head(self) -> str:
        """The first characters, with line feeds as line ends."""
        return self._beginning[1]

    @cached_property
    def _beginning(self) -> tuple[FileKind, str]:
        with convert_errors(self.path, "cannot be read"):
            with self.path.open("rb") as stream:
                head = stream.read(HEAD_SIZE)
            return detect_kind(self.path)[0], head.decode("utf-8", errors="replace").replace("\r\n", "\n")


def _is_simulink(file: _InputFile) -> bool:
    by_name = file.suffix in (".slx", ".mdl")
    return by_name or file.kind is FileKind.MODEL or recognises_simulink(file.head.encode())


def _is_enumeration(file: _InputFile) -> bool:
    if file.suffix != ".m":
        return False
    from kennfeld.models.simulink.variables.enumerations import enumeration_of

    return enumeration_of(file.head) is not None


def _is_toml(file: _InputFile) -> bool:
    return file.suffix == ".toml" or (file.kind is FileKind.CSV and _SECTION.search(file.head) is not None)


def _describe_toml(file: _InputFile) -> FileInfo:
    describe = describers.describe_training if is_training(read_toml(file.path)) else describers.describe_project
    return describe(file.path)


def _describe_network(file: _InputFile) -> FileInfo:
    from kennfeld.terminal.network_info import describe_network

    return describe_network(file.path)


def _describe_formula_file(file: _InputFile) -> FileInfo:
    from kennfeld.models import formula as formulas

    path, surrogates = file.path, formulas.surrogates_beside(file.path)
    if file.suffix == ".kf":
        return describers.describe_formula(path, formulas.read(path, surrogates=surrogates))
    return describers.describe_formula(path, formulas.formula(formulas.text_of(path), path.name, surrogates=surrogates))


def _is_surrogate(file: _InputFile) -> bool:
    from kennfeld.surrogate.surrogate_file import recognises_surrogate

    return recognises_surrogate(file.head)


def _is_calibration(file: _InputFile) -> bool:
    if file.kind is FileKind.EXCEL:
        from kennfeld.calfiles.excel.layout import is_calibration_workbook

        return is_calibration_workbook(_whole(file.path))
    if file.kind is FileKind.HDF5:
        from kennfeld.measurement import hdf5

        if not hdf5.is_of_matlab(locate(file.path)):
            return False
    if file.kind in (FileKind.MATLAB, FileKind.HDF5, FileKind.OTHER) and file.path.stat().st_size < _MAX_MAT_SIZE:
        from kennfeld.calfiles.matlab_reader import is_calibration_mat, recognises_mat

        source = _whole(file.path)
        return recognises_mat(source) and is_calibration_mat(source)
    return file.kind in _CALIBRATION_KINDS or _is_calibration_text(file)


def _whole(path: Path) -> CalibrationSource:
    return CalibrationSource(path.name, path.read_bytes(), path)


def _is_calibration_text(file: _InputFile) -> bool:
    from kennfeld.calfiles.cdfx.reader import recognises_cdfx
    from kennfeld.calfiles.dcm.lines import recognises_dcm
    from kennfeld.calfiles.matlab_reader import recognises_script
    from kennfeld.calfiles.msq.reader import recognises_msq
    from kennfeld.calfiles.par.lines import recognises_par

    head = file.head
    if recognises_msq(head) or recognises_cdfx(head) or recognises_par(head):
        return True
    return file.kind is FileKind.CSV and (recognises_script(head) or recognises_dcm(head))


def _is_formula_text(file: _InputFile) -> bool:
    return file.kind is FileKind.CSV and _FORMULA_LINE.match(_first_line(file.head)) is not None


def _first_line(text: str) -> str:
    """Return the first line that is neither empty nor a comment."""
    lines = (line.removeprefix("\ufeff").strip() for line in text.split("\n"))
    return next((line for line in lines if line and not line.startswith("#")), "")


# tried in this order; a file that none of them recognises is a measurement
_DESCRIBERS: Sequence[tuple[Callable[[_InputFile], bool], Callable[[_InputFile], FileInfo]]] = (
    (_is_enumeration, lambda file: describers.describe_enumeration(file.path)),
    (lambda file: file.suffix == ".onnx", _describe_network),
    (lambda file: file.suffix == ".sldd", lambda file: describers.describe_dictionary(file.path)),
    (
        lambda file: file.suffix in (".esdl", ".app"),
        lambda file: describers.describe_esdl(file.path, file.selection.esdl),
    ),
    (
        lambda file: file.suffix in (".axl", ".amd"),
        lambda file: describers.describe_components(file.path, file.selection.esdl),
    ),
    (lambda file: file.suffix == ".fmu", lambda file: describe_fmu(file.path)),
    (_is_simulink, lambda file: describers.describe_simulink(file.path, file.selection.simulink)),
    (_is_toml, _describe_toml),
    (_is_surrogate, lambda file: describers.describe_surrogate_file(file.path)),
    (lambda file: file.suffix == ".kf", _describe_formula_file),
    (
        lambda file: recognises_flash(CalibrationSource(file.path.name, file.head.encode())),
        lambda file: describers.describe_calibration(calfiles.describe(file.path, file.a2l)),
    ),
    (lambda file: recognises_a2l(file.head), lambda file: describers.describe_a2l(calfiles.describe_a2l(file.path))),
    (_is_calibration, lambda file: describers.describe_calibration(calfiles.describe(file.path))),
    (_is_formula_text, _describe_formula_file),
)
