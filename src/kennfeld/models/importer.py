"""The interface by which functions in files of other tools are imported: one record for each tool.

A package of others adds one by the entry point `kennfeld.importers`; see `docs/adding-an-importer.md`.
"""

from collections.abc import Collection, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, NamedTuple

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.files.file_format import FileFormat, Reference, call
from kennfeld.models.import_report import FunctionReport, ImportReport
from kennfeld.models.model import Model
from kennfeld.models.model_function import ModelFunction, as_model


@dataclass(frozen=True)
class ImportOptions:
    """Choices for an import: the keys of `[model]` that importers may take, under their names in Python.

    Attributes:
        step: time step in s that replaces the one of the file.
        folders: folders in which further files are searched.
        subsystem: the part of a block diagram.
        parameters: files with values of variables.
        bind: formulas by the path of the block that each replaces.
        class_name: the class of a file.
        methods: methods that a step calls, in their order.
        startup: methods that run once before the first step.
        task: tasks of an application.
        outputs: variables that become outputs in addition, or patterns of them.
        limit_assignments: whether real numbers are limited to the ranges of their types; None as generated code.
        target: the data model of the target: `lp64` or `ilp32`; empty for that of the importer.
        float32: True if numbers of single precision are rounded as the target rounds them.
    """

    step: float | None = None
    folders: tuple[Path, ...] = ()
    subsystem: str = ""
    parameters: tuple[Path, ...] = ()
    bind: tuple[tuple[str, str], ...] = ()
    class_name: str = ""
    methods: tuple[str, ...] = ()
    startup: tuple[str, ...] = ()
    task: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    limit_assignments: bool | None = None
    target: str = ""
    float32: bool = False

    def chosen(self, keys: Collection[str]) -> bool:
        """Return whether a key is set of those that an importer takes, or the step."""
        return any(getattr(self, name) != getattr(NO_OPTIONS, name) for name in (*keys, "step"))


NO_OPTIONS = ImportOptions()


@dataclass(frozen=True)
class ImportRequest:
    """A function to import.

    Attributes:
        path: the file.
        options: what to import of it.
        choice: what follows the name of the file and a colon: a function, or the way in which the file is used.
        values: numbers and value blocks of the project; None for names whose values it leaves to the file.
        initial: values from calibration files.
    """

    path: Path
    options: ImportOptions = NO_OPTIONS
    choice: str = ""
    values: tuple[tuple[str, Any], ...] = ()
    initial: ParameterSet | None = field(default=None, compare=False)


@dataclass(frozen=True)
class ImportResult:
    """Result of an import: the report, and the model, None if a part of it is not supported."""

    model: Model | None
    report: ImportReport

    @property
    def problems(self) -> tuple[Finding, ...]:
        """The parts that are not supported, with their file."""
        return self.report.findings

    def require_model(self) -> Model:
        """Return the model. Raises `InputError` with all that is not supported."""
        if self.model is None:
            raise InputError(self.problems)
        return self.model


@dataclass(frozen=True)
class FormulaLine:
    """A line of formula text.

    Attributes:
        text: the line.
        node: name of the node in the model whose statement begins here; empty for other lines.
        path: where it comes from: the path of a block.
    """

    text: str
    node: str = ""
    path: str = ""


class FileFacts(NamedTuple):
    """Facts that a file states of itself, for a page.

    Attributes:
        rows: names and texts.
        choices: the ways in which it can be used, if there are several.
        states: names of the states of its function.
    """

    rows: Sequence[tuple[str, str]] = ()
    choices: Sequence[str] = ()
    states: Sequence[str] = ()


class DroppedFiles(NamedTuple):
    """The treatment of files in the folder of a project of which several make up a function.

    Attributes:
        place: `place(folder, present, names)`, which moves files to where the import searches them, beside the present
            file of the function unless it is None, and returns their new names.
        main: `main(folder, names)`, which returns the file that is the function; empty for none.
        search: `search(folder)`, which yields the files of a folder that can be the function, by their relative paths.
    """

    place: Reference
    main: Reference
    search: Reference


