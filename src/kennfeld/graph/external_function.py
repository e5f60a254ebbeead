"""Functions outside of the graph that a time step calls, such as functions in C and the equations of FMUs.

The graph holds how a function is found again, not its address, so that it can be pickled and run in another process.
"""

import ctypes
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from hashlib import blake2b
from importlib import import_module
from pathlib import Path
from secrets import token_hex
from typing import NamedTuple, Protocol, cast

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.threads import computed_once
from kennfeld.graph.node import Node


class LoadedFunction(Protocol):
    """A function in the memory of this process, which it keeps there."""

    @property
    def address(self) -> int:
        """Address of `void f(const double *x, double *y, double *slopes)`, which several threads may call at once.

        It writes the outputs to y, and dy[i]/dx[j] to slopes[i * inputs + j] unless slopes is a null pointer. What it
        cannot compute is NaN. Slopes along x[j] are needed only if slopes[j] is not 0 before the call.
        """


class BatchFunction(LoadedFunction, Protocol):
    """A loaded function that can be evaluated at many points at once."""

    def evaluate(self, points: Float, along: Sequence[int]) -> tuple[Float, Float]:
        """Return the outputs at points, Float[outputs, points], and slopes, Float[outputs, len(along), points].

        Args:
            points: the arguments, Float[inputs, points].
            along: numbers of the arguments along which slopes are needed.
        """

    def changing_results(self) -> Sequence[Finding]:
        """Call the function again at some of the points where it was called; return warnings if its results change."""


class SequentialFunction(LoadedFunction, Protocol):
    """A loaded function that keeps memory of trajectories."""

    @property
    def trajectories(self) -> int:
        """Number of trajectories that may run at once."""


class ExternalFunction(NamedTuple):
    """A function outside of the graph; equal arguments give equal results, unless it is sequential.

    Attributes:
        name: name for messages and formula text.
        inputs: number of arguments.
        outputs: number of results.
        loader: `module:function`, which returns the `LoadedFunction`.
        arguments: arguments of the loader; they determine the function, for example by the digest of a file.
        sequential: True if it keeps memory of a trajectory, so that its calls must follow each other in time; the
            loader then returns a `SequentialFunction`.
        batched: True if what the loader returns is a `BatchFunction`, which is better called for many samples at once.
        native: True if it is machine code of others, which may crash its process.
    """

    name: str
    inputs: int
    outputs: int
    loader: str
    arguments: tuple[str | int, ...] = ()
    sequential: bool = False
    batched: bool = False
    native: bool = False

    @property
    def file(self) -> Path | None:
        """The file whose code runs, which is the first argument of its loader; None for a function of this process."""
        path = Path(str(self.arguments[0])) if self.arguments else Path()
        return path if path.is_absolute() else None

    @property
    def symbol(self) -> str:
        """The name by which machine code knows the function, different for different functions."""
        content = repr((self.inputs, self.outputs, self.loader, self.arguments)).encode()
        return f"external_{blake2b(content, digest_size=16).hexdigest()}"


_PROCESS = token_hex(16)

_gates: list[Callable[[ExternalFunction], None]] = []


class ExternalOutput(NamedTuple):
    """An output of an external function: the payload of its nodes."""

    function: ExternalFunction
    number: int


def living_functions(nodes: Iterable[Node]) -> tuple[str, ...]:
    """Return what tells the functions of this process that nodes call from those of every other process.

    Their arguments are numbers that this process has given them; another one gives the same numbers to other functions.
    """
    functions = {node.payload.function for node in nodes if node.op == "external"}
    return tuple(sorted(f"{f.symbol} {_PROCESS}" for f in functions if f.file is None))


def is_sequential(node: Node) -> bool:
    """Return True if a node calls a function that keeps memory of a trajectory."""
    return node.op == "external" and node.payload.function.sequential


class CodeNotRunError(InputError):
    """Code outside of the graph was not run, because a gate refused."""


@contextmanager
def code_gate(gate: Callable[[ExternalFunction], None]) -> Iterator[None]:
    """Call `gate` within the block, in all threads of this process, before the code of an external function runs.

    The gate may raise `CodeNotRunError`; no code of the function runs then.
    """
    _gates.append(gate)
    try:
        yield
    finally:
        _gates.remove(gate)


def has_gates() -> bool:
    """Return True within a block that `code_gate` guards."""
    return bool(_gates)


def load_functions(nodes: Iterable[Node]) -> None:
    """Load the external functions that nodes call, so that their machine code can run."""
    for node in nodes:
        if node.op == "external":
            load_function(node.payload.function)


def function_remarks(nodes: Iterable[Node]) -> tuple[str, ...]:
    """Load the functions that nodes call and that keep no memory, and return what they say about their derivatives."""
    functions = dict.fromkeys(node.payload.function for node in nodes if node.op == "external")
    loaded = [load_function(f) for f in functions if not (f.batched or f.sequential)]
    return tuple(dict.fromkeys(text for function in loaded for text in getattr(function, "remarks", ())))


def changing_results(nodes: Iterable[Node]) -> tuple[Finding, ...]:
    """Return warnings about functions for all samples at once that nodes call, whose results change between calls.

    Equal arguments must give equal results. Code that draws random numbers, or that counts its calls, does not keep to
    that, and the end of a fit is then one of chance.
    """
    functions = dict.fromkeys(node.payload.function for node in nodes if node.op == "external")
    return tuple(finding for f in functions if f.batched for finding in batch_function(f).changing_results())


def batch_function(function: ExternalFunction) -> BatchFunction:
    """Load an external function that is batched."""
    loaded = load_function(function)
    assert function.batched
    return cast(BatchFunction, loaded)


def trajectories_at_once(function: ExternalFunction) -> int:
    """Load a sequential function, and return how many of its trajectories may run at once."""
    loaded = load_function(function)
    assert function.sequential
    return cast(SequentialFunction, loaded).trajectories


def evaluate_points(function: ExternalFunction, points: Float) -> tuple[Float, Float]:
    """Call a function at points, Float[points, inputs].

    Returns:
        The outputs, Float[points, outputs], and their slopes, Float[points, outputs, inputs].
    """
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(load_function(function).address)
    points = np.ascontiguousarray(points, dtype=np.float64)
    results = np.empty((len(points), function.outputs))
    slopes = np.ones((len(points), function.outputs, function.inputs))
    for point, result, slope in zip(points, results, slopes, strict=True):
        call(point.ctypes.data, result.ctypes.data, slope.ctypes.data)
    return results, slopes


def load_function(function: ExternalFunction) -> LoadedFunction:
    """Load an external function, so that machine code can call it.

    Raises:
        CodeNotRunError: a gate refused.
        InputError: its code cannot be used.
    """
    for gate in _gates:
        gate(function)
    return _load(function)


@computed_once
def _load(function: ExternalFunction) -> LoadedFunction:
    from kennfeld.base.machine_code.external import provide  # here, because graphs are read without machine code

    module, _, name = function.loader.partition(":")
    loaded: LoadedFunction = getattr(import_module(module), name)(*function.arguments)
    provide(function.symbol, loaded.address)
    return loaded
