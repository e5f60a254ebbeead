"""The function of a project in a file of another tool, also if the project cannot be read otherwise."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.models.function_files import importer_of_function, list_functions, read_function_file, split_reference
from kennfeld.models.importer import Importer, ImportRequest
from kennfeld.models.importer_registry import importer_of
from kennfeld.models.model import Model
from kennfeld.models.model_function import ModelFunction, as_model
from kennfeld.project.model import read_function
from kennfeld.project.schema import ProjectFile, read_partly


@dataclass(frozen=True)
class ImportSource:
    """The function of a project that is imported.

    Attributes:
        importer: the importer of its file.
        request: what the project says of the import; values of other kinds are skipped.
        project: the project file as far as it is valid.
    """

    importer: Importer
    request: ImportRequest
    project: ProjectFile

    @staticmethod
    def of(settings: Mapping[str, Any], path: Path, initial: ParameterSet | None = None) -> "ImportSource | None":
        """Return the function of a project; None if it is formula text.

        Args:
            settings: the tables of the project file.
            path: the project file.
            initial: the values that the project starts from.
        """
        project = read_partly(path, settings)
        importer = importer_of(split_reference(project.model.file)[0])
        if importer is None:
            return None
        request = project.import_request(initial)
        if "parameters" in importer.keys:  # they give values to variables, and files tell more than a set
            files = (*request.options.parameters, *(project.folder / name for name in project.calibration.files))
            request = replace(request, options=replace(request.options, parameters=files), initial=None)
        return ImportSource(importer, request, project)


@dataclass(frozen=True)
class FunctionSource:
    """A function in a file of another tool that formula text can call.

    Attributes:
        folder: the folder of the project, to which the file is relative.
        reference: the file, for some kinds with a colon and the name of the function.
        name: the name by which formula text calls it; empty for the function of the project.
        step: the step in s, None for that of the function.
    """

    folder: Path
    reference: str
    name: str = ""
    step: float | None = None

    @staticmethod
    def of(settings: Mapping[str, Any], path: Path) -> "FunctionSource | None":
        """Return the function of a project file; None if it is not in a file of functions."""
        model = read_partly(path, settings).model
        is_function = importer_of_function(model.file) is not None
        return FunctionSource(path.parent, model.file, step=model.step) if is_function else None

    @staticmethod
    def called(settings: Mapping[str, Any], path: Path) -> "Iterator[FunctionSource]":
        """Yield the functions that formula text may call."""
        project = read_partly(path, settings)
        for name, reference in project.functions.items():
            yield FunctionSource(path.parent, reference, name, project.model.step)

    @property
    def file(self) -> str:
        """The file without the name of a function."""
        return split_reference(self.reference)[0]

    @property
    def function(self) -> str:
        """The name of the function in the file; empty if the file holds one, or if none is chosen."""
        return split_reference(self.reference)[1]

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self.folder / self.file

    @property
    def importer(self) -> Importer | None:
        """The importer of the file; None if it holds no functions."""
        return importer_of_function(self.reference)

    @property
    def names(self) -> tuple[str, ...]:
        """The functions of the file that can be chosen; empty if it holds one, or cannot be read."""
        return function_names(self.path) if self.importer is not None and self.importer.named else ()

    @property
    def listing_problems(self) -> Sequence[Finding]:
        """The reasons that the functions of the file cannot be listed; empty if they can, or need not be chosen."""
        if self.importer is None or not self.importer.named or self.names:
            return ()
        try:
            list_functions(self.path)
        except InputError as error:
            return error.findings
        return (Finding(Location(self.path.name), "the file has no functions", "Choose another file."),)

    @property
    def runs(self) -> bool:
        """True if code of the file runs with the function; False if it is translated, or cannot be read."""
        if self.importer is None or not self.importer.runs:
            return False
        try:
            graph = as_model(self.read()).graph
        except InputError:
            return False
        return any(node.op == "external" for node in graph.nodes)

    def read(self) -> ModelFunction:
        """Read the function without running its code; files that have not changed are read once.

        Raises:
            InputError: it cannot be read.
        """
        return _read(self)


def read_called(settings: Mapping[str, Any], path: Path) -> tuple[ModelFunction, ...]:
    """Return the functions that formula text may call, without those that cannot be read."""
    functions = []
    for source in FunctionSource.called(settings, path):
        with suppress(InputError):
            functions.append(source.read())
    return tuple(functions)


def completed_reference(folder: Path, file: str) -> str:
    """Return a reference to a file with the name of its function if it has only one, and needs the name."""
    importer = importer_of_function(file)
    if importer is None or not importer.named or split_reference(file)[1]:
        return file
    names = function_names(folder / file)
    return f"{file}:{names[0]}" if len(names) == 1 else file


def has_no_functions(path: Path) -> bool:
    """Return True for a source file in which no function can be chosen, such as a file of data in C."""
    importer = importer_of_function(path.name)
    return importer is not None and importer.named and not function_names(path)


def function_names(path: Path) -> tuple[str, ...]:
    """Return the names of the functions of a source file in their order; empty if it cannot be read."""
    try:
        return _function_names(path)
    except (OSError, InputError):
        return ()


@while_unchanged(64)
def _function_names(path: Path) -> tuple[str, ...]:
    return tuple(function.name for function in list_functions(path))


@while_unchanged(32)
def _read(source: FunctionSource) -> ModelFunction:
    note_opened(source.path)
    return read_function_file(source.reference, source.folder, source.name, source.step)


def imported_model(settings: Mapping[str, Any], path: Path) -> Model | None:
    """Return the function that a project imports, also if the project lacks data or criteria; None if it cannot be."""
    project = read_partly(path, settings)
    importer = importer_of(split_reference(project.model.file)[0])
    if importer is None:
        return None
    if "parameters" in importer.keys:  # also the values that a project gives to variables by its initial files
        files = (*project.model.parameters, *project.calibration.files)
        project = replace(project, model=replace(project.model, parameters=files))
    read = read_function(project, (), (), Findings())
    return None if read is None else read.model
