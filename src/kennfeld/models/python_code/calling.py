"""Functions in Python that a step calls sample by sample, with slopes by central differences."""

import ctypes
import math
import sys
from collections.abc import Callable, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, Final

from kennfeld.content_digest import digest_of
from kennfeld.errors import InputError, Location
from kennfeld.lazy_dataclass import dataclass

_STEP: Final = sys.float_info.epsilon ** (1 / 3)  # relative: balances the errors of truncation and rounding
_POINTERS: Final = (ctypes.POINTER(ctypes.c_double),) * 3


@dataclass(frozen=True)
class PythonCallback:
    """A function of Python at an address."""

    callback: Any

    @property
    def address(self) -> int:
        """Address of the function, see `LoadedFunction`."""
        return ctypes.cast(self.callback, ctypes.c_void_p).value or 0


def load(path: str, name: str, digest: str, inputs: int, outputs: int) -> PythonCallback:
    """Run a Python file and return its function as a callback.

    Raises:
        InputError: the file has changed since it was read, or fails.
    """
    content = Path(path).read_bytes()
    if digest_of(content) != digest:
        raise InputError.of(Location(path), "the file has changed since the project was read", "Run again.")
    spec = spec_from_file_location(f"kennfeld_function_{digest[:16]}", path)
    if spec is None or spec.loader is None:
        raise InputError.of(Location(path), "the file cannot be loaded")
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        function: Callable[..., Any] = getattr(module, name)
    except Exception as error:
        raise InputError.of(Location(path), f"running it failed: {error!r:.200}", "Correct it.") from error
    return PythonCallback(_callback(function, inputs, outputs))


def _callback(function: Callable[..., Any], inputs: int, outputs: int) -> Any:
    def values(arguments: Sequence[float]) -> list[float]:
        try:
            result = function(*arguments)
            numbers = [float(item) for item in result] if isinstance(result, tuple) else [float(result)]
        except Exception:  # what it cannot compute is NaN: an exception cannot pass through machine code
            return [math.nan] * outputs
        return numbers if len(numbers) == outputs else [math.nan] * outputs

    def call(x: Any, y: Any, slopes: Any) -> None:
        arguments = x[:inputs]
        for number, result in enumerate(values(arguments)):
            y[number] = result
        if not slopes:
            return
        for at, value in enumerate(arguments):
            step = _STEP * max(abs(value), 1.0)
            above, below = ([*arguments[:at], value + sign * step, *arguments[at + 1 :]] for sign in (1, -1))
            for number, (high, low) in enumerate(zip(values(above), values(below), strict=True)):
                slopes[number * inputs + at] = (high - low) / (above[at] - below[at])

    return ctypes.CFUNCTYPE(None, *_POINTERS)(call)
