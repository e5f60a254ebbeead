"""Functions in files of other tools, by references such as `engine.c:torque`."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

from kennfeld.base.errors import ArgumentError, Findings, InputError, Location
from kennfeld.files.file_format import call, resolve
from kennfeld.models.importer import NO_OPTIONS, Importer, ImportOptions
from kennfeld.models.importer_registry import importer_of, importers
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionSummary, ModelFunction, as_function

CallableSources = Mapping[str, str | Path | Model | Callable[..., Any]] | tuple[ModelFunction, ...]


def split_reference(reference: str) -> tuple[str, str]:
    """Return file and function of a reference, or the way in which the file is used.

    >>> split_reference("engine.py:torque"), split_reference("C:/nets/knock.onnx")
    (('engine.py', 'torque'), ('C:/nets/knock.onnx', ''))
    >>> split_reference("plant.fmu:co_simulation")
    ('plant.fmu', 'co-simulation')
    """
    file, _, function = reference.rpartition(":")
    importer = importer_of(file) if file else None
    chosen = function.replace("_", "-")
    if importer is not None and chosen.replace("-", "").isidentifier() and importer.choices:
        return file, chosen
    # behind the colon of a drive, C:/nets/knock.onnx, a path follows
    return (file, function) if function.isidentifier() and "." in Path(file).name else (reference, "")


def importer_of_function(reference: str) -> Importer | None:
    """Return the importer of a reference if formula text can call such functions; None for all else."""
    importer = importer_of(split_reference(reference)[0])
    return importer if importer is not None and importer.reads else None


def read_function_file(
    reference: str, folder: Path, name: str = "", step: float | None = None, options: ImportOptions = NO_OPTIONS
) -> ModelFunction:
    """Read the function of a file, without running any of its code.

    Args:
        reference: path of the file, relative to `folder`, and for some kinds a colon and the name of the function, or
            of the way in which the file is used.
        folder: folder of the path.
        name: name for calls in formula text, which precedes the names of its parameters; empty for a model of its own.
        step: the step in s at which a function with continuous states is solved.
        options: further choices of importers that take them for such functions.

    Raises:
        InputError: the file is of no known kind, or cannot be read.
    """
    importer = importer_of_function(reference)
    if importer is None:
        known = ", ".join(callable_endings())
        remedy = f"Known are {known}." if known else "No importer of such files is installed."
        raise InputError.of(Location(reference), "not a file of functions", remedy)
    path, function = split_reference(reference)
    importer.check_choice(path, function)
    return importer.read_function(folder / path, function, name, replace(options, step=step))


def callable_endings() -> tuple[str, ...]:
    """Return the endings of files whose functions formula text can call."""
    return tuple(ending for each in importers() if each.reads for ending in each.endings)


def list_functions(path: Path) -> list[FunctionSummary]:
    """Return the functions of a file that may hold several, as it declares them.

    Raises:
        InputError: the file cannot be read.
    """
    importer = importer_of(str(path))
    if importer is None or not importer.lists:
        raise InputError.of(Location(path.name), "not a file of several functions")
    functions: list[FunctionSummary] = call(importer.lists, path)
    return functions


def code_digest(path: Path) -> str:
    """Return the digest of a file with all that its code loads, as far as that is known without running it.

    Raises `OSError` if the file cannot be read.
    """
    importer = importer_of(str(path))
    if importer is None or not importer.digest:
        return blake2b(path.read_bytes(), digest_size=32).hexdigest()
    digest: str = call(importer.digest, path)
    return digest


def companion_files(path: Path) -> tuple[Path, ...]:
    """Return the other files that the code of a file loads. Raises `OSError` if the file cannot be read."""
    importer = importer_of(str(path))
    companions: tuple[Path, ...] = ()
    if importer is not None and importer.companions:
        companions = call(importer.companions, path)
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
    wrap = next((each.wraps for each in importers() if each.wraps), None)
    if wrap is None:
        raise ArgumentError(f"{name} is a Python function, for which no importer is installed")
    read: ModelFunction = resolve(wrap)(function, name=name)
    return read
