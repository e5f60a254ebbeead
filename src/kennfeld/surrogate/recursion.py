"""Recursion of a dynamic model: y_k = f(its own past values, the inputs and their past values), within limits.

Pieces of recordings are simulated in parallel; steps after the end of a short one are ignored.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.ir import LANES
from kennfeld.domain.rbf import Expansion

UNLIMITED = (-np.inf, np.inf)
BLOCK = 1 << 19  # basis functions whose input part is computed in advance: 4 MB


@dataclass(frozen=True)
class Lags:
    """Lags, in samples, of the output (>= 1) and of each input (0 is the present) that a model reads.

    A point of the model's expansion is [the output at each lag, then each input at each of its lags].

    >>> Lags((2, 1), ((0, 1), (0,))).output, Lags((1, 2), ((0, 1), (0,))).size
    ((1, 2), 5)
    """

    output: tuple[int, ...]
    inputs: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "output", _check_lags("output_lags", self.output, 1))
        object.__setattr__(self, "inputs", tuple(_check_lags("lags", lags, 0) for lags in self.inputs))
        if not self.output:
            raise ArgumentError("output_lags=() of a dynamic model need at least one lag; without any it is static")

    @property
    def size(self) -> int:
        """Number of inputs of the function."""
        return len(self.output) + sum(len(lags) for lags in self.inputs)

    @property
    def longest(self) -> int:
        """The longest of all lags."""
        return max(self.output + tuple(lag for lags in self.inputs for lag in lags))

    def of_inputs(self, u: Float, first: int) -> Float:
        """Return the input part of the points from sample `first`: Float[samples, inputs] -> Float[steps, ...].

        Before the recording the inputs have the values of its first sample.
        """
        before = max(self.longest - first, 0)
        padded = np.concatenate([np.repeat(u[:1], before, axis=0), u])
        begin, count = first + before, len(padded)
        columns = [padded[begin - lag : count - lag, j] for j, lags in enumerate(self.inputs) for lag in lags]
        return np.column_stack(columns) if columns else np.empty((max(count - begin, 0), 0))

    def of_outputs(self, y: Float, first: int) -> Float:
        """Return the output part of the points from sample `first`: Float[samples] -> Float[steps, ...]."""
        return np.column_stack([y[first - lag : len(y) - lag] for lag in self.output])


def _check_lags(name: str, lags: Sequence[int], least: int) -> tuple[int, ...]:
    if any(isinstance(lag, bool) or int(lag) != lag or lag < least for lag in lags):
        raise ArgumentError(f"{name}={tuple(lags)} must be whole numbers from {least} on")
    return tuple(sorted({int(lag) for lag in lags}))


@dataclass(frozen=True, eq=False)
class Recording:
    """One piece of a recording on an even raster; samples that are not `counted` are run through without a score."""

    u: Float  # Float[samples, inputs]
    y: Float  # Float[samples]
    counted: Bool | None = None  # Bool[samples]

    @property
    def scored(self) -> Bool:
        """Bool[samples]: the samples that count."""
        return np.ones(len(self.y), dtype=bool) if self.counted is None else self.counted

    def part(self, first: int, end: int) -> "Recording":
        """Return some of its samples."""
        counted = None if self.counted is None else self.counted[first:end]
        return Recording(self.u[first:end], self.y[first:end], counted)

    def __len__(self) -> int:
        return len(self.y)


@dataclass(frozen=True, eq=False)
class Runs:
    """Pieces side by side, as the recursion takes them; padded at their ends."""

    lags: Lags
    inputs: Float  # Float[steps, pieces, ...]: what the inputs give to each point
    history: Float  # Float[longest output lag, pieces]: the outputs before the first step, oldest first
    target: Float  # Float[steps, pieces]; NaN where it does not count
    points: Float  # Float[samples, size]: the points with the measured outputs that count, piece after piece

    @classmethod
    def of(cls, pieces: Sequence[Recording], lags: Lags, first: int | None = None) -> "Runs":
        """Return the pieces from sample `first` on, by default the longest lag, so that all it looks back at is known.

        An earlier `first`, at least the longest output lag, holds the inputs at their first sample before that.
        Raises `ArgumentError` where no piece is long enough.
        """
        back = max(lags.output)
        first = lags.longest if first is None else max(first, back)
        usable = [piece for piece in pieces if len(piece) > first]
        if not usable:
            raise ArgumentError(f"no piece of the recordings is longer than {first} samples, the lags of the model")
        steps = max(len(piece) for piece in usable) - first
        parts = [lags.of_inputs(piece.u, first) for piece in usable]
        inputs = np.zeros((steps, len(usable), parts[0].shape[1]))
        target = np.full((steps, len(usable)), np.nan)
        for i, (piece, part) in enumerate(zip(usable, parts, strict=True)):
            inputs[: len(part), i] = part
            # padding: any finite input keeps the run going, and no target scores it
            inputs[len(part) :, i] = part[-1]
            target[: len(part), i] = np.where(piece.scored, piece.y, np.nan)[first:]
        history = np.stack([piece.y[first - back : first] for piece in usable], axis=1)
        points = [
            np.column_stack([lags.of_outputs(piece.y, first), part])[piece.scored[first:]]
            for piece, part in zip(usable, parts, strict=True)
        ]
        return cls(lags, inputs, history, target, np.concatenate(points))

    @property
    def scored(self) -> Bool:
        """Bool[steps, pieces]: the steps that have a target."""
        return np.isfinite(self.target)

    @property
    def one_step_target(self) -> Float:
        """The output that belongs to each of `points`."""
        return self.target.T[self.scored.T]

    def visited(self, y: Float) -> Float:
        """Return the points that a free run `y` Float[steps, pieces] went through: Float[steps, pieces, size]."""
        back = max(self.lags.output)
        past = np.concatenate([self.history, y])
        lagged = [past[back - lag : back - lag + len(y)] for lag in self.lags.output]
        return np.concatenate([np.stack(lagged, axis=-1), self.inputs], axis=-1)


@dataclass(frozen=True, eq=False)
class FreeRun:
    """A free run: the output, and where a limit held it."""

    y: Float  # Float[steps, pieces]
    held: Bool  # Bool[steps, pieces]


def simulate(expansion: Expansion, runs: Runs, limits: tuple[float, float] = UNLIMITED) -> FreeRun:
    """Run the model on its own outputs from the history of each piece on.

    A run that grows beyond all bounds ends in numbers that are not finite.
    """
    from kennfeld.surrogate.recursion_code import free_run_code

    back, own = max(runs.lags.output), len(runs.lags.output)
    steps, pieces = runs.target.shape
    past = np.empty((back + steps, pieces))
    past[:back] = runs.history
    free = np.empty((steps, pieces))
    # results are numbered step by step, the pieces of a step side by side: y_{k-l} of result n is number
    # n + pieces * (back - l) of `past`
    offsets = pieces * (back - np.array(runs.lags.output, dtype=np.int64))
    padding = [(0, -expansion.size % LANES), (0, 0)]
    sides = [np.pad(part[:, :own], padding).T for part in (expansion.centres, 1 / expansion.widths)]
    weights = np.pad(expansion.weights, padding[0])
    model = np.concatenate([expansion.slopes[:own], limits, weights, *(side.ravel() for side in sides)])
    # what the inputs give to the plane, for all steps at once: only the outputs need the recursion
    flat = np.ascontiguousarray(expansion.offset + runs.inputs @ expansion.slopes[own:])
    code = free_run_code(own)
    for first, ahead in _ahead(expansion, runs.inputs, own):
        numbers = len(ahead) * pieces, weights.size
        parts = model, flat[first:], np.ascontiguousarray(ahead), past[first:], free[first:]
        code(*numbers, offsets.ctypes.data, *(part.ctypes.data for part in parts), back * pieces)
    with np.errstate(invalid="ignore"):
        held = (free < limits[0]) | (free > limits[1])
    return FreeRun(past[back:], held)


def _ahead(expansion: Expansion, inputs: Float, own: int) -> Iterator[tuple[int, Float]]:
    """Yield, by block, the share of the inputs in the exponents of all basis functions: Float[steps, pieces, centres].

    The last centres fill up a multiple of eight.
    """
    size = expansion.size + -expansion.size % LANES
    block = max(BLOCK // max(size * inputs.shape[1], 1), 1)
    exponents = _Exponents(expansion.centres[:, own:], expansion.widths[:, own:], size)
    for first in range(0, len(inputs), block):
        x = inputs[first : first + block]
        yield first, exponents.at(x.reshape(-1, x.shape[-1])).reshape(*x.shape[:2], size)


class _Exponents:
    """-1/2 sum_d ((x_d - z_d) / s_d)^2 of points, as one product with [x, x^2]; 0 of further centres up to `size`."""

    def __init__(self, centres: Float, widths: Float, size: int) -> None:
        used, inputs = centres.shape
        self._middle = centres.mean(0) if used else np.zeros(inputs)  # about which no digits are lost
        distances, steep = centres - self._middle, 1 / widths**2
        self._table = np.zeros((2 * inputs, size))
        self._table[:, :used] = np.concatenate([(distances * steep).T, -0.5 * steep.T])
        self._constant = np.zeros(size)
        self._constant[:used] = 0.5 * np.sum(distances**2 * steep, axis=1)

    def at(self, x: Float) -> Float:
        """Compute the exponents at points Float[points, inputs] -> Float[points, size]."""
        # -1/2 (x - z)^2 / s^2 = x z / s^2 - 1/2 x^2 / s^2 - 1/2 z^2 / s^2
        shifted = x - self._middle
        exponent: Float = np.concatenate([shifted, shifted**2], axis=-1) @ self._table
        exponent -= self._constant
        return np.minimum(exponent, 0.0, out=exponent)


def basis_values(expansion: Expansion, x: Float) -> Float:
    """Evaluate the Gaussian basis function of each centre at points Float[points, inputs] -> Float[points, centres]."""
    exponent = _Exponents(expansion.centres, expansion.widths, expansion.size).at(x)
    return np.exp(exponent, out=exponent)


def input_slopes(expansion: Expansion, x: Float, near: Float, own: int) -> Float:
    """Differentiate the function by the first `own` inputs at points Float[points, inputs]: Float[points, own].

    `near` Float[points, centres] are the values of the basis functions there.
    """
    # sum_m w_m k_m (z_md - x_d) / s_md^2, as two matrix products
    steep = expansion.weights[:, None] / expansion.widths[:, :own] ** 2
    pulled: Float = near @ (steep * expansion.centres[:, :own]) - x[:, :own] * (near @ steep)
    return expansion.slopes[:own] + pulled


def run_through(rows: Float, slopes: Float, lags: Sequence[int]) -> None:
    """Turn derivatives of f into those of the free run, in place: s_k += sum over lags l of df/dy_{k-l} s_{k-l}.

    `rows` Float[longest lag + steps, pieces, values] begin with those before the first step, `slopes` df/dy are
    Float[steps, pieces, lags].
    """
    from kennfeld.surrogate.recursion_code import derivative_code

    assert rows.flags.c_contiguous, "the code changes them in place"
    assert rows.dtype == np.float64, "the code changes them in place"
    back, (steps, pieces, _) = max(lags), slopes.shape
    offsets = pieces * (back - np.array(lags, dtype=np.int64))
    steep = np.ascontiguousarray(slopes, dtype=np.float64)
    addresses = offsets.ctypes.data, back * pieces, steep.ctypes.data, rows.ctypes.data
    derivative_code(len(lags))(steps * pieces, rows.shape[2], *addresses)
