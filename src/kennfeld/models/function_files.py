"""Functions in files of other tools, by the kinds of their files."""

from collections.abc import Callable, Collection, Mapping
from hashlib import blake2b
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.files import functions as formats
from kennfeld.files.file_format import FileFormat, call
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionSummary, ModelFunction, as_function

CallableSources = Mapping[str, str | Path | Model | Callable[..., Any]] | Collection[ModelFunction]


class FunctionKind(NamedTuple):
    """A kind of file that holds functions.

    Attributes:
        label: the kind in messages.
        format: the record of its files.
        reader: `module:function` that reads a file, called as `read_function_file` calls it.
        named: True if the name of the function follows a colon, as in `engine.py:torque`.
        runs: True if the file holds code that the user's machine runs.
        choices: what may follow a colon to choose how the file is used, also with `_` in place of `-`.
        lister: `module:function` that returns the functions of a file by its path; empty if it holds one.
        digester: `module:function` that returns the digest of a file with all that its code loads, by its path; empty
            if that is the file alone.
        companions: `module:function` that returns the other files that its code loads, by its path.
        translated: True if functions of such files may be translated, and do not run then.
    """

    label: str
    format: FileFormat
    reader: str
    named: bool
    runs: bool
    choices: tuple[str, ...] = ()
    lister: str = ""
    digester: str = ""
    companions: str = ""
    translated: bool = False

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Endings of its files."""
        return self.format.endings


KINDS: tuple[FunctionKind, ...] = (
    FunctionKind(
        "an FMU",
        formats.FMU,
        "kennfeld.importers.fmu.importing:read_fmu",
        named=False,
        runs=True,
        choices=("co-simulation", "model-exchange"),
    ),
    FunctionKind(
        "a C file",
        formats.C,
        "kennfeld.importers.c.importing:read_function",
        named=True,
        runs=False,
        lister="kennfeld.importers.c.importing:list_functions",
    ),
    FunctionKind(
        "a Python file",
        formats.PYTHON,
        "kennfeld.importers.python.importing:read_function",
        named=True,
        runs=True,
        lister="kennfeld.importers.python.importing:list_functions",
        digester="kennfeld.importers.python.loaded_files:digest_of_loaded",
        companions="kennfeld.importers.python.loaded_files:files_loaded_by",
        translated=True,
    ),
    FunctionKind(
        "an ONNX network",
        formats.ONNX,
        "kennfeld.importers.onnx.importing:read_function",
        named=False,
        runs=False,
    ),
)


def split_reference(reference: str) -> tuple[str, str]:
    """Return file and function of a reference, or the way in which the file is used.

    >>> split_reference("engine.py:torque"), split_reference("C:/nets/knock.onnx")
    (('engine.py', 'torque'), ('C:/nets/knock.onnx', ''))
    >>> split_reference("plant.fmu:co_simulation")
    ('plant.fmu', 'co-simulation')
    """
    file, _, function = reference.rpartition(":")
    kind = _kind_of_file(file)
    chosen = function.replace("_", "-")
    if kind is not None and chosen.replace("-", "").isidentifier() and kind.choices:
        return file, chosen
    return (file, function) if function.isidentifier() and "." in Path(file).name else (reference, "")


def kind_of(reference: str) -> FunctionKind | None:
    """Return the kind of the file of a reference; None if it is of no kind that holds functions."""
    return _kind_of_file(split_reference(reference)[0])


def _kind_of_file(file: str) -> FunctionKind | None:
    suffix = Path(file).suffix.casefold()
    return next((kind for kind in KINDS if suffix in kind.suffixes), None)


def read_function_file(reference: str, folder: Path, name: str = "", step: float | None = None) -> ModelFunction:
    """Read the function of a file, without running any of its code.

    Args:
        reference: path of the file, relative to `folder`, and for some kinds a colon and the name of the function, or
            of the way in which the file is used.
        folder: folder of the path.
        name: name for calls in formula text, which precedes the names of its parameters; empty for a model of its own.
        step: the step in s at which a function with continuous states is solved.

    Raises:
        InputError: the file is of no known kind, or cannot be read.
    """
    kind = kind_of(reference)
    path, function = split_reference(reference)
    location = Location(reference)
    if kind is None:
        known = ", ".join(suffix for kind in KINDS for suffix in kind.suffixes)
        raise InputError.of(location, "not a file of functions", f"Known are {known}.")
    if kind.named and not function:
        message = f"{kind.label} may hold several functions"
        raise InputError.of(location, message, f'Name the function: "{reference}:NAME".')
    if function and not kind.named and function not in kind.choices:
        forms = [f'"{path}"', *(f'"{path}:{choice}"' for choice in kind.choices)]
        raise InputError.of(location, f"{kind.label} holds one function", f"Write {join_names(forms, 4, ' or ')}.")
    read: ModelFunction = call(kind.reader, folder / path, function, name, step)
    return read


def list_functions(path: Path) -> list[FunctionSummary]:
    """Return the functions of a file that may hold several, as it declares them.

    Raises:
        InputError: the file cannot be read.
    """
    kind = kind_of(str(path))
    if kind is None or not kind.lister:
        raise InputError.of(Location(path.name), "not a file of several functions")
    functions: list[FunctionSummary] = call(kind.lister, path)
    return functions


def code_digest(path: Path) -> str:
    """Return the digest of a file with all that its code loads, as far as that is known without running it.

    Raises `OSError` if the file cannot be read.
    """
    kind = _kind_of_file(str(path))
    if kind is None or not kind.digester:
        return blake2b(path.read_bytes(), digest_size=32).hexdigest()
    digest: str = call(kind.digester, path)
    return digest


def companion_files(path: Path) -> tuple[Path, ...]:
    """Return the other files that the code of a file loads. Raises `OSError` if the file cannot be read."""
    kind = _kind_of_file(str(path))
    companions: tuple[Path, ...] = () if kind is None or not kind.companions else call(kind.companions, path)
    return companions


def named_functions(functions: CallableSources) -> Collection[ModelFunction]:
    """Return functions for calls in formula text.

    Args:
        functions: by the names of their calls, references of files as for `read_function_file`, models without memory,
            or Python functions with one result. Functions that were read stay as they are.

    Raises:
        InputError: files cannot be read; carries the findings of all.
        ArgumentError: a model has memory, or a Python function a variable number of arguments.
    """
    if not isinstance(functions, Mapping):
        return functions
    findings, read = Findings(), []
    for name, function in functions.items():
        try:
            if isinstance(function, str | Path):
                read.append(read_function_file(str(function), Path(), name))
            elif isinstance(function, Model):
                read.append(as_function(function, name))
            else:
                read.append(_python_function(function, name))
        except InputError as error:
            findings.add(*error.findings)
    findings.finish()
    return read


def _python_function(function: Callable[..., Any], name: str) -> ModelFunction:
    module = import_module("kennfeld.importers.python.importing")  # as readers are: it knows this module
    read: ModelFunction = module.python_function(function, name=name)
    return read
