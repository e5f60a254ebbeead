"""Problems with a planted truth and a start within two decades of it, as formula text and as numpy.

The functions in numpy accept complex values, so that complex steps give their exact Jacobian.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "BadStart", "problem"]

Float = NDArray[np.float64]
Model = Callable[..., Any]

SAMPLES = 100
DECADES = 2.0  # the start is the truth times 10^u, u uniform between -DECADES and DECADES
NOISE = 0.01  # of the standard deviation of the exact output, in every second problem
STEP = 1e-200  # of the complex steps
GAS = 8.314
THERMAL_VOLTAGE = 0.0257


@dataclass(frozen=True)
class Kind:
    """A function as text and in numpy, its inputs, and the ranges in which truths are drawn, uniform in logarithms."""

    formula: str
    model: Model  # of the inputs, then the parameters in the order of `ranges`
    inputs: Callable[[np.random.Generator], Mapping[str, Float]]
    ranges: Mapping[str, tuple[float, float]]
    axes: Mapping[str, tuple[Float, ...]] = field(default_factory=dict)  # of the parameters that are tables


@dataclass(frozen=True)
class BadStart:
    """One problem: `size` values in `start` and `truth`, tables flat in the order of their names."""

    kind: Kind
    inputs: Mapping[str, Float]
    target: Float
    truth: Float
    start: Float

    def residual(self, values: Any) -> Any:
        """Return prediction minus target; real or complex, as the values are."""
        arguments, first = [], 0
        for name in self.kind.ranges:
            shape = tuple(axis.size for axis in self.kind.axes.get(name, ()))
            size = int(np.prod(shape))
            arguments.append(values[first : first + size].reshape(shape) if shape else values[first])
            first += size
        return self.kind.model(*self.inputs.values(), *arguments) - self.target

    def jacobian(self, values: Float) -> Float:
        """Return its exact derivatives, Float[samples, values]."""
        columns = []
        for number in range(values.size):
            shifted = values.astype(complex)
            shifted[number] += 1j * STEP
            columns.append(self.residual(shifted).imag / STEP)
        return np.stack(columns, axis=1)

    def cost(self, values: Float) -> float:
        """Return the sum of squares."""
        residual = self.residual(values)
        return float(residual @ residual)

    def gradient_angle(self, values: Float) -> float:
        """Return the largest cosine between the residuals and a column of the Jacobian, 0 at a stationary point."""
        residual, jacobian = self.residual(values), self.jacobian(values)
        jacobian = jacobian / np.maximum(np.abs(jacobian).max(axis=0), np.finfo(float).tiny)  # squares do not underflow
        lengths = np.linalg.norm(jacobian, axis=0) * np.linalg.norm(residual)
        return float(np.max(np.abs(jacobian.T @ residual) / np.where(lengths > 0, lengths, 1.0)))


def problem(name: str, number: int) -> BadStart:
    """Return problem `number` of a kind; every second one has noise."""
    kind = KINDS[name]
    random = np.random.default_rng([list(KINDS).index(name), number])
    inputs = kind.inputs(random)
    truths, starts = [], []
    for parameter, (low, high) in kind.ranges.items():
        size = int(np.prod([axis.size for axis in kind.axes.get(parameter, ())]))
        sign = np.sign(low)
        truth = sign * np.exp(random.uniform(*np.sort(np.log(np.abs([low, high]))), size))
        truths.append(truth)
        starts.append(truth * 10 ** random.uniform(-DECADES, DECADES, size))
    exact = BadStart(kind, inputs, np.zeros(1), np.concatenate(truths), np.concatenate(starts))
    target = exact.residual(exact.truth)
    if number % 2:
        target = target + NOISE * np.std(target) * random.standard_normal(target.size)
    return BadStart(kind, inputs, target, exact.truth, exact.start)


def _even(name: str, low: float, high: float) -> Callable[[np.random.Generator], Mapping[str, Float]]:
    return lambda random: {name: np.linspace(low, high, SAMPLES)}


def _steps(random: np.random.Generator) -> dict[str, Float]:
    return {"time": 0.1 * np.arange(4 * SAMPLES), "u": np.repeat(random.uniform(0, 10, 8), SAMPLES // 2)}


def _scattered(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], Mapping[str, Float]]:
    return lambda random: {name: random.uniform(*limits, 4 * SAMPLES) for name, limits in ranges.items()}


def _lag(time: Float, x: Any, constant: Any) -> Any:
    """Return implicit Euler steps of a PT1 that starts at its input."""
    gain = (time[1] - time[0]) / (constant + (time[1] - time[0]))
    y = np.empty(x.size, dtype=np.result_type(x, constant))
    y[0] = x[0]
    for i in range(1, x.size):
        y[i] = y[i - 1] + gain * (x[i] - y[i - 1])
    return y


def _weights(axis: Float, x: Float) -> Float:
    """Return the weights of the breakpoints in linear interpolation, Float[samples, breakpoints]."""
    return np.stack([np.interp(x, axis, row) for row in np.eye(axis.size)], axis=1)


SPEEDS, LOADS = np.linspace(800, 6000, 8), np.linspace(0.2, 1.6, 5)

KINDS: dict[str, Kind] = {
    "exponential": Kind(
        "y = a*exp(b*x)",
        lambda x, a, b: a * np.exp(b * x),
        _even("x", 0, 10),
        {"a": (0.5, 20), "b": (0.03, 0.8)},
    ),
    "decay": Kind(
        "y = a*exp(b*x) + c",
        lambda x, a, b, c: a * np.exp(b * x) + c,
        _even("x", 0, 10),
        {"a": (0.5, 20), "b": (-2, -0.1), "c": (0.5, 20)},
    ),
    "power": Kind(
        "y = a*x^n",
        lambda x, a, n: a * x**n,
        _even("x", 1, 50),
        {"a": (0.1, 10), "n": (0.3, 3)},
    ),
    "logistic": Kind(
        "y = L/(1 + exp(-k*(x - c)))",
        lambda x, height, k, c: height / (1 + np.exp(-k * (x - c))),
        _even("x", 0, 10),
        {"L": (1, 100), "k": (0.3, 5), "c": (2, 8)},
    ),
    "Arrhenius": Kind(
        "y = A*exp(-E/(8.314*T))",
        lambda t, a, e: a * np.exp(-e / (GAS * t)),
        _even("T", 400, 900),
        {"A": (1e3, 1e7), "E": (2e4, 9e4)},
    ),
    "NTC": Kind(
        "y = R*exp(B*(1/T - 1/298.15))",
        lambda t, r, b: r * np.exp(b * (1 / t - 1 / 298.15)),
        _even("T", 240, 420),
        {"R": (1e3, 1e5), "B": (2500, 4500)},
    ),
    "diode": Kind(
        "y = I*(exp(U/(n*0.0257)) - 1)",
        lambda u, i, n: i * (np.exp(u / (n * THERMAL_VOLTAGE)) - 1),
        _even("U", 0.0, 0.7),
        {"I": (1e-12, 1e-7), "n": (1, 2)},
    ),
    "friction": Kind(
        "y = a + b*x^n",
        lambda x, a, b, n: a + b * x**n,
        _even("x", 0.8, 6.5),
        {"a": (1, 20), "b": (0.1, 5), "n": (0.5, 3)},
    ),
    "PT1": Kind(
        "y = PT1(k*u, T)",
        lambda time, u, k, constant: _lag(time, k * u, constant),
        _steps,
        {"k": (0.1, 10), "T": (0.2, 5)},
    ),
    "PT2": Kind(
        "y = PT1(PT1(k*u, T1), T2)",
        lambda time, u, k, one, two: _lag(time, _lag(time, k * u, one), two),
        _steps,
        {"k": (0.1, 10), "T1": (0.2, 1), "T2": (1, 5)},
    ),
    "curve times scalar": Kind(
        "y = C(n)*(1 - exp(-k*z))",
        lambda n, z, curve, k: (_weights(SPEEDS, n) @ curve) * (1 - np.exp(-k * z)),
        _scattered(n=(800, 6000), z=(0, 5)),
        {"C": (20, 300), "k": (0.3, 3)},
        {"C": (SPEEDS,)},
    ),
    "map": Kind(
        "y = M(n, L)*exp(k*d)",
        lambda n, load, d, table, k: (
            np.einsum("ta,tb,ab->t", _weights(SPEEDS, n), _weights(LOADS, load), table) * np.exp(k * d)
        ),
        _scattered(n=(800, 6000), L=(0.2, 1.6), d=(-1, 1)),
        {"M": (20, 300), "k": (0.1, 1)},
        {"M": (SPEEDS, LOADS)},
    ),
}
