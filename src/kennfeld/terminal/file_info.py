"""Describes a file of any kind."""

from collections.abc import Sequence
from pathlib import Path

from kennfeld.files.file_format import Role, call
from kennfeld.files.identification import identify
from kennfeld.models.function_files import kind_of, split_reference
from kennfeld.terminal.describers import DescribedFile, FileInfo, describe_calibration, describe_recording
from kennfeld.terminal.model_selection import WHOLE, ModelSelection


def describe_file(
    path: str | Path, a2l: str | Path | None = None, selection: ModelSelection = WHOLE, dbc: Sequence[str] = ()
) -> FileInfo:
    """Describe a measurement, calibration, A2L, formula, Simulink, ASCET, ONNX, project or training file.

    Args:
        path: the file; a sheet of a workbook as `bench.xlsx#Sheet1`, a function as `engine.py:torque`.
        a2l: the description of an image; by default the A2L file of the same name.
        selection: what to import of a Simulink model or an ASCET project.
        dbc: CAN databases of a bus log, see `kennfeld.measurement.read`.

    Raises:
        InputError: the file does not exist, or is of none of these kinds.
    """
    kind, (name, choice) = kind_of(str(path)), split_reference(str(path))
    if kind is not None and kind.named and choice:
        from kennfeld.terminal.function_info import describe_function

        return describe_function(str(path))
    if kind is not None and choice in kind.choices:
        from kennfeld.terminal.fmu_info import describe_fmu

        return describe_fmu(Path(name), choice)
    described = DescribedFile(Path(path), a2l, selection, dbc)
    identity = identify(path)
    if identity.format.describe:
        info: FileInfo = call(identity.format.describe, described)
        return info
    return describe_calibration(described) if identity.role is Role.CALIBRATION else describe_recording(described)
