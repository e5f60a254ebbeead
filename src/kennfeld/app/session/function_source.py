"""Functions in files of other tools as a project names them, also if the project cannot be read otherwise."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.function_files import FunctionKind, kind_of, list_functions, read_function_file, split_reference
from kennfeld.models.model_function import ModelFunction, as_model


@dataclass(frozen=True)
class FunctionSource:
    """A function in a file of another tool.

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
    def of(settings: Mapping[str, Any], folder: Path) -> "FunctionSource | None":
        """Return the function of these settings; None if it is not in a file of another tool."""
        model = settings.get("model")
        reference = str(model.get("file", "")) if isinstance(model, dict) else ""
        return FunctionSource(folder, reference, step=_step(settings)) if kind_of(reference) is not None else None

    @staticmethod
    def called(settings: Mapping[str, Any], folder: Path) -> "Iterator[FunctionSource]":
        """Yield the functions that formula text may call."""
        table = settings.get("functions")
        for name, reference in table.items() if isinstance(table, dict) else ():
            if isinstance(reference, str):
                yield FunctionSource(folder, reference, str(name), _step(settings))

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
    def kind(self) -> FunctionKind | None:
        """The kind of the file; None if it holds no functions."""
        return kind_of(self.reference)

    @property
    def names(self) -> tuple[str, ...]:
        """The functions of the file that can be chosen; empty if it holds one, or cannot be read."""
        return function_names(self.path) if self.kind is not None and self.kind.named else ()

    @property
    def listing_problems(self) -> Sequence[Finding]:
        """The reasons that the functions of the file cannot be listed; empty if they can, or need not be chosen."""
        if self.kind is None or not self.kind.named or self.names:
            return ()
        try:
            list_functions(self.path)
        except InputError as error:
            return error.findings
        return (Finding(Location(self.path.name), "the file has no functions", "Choose another file."),)

    @property
    def runs(self) -> bool:
        """True if code of the file runs with the function; False if it is translated, or cannot be read."""
        if self.kind is None or not self.kind.runs:
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


def read_called(settings: Mapping[str, Any], folder: Path) -> tuple[ModelFunction, ...]:
    """Return the functions that formula text may call, without those that cannot be read."""
    functions = []
    for source in FunctionSource.called(settings, folder):
        with suppress(InputError):
            functions.append(source.read())
    return tuple(functions)


def completed_reference(folder: Path, file: str) -> str:
    """Return a reference to a file with the name of its function if it has only one, and needs the name."""
    kind = kind_of(file)
    if kind is None or not kind.named or split_reference(file)[1]:
        return file
    names = function_names(folder / file)
    return f"{file}:{names[0]}" if len(names) == 1 else file


def has_no_functions(path: Path) -> bool:
    """Return True for a source file in which no function can be chosen, such as a file of data in C."""
    kind = kind_of(path.name)
    return kind is not None and kind.named and not function_names(path)


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


def _step(settings: Mapping[str, Any]) -> float | None:
    model = settings.get("model")
    step = model.get("step") if isinstance(model, dict) else None
    return float(step) if isinstance(step, int | float) and step > 0 else None
