"""Comparison of exported code with the simulation by Kennfeld, over the data of a problem."""

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.host_compiler import CompiledFunction, HostCompiler
from kennfeld.export.prepared import Precision, PreparedFunction
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator


@dataclass(frozen=True)
class OutputDeviation:
    """The largest deviation of an output from the simulation, infinite if only one of both is NaN; and its range."""

    name: str
    unit: str
    largest: float
    range: float

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} by at most {self.largest:.2g} of {self.range:.4g}{unit}"


@dataclass(frozen=True)
class CodeComparison:
    """Deviations of compiled code from the simulation."""

    compiler: str
    samples: int
    outputs: tuple[OutputDeviation, ...]

    @property
    def is_exact(self) -> bool:
        """True if all bits are equal; of no samples, nothing is known."""
        return self.samples > 0 and all(output.largest == 0 for output in self.outputs)

    def __str__(self) -> str:
        if not self.samples:
            return f"compiled with {self.compiler}, but not compared: the data have no samples"
        head = f"compiled with {self.compiler} over {count_noun(self.samples, 'sample')}: "
        if self.is_exact:
            return head + "equal to the simulation, bit for bit"
        return head + f"differs from the simulation in {', '.join(map(str, self.outputs))}"


def compare(
    function: PreparedFunction, precision: Precision, compiler: HostCompiler, problem: Problem
) -> CodeComparison:
    """Compile a function and run it over all datasets of a problem.

    Raises:
        CompilationError: the compiler fails.
    """
    compiled = CompiledFunction(function, precision, compiler)
    names = [output.name for output in function.outputs]
    # with all nodes, as a simulation computes them
    simulator = NodeSimulator(problem.graph, function.values, names)
    largest, low, high, samples = np.zeros(len(names)), np.full(len(names), np.inf), np.full(len(names), -np.inf), 0
    for data in problem.datasets:
        bound = problem.bind(data)
        if not bound.count:
            continue
        expected = simulator.values(bound, function.values)
        got = compiled.over(bound.columns, bound.count, bound.starts.tolist())
        largest = np.maximum(largest, deviations(got, expected))
        # of an output that is NaN throughout, there is no range
        low, high = np.fmin(low, np.fmin.reduce(expected, axis=1)), np.fmax(high, np.fmax.reduce(expected, axis=1))
        samples += bound.count
    with np.errstate(invalid="ignore"):
        spans = np.where(high > low, high - low, 0.0)
    rows = zip(function.outputs, largest, spans, strict=True)
    return CodeComparison(
        compiler.name, samples, tuple(OutputDeviation(y.name, y.unit, float(d), float(r)) for y, d, r in rows)
    )


def deviations(got: Float, expected: Float) -> Float:
    """Return the largest deviation of each row, Float[rows]; infinite where only one of both is NaN or infinite.

    >>> deviations(np.array([[1.0, np.nan]]), np.array([[1.5, np.nan]]))
    array([0.5])
    """
    equal = (got == expected) | (np.isnan(got) & np.isnan(expected))
    with np.errstate(invalid="ignore"):
        apart = np.where(equal, 0.0, np.abs(got - expected))
    result: Float = np.max(np.where(np.isnan(apart), np.inf, apart), axis=1, initial=0.0)
    return result
