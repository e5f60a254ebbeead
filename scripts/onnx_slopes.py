"""Compares the derivatives of a network with differences of high order, in double precision."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.models.model_function import ModelFunction

Float = np.ndarray[Any, Any]

SAME = "slopes of differences"
CONSTANT = "constant"
KINK = "a kink or a step"
DIFFERENT = "other slopes than differences"

TOLERANCE = 1e-7  # of the largest slope of an output
STEPS = (2.0**-13, 2.0**-13, 2.0**-9, 2.0**-13)  # of inputs up to `LARGE`, a point each until one is smooth
LARGE = 1024.0  # inputs above that have steps in proportion to them
ROUNDING = 100 * np.finfo(float).eps  # of an output, relative to its size
MOST_VALUES = 10_000_000  # of nodes times points at once
MOVED = 0.1  # distance of a point from the one before; the last has positive inputs only
_PLACES = np.arange(-4, 5)  # in steps
_CENTRAL = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])  # order 8
_FORWARD = np.array([0.0] * 4 + [-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4])  # order 4
_BACKWARD = -_FORWARD[::-1]


def slope_verdict(function: ModelFunction, point: Float, moving: Sequence[bool]) -> str:
    """Compare the slopes along inputs, and along one direction of all weights, with differences.

    A point counts only if differences to the left, to the right and to both sides agree for each output along each
    direction. Otherwise there is a kink, a step, or rounding that hides the slopes, and points nearby are tried. This
    rule does not look at the derivatives.

    Args:
        function: the function.
        point: its inputs.
        moving: inputs that are real numbers, along which there are slopes.

    Returns:
        `SAME`, `DIFFERENT`, `CONSTANT` if all slopes are 0, or `KINK` if none of the points counts.
    """
    trial, random = _Trial(function, moving), np.random.default_rng(0)
    verdict = CONSTANT
    for number, step in enumerate(STEPS):
        if number:
            moved = np.nan_to_num(point, posinf=1.0, neginf=-1.0) + MOVED * random.standard_normal(len(point))
            moved = np.abs(moved) + MOVED if number == len(STEPS) - 1 else moved
            point = np.where(moving, moved, point)
        with np.errstate(all="ignore"):
            verdict = trial.verdict(point, step)
        if verdict != KINK:
            break
    return verdict


class _Trial:
    """A function whose inputs are sums of a channel and a scalar parameter 0."""

    def __init__(self, function: ModelFunction, moving: Sequence[bool]) -> None:
        builder = GraphBuilder()
        self.moving = [number for number, moves in enumerate(moving) if moves]
        names = [f"p{number}" for number in self.moving]
        arguments = [builder.input(f"i{number}") for number in range(len(moving))]
        for number, name in zip(self.moving, names, strict=True):
            arguments[number] = builder.call("add", arguments[number], builder.lookup(name))
        nodes = function.write(builder, arguments)
        graph = builder.finish({f"o{number}": node for number, node in enumerate(nodes)})
        self.weights = [name for name in function.values if name in graph.parameters]
        used = [name for name in names if name in graph.parameters]
        self.moving = [int(name[1:]) for name in used]
        self.parameters = function.values.with_parameters(*(Scalar(name, 0.0) for name in used))
        self.lowered: LoweredGraph = lower_lookups(graph, self.parameters)
        self.outputs = [self.lowered.graph.names[name] for name in graph.names]
        self.free = (*used, *self.weights)
        random = np.random.default_rng(1)
        self.direction = {name: random.standard_normal(self.parameters[name].values.shape) for name in self.weights}

    def verdict(self, point: Float, step: float) -> str:
        if not self.outputs:
            return CONSTANT
        size, central, *sides = self._differences(point, step)
        if not all(np.isfinite(array).all() for array in (size, central, *sides)):
            return KINK
        largest = np.abs(central).max(axis=1, initial=0.0)
        tolerance = (TOLERANCE * largest + ROUNDING / step * size)[:, None]
        if any((np.abs(side - central) > tolerance).any() for side in sides):
            return KINK
        if not (np.abs(self._slopes(point) - central) <= tolerance).all():
            return DIFFERENT
        return SAME if largest.any() else CONSTANT

    def _differences(self, point: Float, step: float) -> tuple[Float, ...]:
        """Return the size of the outputs, and their central, forward and backward differences [outputs, directions]."""
        steps = step * np.maximum(np.abs(point) / LARGE, 1.0)
        count = max(MOST_VALUES // max(len(_PLACES) * len(self.lowered.graph.nodes), 1), 1)
        parts = [self.moving[first : first + count] for first in range(0, len(self.moving), count)]
        values = [self._along_inputs(point, steps, part) for part in parts]
        lengths = [steps[part] for part in parts]
        if self.weights:
            values.append(self._along_weights(point, step))
            lengths.append(np.array([step]))
        table = np.concatenate([np.zeros((len(self.outputs), 0, len(_PLACES))), *values], axis=1)
        length = np.concatenate([np.zeros(0), *lengths])
        size = np.abs(table).max(axis=(1, 2), initial=0.0)
        return size, *(table @ weights / length for weights in (_CENTRAL, _FORWARD, _BACKWARD))

    def _along_inputs(self, point: Float, steps: Float, part: Sequence[int]) -> Float:
        """Return the outputs at points along some inputs, [outputs, inputs, places]."""
        points = np.broadcast_to(point[:, None, None], (len(point), len(part), len(_PLACES))).copy()
        for row, number in enumerate(part):
            points[number, row] += steps[number] * _PLACES
        return self._run(points.reshape(len(point), -1), self.parameters).reshape(-1, len(part), len(_PLACES))

    def _along_weights(self, point: Float, step: float) -> Float:
        """Return the outputs at points along the direction of the weights, [outputs, 1, places]."""
        columns = []
        for place in _PLACES:
            blocks = [
                self.parameters[name].with_values(self.parameters[name].values + step * place * direction)
                for name, direction in self.direction.items()
            ]
            columns.append(self._run(point[:, None], self.parameters.with_parameters(*blocks)))
        return np.stack(columns, axis=2)

    def _run(self, points: Float, parameters: ParameterSet) -> Float:
        run = Interpreter(self.lowered, parameters).run(self.lowered.graph.nodes, (), self._columns(points))
        return np.array([run[at] for at in self.outputs])

    def _slopes(self, point: Float) -> Float:
        """Return the derivatives, [outputs, directions]."""
        line = differentiate(self.lowered.graph, self.outputs, self.free)
        sizes = [self.parameters[name].size for name in self.free]
        offsets = dict(zip(self.free, np.cumsum([0, *sizes]).tolist(), strict=False))
        rows = Interpreter(self.lowered, self.parameters).rows(line, offsets, self._columns(point[:, None]))
        jacobian = rows.jacobian[0]
        if not self.weights:
            return jacobian
        inputs = len(self.moving)
        direction = np.concatenate([each.ravel() for each in self.direction.values()])
        return np.column_stack([jacobian[:, :inputs], jacobian[:, inputs:] @ direction])

    @staticmethod
    def _columns(points: Float) -> dict[str, Float]:
        return {f"i{number}": column for number, column in enumerate(points)} or {"none": np.zeros(1)}
