"""Functions in Python as model functions."""

from collections.abc import Callable, Sequence
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.file_state import note_opened
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.importers.python.calling import function_of_file, living_function
from kennfeld.importers.python.loaded_files import find_loaded_files
from kennfeld.importers.python.reading import PythonFunction, function_names, read_python_function
from kennfeld.importers.python.scope import UntranslatableError
from kennfeld.importers.python.translation import translate
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionInput, FunctionOutput, FunctionSummary, ModelFunction, as_model


def read_function(path: Path, function: str, name: str = "", step: float | None = None) -> ModelFunction:
    """Read a function of a Python file, as `read_function_file` does.

    A function of numbers, conditions, bounded loops and mathematics becomes a graph with exact derivatives and never
    runs. Any other one is called for each sample, with a remark.

    Raises:
        InputError: the file is not Python, or has no such function of numbers; carries all problems.
    """
    source = read_python_function(path, function)
    outputs = tuple(FunctionOutput(item) for item in source.results)
    write: Callable[[GraphBuilder, Sequence[int]], Sequence[int]]
    try:
        translated, remarks = translate(source)
        write = translated.write
    except UntranslatableError as error:
        with convert_errors(path, "the file cannot be read"):
            files = find_loaded_files(path)
        for file in (path.parent, *files.others):
            note_opened(file)
        called = function_of_file(files, function, len(source.inputs), len(outputs))
        write, remarks = _PythonCall(called).write, (_remark(source, error),)
    return ModelFunction(name or function, source.inputs, outputs, write, source=str(path), remarks=remarks)


def list_functions(path: Path) -> list[FunctionSummary]:
    """Return the functions of a Python file with their arguments and results, without running it.

    Raises:
        InputError: the file is not Python.
    """
    return [_summary(path, name) for name in function_names(path)]


def _summary(path: Path, name: str) -> FunctionSummary:
    try:
        source = read_python_function(path, name)
    except InputError as error:
        return FunctionSummary(name, (), (), error.findings[0].message)
    defaults = ["" if item.default is None else f" = {item.default:g}" for item in source.inputs]
    arguments = tuple(f"{item.name}{text}" for item, text in zip(source.inputs, defaults, strict=True))
    return FunctionSummary(name, arguments, source.results)


def function(
    function: Callable[..., Any],
    jac: Callable[..., Any] | None = None,
    outputs: Sequence[str] = (),
) -> Model:
    """Return a Python function as a model: its arguments are channels, its results nodes.

    It is called with the arrays of all samples if it gives the same for them as for numbers, else sample by sample.

    Args:
        function: takes numbers, and returns one number or a tuple of them.
        jac: returns its derivatives along all arguments, as a sequence; for several results, one for each result.
            Without it, derivatives are central differences.
        outputs: names of the results; by default a single one has the name of the function.

    Returns:
        The model, without memory and without parameters.

    Raises:
        ArgumentError: the function has a variable number of arguments.

    >>> model = function(lambda speed, load: speed * load, outputs=["power"])
    >>> model.graph.inputs, model.graph.outputs
    (('speed', 'load'), ('power',))
    """
    return as_model(python_function(function, jac, outputs))


def python_function(
    function: Callable[..., Any], jac: Callable[..., Any] | None = None, outputs: Sequence[str] = (), name: str = ""
) -> ModelFunction:
    """Return a Python function for calls in formula text; see `function`.

    Args:
        function: the function.
        jac: its derivatives.
        outputs: names of its results.
        name: the name for calls, by default its own.
    """
    own = getattr(function, "__name__", "")
    name = name or (own if own.isidentifier() else "f")
    results = tuple(outputs) or (name,)
    inputs = _inputs(function, name)
    called = living_function(function, name, len(inputs), len(results), jac)
    return ModelFunction(name, inputs, tuple(FunctionOutput(item) for item in results), _PythonCall(called).write)


def _inputs(function: Callable[..., Any], name: str) -> tuple[FunctionInput, ...]:
    try:
        arguments = signature(function).parameters.values()
    except (ValueError, TypeError):
        raise ArgumentError(
            f"the arguments of {name} cannot be found; wrap it in a function of named arguments"
        ) from None
    if any(argument.kind not in (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD) for argument in arguments):
        raise ArgumentError(f"{name} has a variable number of arguments, or keywords; name all arguments")
    numbers = [None if each.default is Parameter.empty else each.default for each in arguments]
    if wrong := [number for number in numbers if not isinstance(number, int | float | None)]:
        raise ArgumentError(f"the default {wrong[0]!r:.40} of an argument of {name} must be a number")
    return tuple(FunctionInput(each.name, default=number) for each, number in zip(arguments, numbers, strict=True))


def _remark(source: PythonFunction, error: UntranslatableError) -> Finding:
    message = (
        f"line {error.line} cannot be translated: {error.message}. The code of the file runs to evaluate "
        f"{source.tree.name}, for all samples at once where this is possible, and its derivatives are differences"
    )
    return Finding(Location(source.path.name, source.tree.lineno), message, severity="remark")


class _PythonCall:
    """The call of a function from a graph."""

    def __init__(self, function: ExternalFunction) -> None:
        self.function = function

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> list[int]:
        """Add the call to a graph."""
        return list(builder.external(self.function, *arguments))
