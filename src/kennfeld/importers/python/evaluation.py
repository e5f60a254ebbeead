"""Evaluation of Python functions, for one sample or for many at once, with slopes."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from inspect import unwrap
from pathlib import Path
from typing import Any, Final

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.finite_differences import difference_step

_STEP: Final = difference_step(0.0)
_LEAST_SIZE: Final = 1e-4  # of an argument: steps are relative to its size
_COMPARED: Final = 16  # samples at which arrays and numbers must give the same
_TOLERANCE: Final = 1e-9
_AGREEMENT: Final = 1e-3  # of the largest slope

NumberFunction = Callable[..., Any]


class PythonEvaluation:
    """A function of numbers that returns one number, or a tuple of them.

    Args:
        name: the name of the function, for messages.
        function: the function. If it takes arrays as well, it is called with those of all samples.
        inputs: number of arguments.
        outputs: number of results.
        jacobian: returns the slopes along all arguments, for several results a sequence of them for each result; None
            for central differences.

    What the function cannot compute, because it raises an exception or returns something else, is NaN. If it cannot
    compute any of the first samples, `evaluate` raises `InputError`.
    """

    def __init__(
        self, name: str, function: NumberFunction, inputs: int, outputs: int, jacobian: NumberFunction | None = None
    ) -> None:
        self.name, self.function, self.jacobian = name, function, jacobian
        self.inputs, self.outputs = inputs, outputs
        self._takes_arrays: bool | None = None  # unknown before there are samples
        self._jacobian_agrees = jacobian is None
        # arguments to call the function with again, and its results
        self._called: deque[tuple[list[float], list[float]]] = deque(maxlen=2 * _COMPARED)

    def point(self, arguments: Sequence[float]) -> list[float]:
        """Compute the results for numbers; NaN for what the function cannot compute."""
        results = self._numbers(arguments)
        self._called.append(([*arguments], results))
        return results

    def changing_results(self) -> list[Finding]:
        """Call the function twice at some samples of the last calls; return a warning if results differ."""
        points, results = [arguments for arguments, _ in self._called], [numbers for _, numbers in self._called]
        first = [self._numbers(arguments) for arguments in points]
        # in the opposite order, so that what the function keeps of the previous call is something else
        second = [self._numbers(arguments) for arguments in reversed(points)][::-1]
        for arguments, earlier, one, other in zip(points, results, first, second, strict=True):
            # a call with arrays may differ by rounding, but not in what it can compute
            if not np.array_equal(np.isnan(earlier), np.isnan(one)):
                return [self._changing(arguments, earlier, one)]
            if not np.array_equal(one, other, equal_nan=True):
                return [self._changing(arguments, one, other)]
        return []

    def _note_calls(self, points: Float, results: Float) -> None:
        self._called.extend(zip(points.T.tolist(), results.T.tolist(), strict=True))

    def _changing(self, arguments: Sequence[float], first: Sequence[float], second: Sequence[float]) -> Finding:
        at = next(at for at, pair in enumerate(zip(first, second, strict=True)) if not _is_same(*pair))
        message = (
            f"{self.name} gives different results for equal arguments: {first[at]:.6g} and {second[at]:.6g} at "
            f"{', '.join(f'{x:.6g}' for x in arguments)}. The end of the fit is one of chance"
        )
        code = getattr(unwrap(self.function), "__code__", None)
        location = Location(self.name) if code is None else Location(Path(code.co_filename).name, code.co_firstlineno)
        remedy = "Let results depend on the arguments alone: no random numbers, no variables that calls change."
        return Finding(location, message, remedy, severity="warning")

    def _numbers(self, arguments: Sequence[float]) -> list[float]:
        try:
            result = self.function(*arguments)
            numbers = [float(item) for item in _sequence(result, self.outputs)]
        except (Exception, SystemExit):  # neither can pass through machine code
            return [math.nan] * self.outputs
        return numbers if len(numbers) == self.outputs else [math.nan] * self.outputs

    def point_slopes(self, arguments: Sequence[float], along: Sequence[int]) -> Float:
        """Compute the slopes for numbers, Float[outputs, len(along)]."""
        if self.jacobian is None:
            return self._differences(np.array(arguments)[:, None], along, np.zeros(self.inputs), self._by_sample)[
                ..., 0
            ]
        return self._rows_of_jacobian(arguments)[:, list(along)]

    def evaluate(self, points: Float, along: Sequence[int]) -> tuple[Float, Float]:
        """Compute results and slopes at many samples; see `BatchFunction`.

        `points` are Float[inputs, samples], the results Float[outputs, samples], and the slopes
        Float[outputs, len(along), samples].
        """
        compute = self._at_all if self._accepts_arrays(points) else self._by_sample
        with np.errstate(all="ignore"):
            results = compute(points)
            places = _places(points.shape[1])
            self._note_calls(points[:, places], results[:, places])
            if not len(along):
                return results, np.empty((self.outputs, 0, points.shape[1]))
            if self.jacobian is not None:
                self._check_jacobian(points)
                return results, self._jacobians(points, compute)[:, list(along)]
            # a value near 0 among large ones takes a step of their size
            return results, self._differences(points, along, _LEAST_SIZE * _largest(points), compute)

    def _at_all(self, points: Float) -> Float:
        try:
            return self._arrays(self.function(*_protected(points)), points.shape[1])
        except (Exception, SystemExit):
            return self._by_sample(points)

    def _by_sample(self, points: Float) -> Float:
        results = np.empty((self.outputs, points.shape[1]))
        for at, arguments in enumerate(points.T.tolist()):
            results[:, at] = self._numbers(arguments)
        return results

    def _arrays(self, result: Any, count: int) -> Float:
        items = [np.asarray(item, dtype=np.float64) for item in _sequence(result, self.outputs)]
        return np.array([np.broadcast_to(item, (count,)) for item in items]).reshape(self.outputs, count)

    def _accepts_arrays(self, points: Float) -> bool:
        """Return True if the function gives the same for arrays as for the numbers in them, at a few samples."""
        if self._takes_arrays is None and points.shape[1] > 1:
            picked = _picked(points)
            expected = self._by_sample(picked)
            self._check_results(picked[:, 0], expected)
            self._note_calls(picked, expected)
            try:
                with np.errstate(all="ignore"):
                    results = self._arrays(self.function(*_protected(picked)), picked.shape[1])
                self._takes_arrays = np.allclose(results, expected, rtol=_TOLERANCE, atol=0.0, equal_nan=True)
            except (Exception, SystemExit):
                self._takes_arrays = False
        return bool(self._takes_arrays)

    def _check_results(self, arguments: Float, results: Float) -> None:
        """Raise `InputError` with the reason why there are no results, if there are none."""
        if not np.isnan(results).all():
            return
        at = ", ".join(f"{x:.6g}" for x in arguments)
        try:
            returned = self.function(*arguments.tolist())
            numbers = [float(item) for item in _sequence(returned, self.outputs)]
        except (Exception, SystemExit) as error:
            message = f"the function fails at {at}: {error!r:.200}"
            raise InputError.of(Location(self.name), message, "It must take numbers and return numbers.") from error
        if len(numbers) != self.outputs:
            message = f"the function returns {len(numbers)} numbers, not {self.outputs}"
            remedy = 'Name its results: function(f, outputs=["a", "b"]).'
            raise InputError.of(Location(self.name), message, remedy)

    def _check_jacobian(self, points: Float) -> None:
        """Raise `InputError` if the function's own derivative and differences disagree at most of a few samples."""
        if self._jacobian_agrees or not points.size:
            return
        picked, along = _picked(points), range(self.inputs)
        own = self._jacobians(picked, self._by_sample)
        if np.isnan(own).all():
            self._check_rows(picked[:, 0].tolist())
        differences = self._differences(picked, along, np.zeros(self.inputs), self._by_sample)
        size = np.maximum(np.abs(own), np.abs(differences)).max(axis=2, keepdims=True, initial=0.0)
        wrong = np.abs(own - differences) > _AGREEMENT * size  # at a kink they may differ
        for result, argument in np.argwhere(np.mean(wrong, axis=2) > 0.5).tolist():
            at = int(np.flatnonzero(wrong[result, argument])[0])
            message = (
                f"the derivative of result {result + 1} along argument {argument + 1} is "
                f"{own[result, argument, at]:.6g} by jac and {differences[result, argument, at]:.6g} by differences, "
                f"at {', '.join(f'{x:.6g}' for x in picked[:, at])}"
            )
            raise InputError.of(Location(self.name), message, "Correct jac, or leave it out.")
        self._jacobian_agrees = True

    def _check_rows(self, arguments: Sequence[float]) -> None:
        """Raise `InputError` with the reason why the function's own derivative has no slopes, if it has none."""
        at = ", ".join(f"{x:.6g}" for x in arguments)
        remedy = "It must return one slope for each argument; for several results, such a row for each result."
        try:
            lengths = [len(row) for row in self._numbers_of_jacobian(arguments)]
        except (Exception, SystemExit) as error:
            raise InputError.of(Location(self.name), f"jac fails at {at}: {error!r:.200}", remedy) from error
        if lengths != [self.inputs] * self.outputs:
            counts = " and ".join(map(str, lengths)) or "0"
            message = f"jac returns rows of {counts} slopes, expected {self.outputs} of {self.inputs}"
            raise InputError.of(Location(self.name), message, remedy)

    def _differences(
        self, points: Float, along: Sequence[int], least: Float, compute: Callable[[Float], Float]
    ) -> Float:
        """Compute central differences, Float[outputs, len(along), samples]."""
        slopes = np.empty((self.outputs, len(along), points.shape[1]))
        changed, step = points.copy(), np.empty(points.shape[1])
        for position, argument in enumerate(along):
            value, moved = points[argument], changed[argument]
            # (f(x + h) - f(x - h)) / ((x + h) - (x - h)), the width as rounded; h = _STEP max(|x|, least, _LEAST_SIZE)
            np.maximum(np.abs(value, out=step), max(float(least[argument]), _LEAST_SIZE), out=step)
            step *= _STEP
            np.add(value, step, out=moved)
            width, above = moved.copy(), compute(changed)
            np.subtract(value, step, out=moved)
            width -= moved
            np.divide(np.subtract(above, compute(changed), out=above), width, out=slopes[:, position])
            # `changed` differs from the points in one argument at a time
            moved[:] = value
        return slopes

    def _jacobians(self, points: Float, compute: Callable[[Float], Float]) -> Float:
        """Return the slopes along all arguments from the function's own derivative, Float[outputs, inputs, samples]."""
        count = points.shape[1]
        slopes = np.empty((self.outputs, self.inputs, count))
        if compute == self._at_all:
            assert self.jacobian is not None
            try:
                for row, result in zip(slopes, self._by_result(self.jacobian(*_protected(points))), strict=True):
                    for own, item in zip(row, result, strict=True):
                        own[:] = item
                return slopes
            except (Exception, SystemExit):  # it takes numbers only
                pass
        for at, arguments in enumerate(points.T.tolist()):
            slopes[:, :, at] = self._rows_of_jacobian(arguments)
        return slopes

    def _rows_of_jacobian(self, arguments: Sequence[float]) -> Float:
        try:
            return np.array(self._numbers_of_jacobian(arguments)).reshape(self.outputs, self.inputs)
        except (Exception, SystemExit):
            return np.full((self.outputs, self.inputs), np.nan)

    def _numbers_of_jacobian(self, arguments: Sequence[float]) -> list[list[float]]:
        assert self.jacobian is not None
        return [[float(item) for item in row] for row in self._by_result(self.jacobian(*arguments))]

    def _by_result(self, jacobian: Any) -> Sequence[Any]:
        """Return the rows of a derivative: one for each result, of one item for each argument."""
        return list(jacobian) if self.outputs > 1 else [_sequence(jacobian, self.inputs)]


def _largest(points: Float) -> Float:
    """Return the largest size of each argument, Float[arguments]; numbers that are not finite do not count."""
    sizes = np.abs(points)
    largest: Float = np.max(sizes, axis=1, initial=0.0)
    if not np.isfinite(largest).all():
        largest = np.max(sizes, axis=1, initial=0.0, where=np.isfinite(sizes))
    return largest


def _protected(points: Float) -> Float:
    """Return a view of points that a function cannot change: one that tries is called with numbers."""
    view = points.view()
    view.flags.writeable = False
    return view


def _is_same(a: float, b: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b))


def _picked(points: Float) -> Float:
    return points[:, _places(points.shape[1])]


def _places(samples: int) -> Int:
    """Return some of the samples, spread over all of them."""
    return np.unique(np.linspace(0, max(samples - 1, 0), _COMPARED).astype(np.int64))[:samples]


def _sequence(result: Any, count: int) -> Sequence[Any]:
    """Return several results as a sequence; a single one may stand alone."""
    return list(result) if isinstance(result, tuple | list) or (count > 1 and hasattr(result, "__len__")) else [result]