@dataclass(frozen=True, eq=False)
class Importer:
    """The record of one tool: how functions in its files are imported.

    Either `reads` or `imports` is needed. What else is left empty is not offered to the user, or is the same for all.

    Attributes:
        label: a file in messages, with the article.
        formats: records of its files. Projects go by their endings, commands on a single file by their content.
        reads: `read(path, function, name, step)`, which returns a `ModelFunction`, also for calls from formula text.
        reads_options: True if `reads` takes the `ImportOptions` as a fifth argument.
        imports: `import_(request)`, which returns an `ImportResult`; by default the function as a model of its own.
        wraps: `wrap(function, name=name)`, which returns the `ModelFunction` of a Python function that is passed as an
            object.
        keys: keys of `[model]` that it takes, as the fields of `ImportOptions` are called.
        shared_keys: those of them that stay when another file of this importer is chosen.
        export: `formula_lines(model)`, which returns the model as formula text, each line with what it comes from.
        heading: `heading(request, report)`, which returns the comments above this text.
        named: True if the name of a function follows a colon, as in `engine.py:torque`.
        choices: what may follow a colon to choose how the file is used, also with `_` in place of `-`.
        runs: True if a file holds code that the user's machine runs.
        translated: True if functions of such files may be translated, and do not run then.
        describes: formats with `describe(file)`, which returns the `FileInfo` of a `DescribedFile`, also of files that
            are read with the function; by default `describe` of the format, or the list of functions, or the report on
            the import.
        updates: formats with `update(parameters, path)`, which returns a `WriteResult`: a copy of a file with other
            values, of files beside a function that are not calibrations by themselves.
        lists: `list_functions(path)`, which returns a `FunctionSummary` for each function of a file.
        digest: `digest(path)` of a file with all that its code loads; by default that of the file.
        companions: `companions(path)`, the other files that its code loads.
        is_text: True if the app shows the text of a file.
        facts: `facts(path)`, which returns the `FileFacts` of a file.
        screen: the screen of the app that shows such a function.
        view: `view(request, folder)`, which returns what this screen shows, as JSON-compatible containers; paths in it
            are relative to the folder of the project.
        parts: `parts(request, folder)`, which returns the parts of a file that can be imported by themselves.
        dropped: what becomes of files that are dropped onto the app, if several of them make up a function.
    """

    label: str
    formats: tuple[FileFormat, ...]
    reads: Reference = ""
    reads_options: bool = False
    imports: Reference = ""
    wraps: Reference = ""
    keys: tuple[str, ...] = ()
    shared_keys: tuple[str, ...] = ()
    export: Reference = ""
    heading: Reference = ""
    named: bool = False
    choices: tuple[str, ...] = ()
    runs: bool = False
    translated: bool = False
    describes: tuple[tuple[FileFormat, Reference], ...] = ()
    updates: tuple[tuple[FileFormat, Reference], ...] = ()
    lists: Reference = ""
    digest: Reference = ""
    companions: Reference = ""
    is_text: bool = False
    facts: Reference = ""
    screen: str = "function-file"
    view: Reference = ""
    parts: Reference = ""
    dropped: DroppedFiles | None = None

    @property
    def name(self) -> str:
        """A file in messages, without the article."""
        return self.label.partition(" ")[2]

    @property
    def endings(self) -> tuple[str, ...]:
        """Endings of its files, in lower case."""
        return tuple(ending for known in self.formats for ending in known.endings)

    def check_choice(self, file: str, choice: str) -> None:
        """Raise `InputError` if a reference names no function, or one where there is only one."""
        location = Location(f"{file}:{choice}" if choice else file)
        if self.named and not choice:
            message = f"{self.label} may hold several functions"
            raise InputError.of(location, message, f'Name the function: "{file}:NAME".')
        if choice and not self.named and choice not in self.choices:
            forms = [f'"{file}"', *(f'"{file}:{each}"' for each in self.choices)]
            raise InputError.of(location, f"{self.label} holds one function", f"Write {join_names(forms, 4, ' or ')}.")

    def read(self, request: ImportRequest) -> ModelFunction:
        """Read a function that formula text could call. Raises `InputError` if the file cannot be read."""
        self.check_choice(request.path.name, request.choice)
        return self.read_function(request.path, request.choice, "", request.options)

    def read_function(self, path: Path, choice: str, name: str, options: ImportOptions) -> ModelFunction:
        """Read the function of a file for calls by a name. Raises `InputError` if the file cannot be read."""
        more = (options,) if self.reads_options else ()
        function: ModelFunction = call(self.reads, path, choice, name, options.step, *more)
        return function

    def import_(self, request: ImportRequest) -> ImportResult:
        """Import a function as a model of its own.

        Raises:
            InputError: the file cannot be read, or has no such part.
        """
        self.check_choice(request.path.name, request.choice)
        if self.imports:
            result: ImportResult = call(self.imports, request)
            return result
        function = self.read(request)
        return ImportResult(as_model(function), FunctionReport.of(function))

    def model(self, request: ImportRequest) -> Model:
        """Import a function as a model of its own. Raises `InputError` with all that is not supported."""
        return self.import_(request).require_model()
