"""Python functions in the memory of this process, callable from machine code and for many samples at once."""

import ctypes
import threading
from collections.abc import Callable, Sequence
from functools import cached_property, wraps
from itertools import count
from pathlib import Path
from typing import Any, Final

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.machine_code.call_record import CallRecord
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.importers.python.evaluation import NumberFunction, PythonEvaluation
from kennfeld.importers.python.loaded_files import LoadedFiles, find_loaded_files
from kennfeld.importers.python.sibling_imports import run_module

_THREADS: Final = 64  # whose calls are recorded apart
_LOADING: Final = "running the file"
_POINTERS: Final = (ctypes.POINTER(ctypes.c_double),) * 3
_MODULE: Final = "kennfeld.importers.python.calling"
_living: dict[int, PythonEvaluation] = {}  # functions that are not in files, by their numbers
_numbers = count()


class LoadedPython:
    """A loaded function in Python; see `BatchFunction`."""

    def __init__(self, evaluation: PythonEvaluation) -> None:
        self.evaluation = evaluation

    @property
    def address(self) -> int:
        """See `LoadedFunction`."""
        return ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def evaluate(self, points: Float, along: Sequence[int]) -> tuple[Float, Float]:
        """See `BatchFunction`."""
        return self.evaluation.evaluate(points, along)

    def changing_results(self) -> Sequence[Finding]:
        """See `BatchFunction`."""
        return self.evaluation.changing_results()

    @cached_property
    def _callback(self) -> Any:
        return ctypes.CFUNCTYPE(None, *_POINTERS)(self._call)

    def _call(self, x: Any, y: Any, slopes: Any) -> None:
        inputs = self.evaluation.inputs
        arguments = x[:inputs]
        for number, result in enumerate(self.evaluation.point(arguments)):
            y[number] = result
        if not slopes:
            return
        # slopes[result * inputs + argument]; on entry, the first row marks the arguments that are asked for
        along = [argument for argument in range(inputs) if slopes[argument]]
        for number, row in enumerate(self.evaluation.point_slopes(arguments, along)):
            for argument, slope in zip(along, row, strict=True):
                slopes[number * inputs + argument] = slope


def function_of_file(files: LoadedFiles, name: str, inputs: int, outputs: int) -> ExternalFunction:
    """Return a function of a Python file, which runs when the function is loaded; with other data it is another one."""
    arguments = (str(files.path), name, files.source_digest, inputs, outputs, files.digest)
    return ExternalFunction(name, inputs, outputs, f"{_MODULE}:load_from_file", arguments, batched=True)


def living_function(
    function: NumberFunction, name: str, inputs: int, outputs: int, jacobian: NumberFunction | None
) -> ExternalFunction:
    """Return a function that exists in this process only."""
    number = next(_numbers)
    _living[number] = PythonEvaluation(name, function, inputs, outputs, jacobian)
    return ExternalFunction(name, inputs, outputs, f"{_MODULE}:load_living", (name, number), batched=True)


def load_living(name: str, number: int) -> LoadedPython:
    """Return a function of this process.

    Raises:
        InputError: it belongs to another process.
    """
    if number not in _living:
        message = "the function exists only in the process that defined it"
        remedy = "Define it in a file, and name it as file.py:function."
        raise InputError.of(Location(name), message, remedy)
    return LoadedPython(_living[number])


def load_from_file(path: str, name: str, digest: str, inputs: int, outputs: int, whole: str) -> LoadedPython:
    """Run a Python file and return its function.

    Args:
        path: the file.
        name: the name of the function.
        digest: of the code; data may change meanwhile, as code may write files.
        inputs: number of arguments.
        outputs: number of results.
        whole: digest of code and data, as they were found; it tells functions apart.

    Raises:
        InputError: a file has changed since the project was read, or running it fails.
    """
    with convert_errors(path, "the file cannot be read"):
        files = find_loaded_files(Path(path))
    if files.source_digest != digest:
        changed = "the file, or a module that it loads, has changed since the project was read"
        raise InputError.of(Location.of_file(path), changed, "Run again.")
    record = CallRecord(Path(path).name, [name, _LOADING], _THREADS)
    try:
        with record.during(_LOADING):
            module = run_module(files, whole)
        function: Callable[..., Any] = getattr(module, name)
    except (Exception, SystemExit) as error:
        raise InputError.of(Location.of_file(path), f"running it failed: {error!r:.200}", "Correct it.") from error
    return LoadedPython(PythonEvaluation(name, _recorded(function, record), inputs, outputs))


def _recorded(function: NumberFunction, record: CallRecord) -> NumberFunction:
    """Return the function with its calls recorded; each thread has a slot."""
    own, numbers_of_threads = threading.local(), count()

    @wraps(function)
    def call(*arguments: Any) -> Any:
        if not hasattr(own, "slot"):
            own.slot = next(numbers_of_threads) % _THREADS
        record.begin(1, own.slot)
        try:
            return function(*arguments)
        finally:
            record.end(own.slot)

    return call
