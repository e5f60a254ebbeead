"""Functions in Python as model functions."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kennfeld.errors import Finding, Location
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models.model_function import FunctionOutput, ModelFunction
from kennfeld.models.python_code.reading import PythonFunction, read_python_function
from kennfeld.models.python_code.translation import UntranslatableError, translate


def read_function(path: Path, function: str, name: str = "", step: float | None = None) -> ModelFunction:
    """Read a function of a Python file, as `read_function_file` does.

    A function of numbers, conditions, bounded loops and mathematics becomes a graph with exact derivatives and never
    runs. Any other one is called for each sample, with a remark.

    Raises:
        InputError: the file is not Python, or has no such function of numbers; carries all problems.
    """
    source = read_python_function(path, function)
    outputs = tuple(FunctionOutput(item) for item in source.results)
    remarks: tuple[Finding, ...] = ()
    try:
        write: Callable[[GraphBuilder, Sequence[int]], Sequence[int]] = translate(source).write
    except UntranslatableError as error:
        write, remarks = _Call(source).write, (_remark(source, error),)
    return ModelFunction(name or function, source.inputs, outputs, write, source=str(path), remarks=remarks)


def _remark(source: PythonFunction, error: UntranslatableError) -> Finding:
    message = (
        f"line {error.line} cannot be translated: {error.message}. {source.tree.name} is called for each sample, which "
        "is slow and runs the code of the file, with derivatives by differences"
    )
    return Finding(Location(source.path.name, source.tree.lineno), message, severity="remark")


class _Call:
    """The call of a function from a graph."""

    def __init__(self, source: PythonFunction) -> None:
        inputs, outputs, name = len(source.inputs), len(source.results), source.tree.name
        arguments = (str(source.path.resolve()), name, source.digest, inputs, outputs)
        self.function = ExternalFunction(name, inputs, outputs, "kennfeld.models.python_code.calling:load", arguments)

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> list[int]:
        """Add the call to a graph."""
        return list(builder.external(self.function, *arguments))
