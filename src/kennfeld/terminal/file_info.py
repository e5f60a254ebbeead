"""Describes a file of any kind."""

from collections.abc import Sequence
from pathlib import Path
from shutil import get_terminal_size

from kennfeld.base.errors import InputError, Location
from kennfeld.calfiles.file_info import describe_calibration
from kennfeld.files.file_format import Role, call
from kennfeld.files.file_info import DescribedFile, FileInfo
from kennfeld.files.identification import identify
from kennfeld.models.function_files import split_reference
from kennfeld.models.function_info import describe_function
from kennfeld.models.importer import NO_OPTIONS, ImportOptions
from kennfeld.models.importer_registry import describer_of, importer_of, importer_of_format
from kennfeld.terminal.describers import describe_recording
from kennfeld.terminal.output import UNLIMITED_WIDTH, align, fold, separate, wrap_words

LINE_WIDTH = 200  # characters, if the output is no terminal


def describe_file(
    path: str | Path, a2l: str | Path | None = None, options: ImportOptions = NO_OPTIONS, dbc: Sequence[str] = ()
) -> FileInfo:
    """Describe a measurement, calibration, A2L, formula, Simulink, ASCET, ONNX, project or training file.

    Args:
        path: the file; a sheet of a workbook as `bench.xlsx#Sheet1`, a function as `engine.py:torque`.
        a2l: the description of an image; by default the A2L file of the same name.
        options: what to import of a model.
        dbc: CAN databases of a bus log, see `kennfeld.measurement.read`.

    Raises:
        InputError: the file does not exist, or is of none of these kinds.
    """
    file, choice = split_reference(str(path))
    importer = importer_of(file)
    is_chosen = importer is not None and bool(choice) and (importer.named or choice in importer.choices)
    described = DescribedFile(Path(file if is_chosen else path), a2l, dbc, choice if is_chosen else "", options)
    identity = identify(described.path)
    if describe := describer_of(identity.format):
        info: FileInfo = call(describe, described)
        return info
    if (reader := importer_of_format(identity.format)) is not None:
        return describe_function(reader, described)
    if Role.CALIBRATION in (identity.role, *identity.format.roles) and identity.role is not Role.RECORDING:
        return describe_calibration(described)
    if identity.role in (Role.FUNCTION, Role.PROGRAM):
        message = f"this is {identity.format.phrase}, for which no importer is installed"
        raise InputError.of(Location(described.path.name), message)
    return describe_recording(described)


def text_lines(info: FileInfo) -> list[str]:
    """Return the contents of a file as text for a person; a terminal folds long lines by itself."""
    tables, notes = [table for table in info.tables if len(table) > 1], list(info.notes)
    if get_terminal_size((UNLIMITED_WIDTH, 24)).columns == UNLIMITED_WIDTH:
        tables = [fold(table, LINE_WIDTH) for table in tables]
        notes = [line for note in notes for line in _wrapped(note)]
    blocks = [[info.summary], *map(align, tables), notes]
    return separate(filter(None, blocks))


def _wrapped(note: str) -> list[str]:
    """Return the lines of a note; what has several lines is text to copy."""
    return [note] if "\n" in note else wrap_words(note, LINE_WIDTH, "  ")
