"""Recurrent layers over a sequence of known length: RNN, GRU, LSTM.

Each step is written out. A network over one step, whose states are inputs and outputs, runs in a loop of the model. The
gates with the same activation are one dense layer of inputs and state, so that they have one parameter.
"""

from collections.abc import Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kennfeld.importers.onnx.elementwise import FORMULAS
from kennfeld.importers.onnx.layers import affine
from kennfeld.importers.onnx.network import Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first, join
from kennfeld.importers.onnx.tensors import (
    Tensor,
    UnsupportedOperatorError,
    constant,
    rearrange,
    shape_of,
)

# order of their blocks of rows: GRU update, reset, candidate; LSTM input, output, forget, candidate
_GATES = {"RNN": 1, "GRU": 3, "LSTM": 4}
_DEFAULTS = {"RNN": ["Tanh"], "GRU": ["Sigmoid", "Tanh"], "LSTM": ["Sigmoid", "Tanh", "Tanh"]}
_FUSED = {"Tanh": "tanh", "Sigmoid": "sigmoid"}
# defaults of alpha
_SLOPES = {"LeakyRelu": 0.01, "Elu": 1.0, "ThresholdedRelu": 1.0, "HardSigmoid": 0.2}


class _Activation(NamedTuple):
    """An activation with its parameters, and the limit of its argument; 0 for none."""

    kind: str
    alpha: float | None
    beta: float | None
    clip: float

    def __call__(self, c: Context, x: Tensor) -> Tensor:
        if self.clip > 0:
            x = c.apply("max", c.apply("min", x, self.clip), -self.clip)
        return self.unlimited(c, x)

    def unlimited(self, c: Context, x: Tensor) -> Tensor:
        alpha, beta = 1.0 if self.alpha is None else self.alpha, self.beta or 0.0
        match self.kind:
            case "Tanh":
                return c.apply("tanh", x)
            case "Affine":
                return c.apply("add", c.apply("mul", x, alpha), beta)
            case "ScaledTanh":
                return c.apply("mul", c.apply("tanh", c.apply("mul", x, beta)), alpha)
        if self.kind not in FORMULAS:
            raise UnsupportedOperatorError(f"activation {self.kind} is not supported")
        stated = {"alpha": self.alpha, "beta": self.beta}
        attributes = {name: value for name, value in stated.items() if value is not None}
        return FORMULAS[self.kind](c, Operator("", self.kind, "", 22, (), (), MappingProxyType(attributes)), x)


class _RecurrentCell(NamedTuple):
    """The weights of one direction of a layer; a gate is a block of `hidden` rows."""

    hidden: int
    weights: Tensor  # [gates * hidden, inputs]
    recurrence: Tensor  # [gates * hidden, hidden]
    biases: Tensor  # [2, gates * hidden]
    peepholes: Tensor | None  # [3, hidden]
    activations: Sequence[_Activation]
    late_reset: bool = False

    def gates(self, c: Context, x: Tensor, h: Tensor, numbers: Sequence[int], activation: _Activation) -> list[Tensor]:
        """Compute the outputs of gates with the same activation, each [batch, hidden]."""
        fused = not activation.clip and activation.kind in _FUSED
        total = self.sums(c, x, h, numbers, _FUSED[activation.kind] if fused else "identity")
        result = total if fused else activation(c, total)
        return [_take(result, slice(self.hidden * i, self.hidden * (i + 1)), 1) for i in range(len(numbers))]

    def sums(self, c: Context, x: Tensor, h: Tensor, numbers: Sequence[int], activation: str = "identity") -> Tensor:
        """Multiply inputs, [batch, inputs], and state, [batch, hidden], by weights: [batch, gates * hidden]."""
        places = np.concatenate([np.arange(self.hidden * i, self.hidden * (i + 1)) for i in numbers])
        own = [_take(each, places, 0) for each in (self.weights, self.recurrence)]
        # [W R]', [inputs + hidden, gates * hidden]; the file has a bias for W and one for R
        matrix = rearrange(np.transpose, join(c, own, 1))
        biases = _take(self.biases, places, 1)
        offsets = c.apply("add", _take(biases, 0, 0), _take(biases, 1, 0))
        return affine(c, join(c, [x, h], 1), matrix, offsets, activation)

    def peephole(self, c: Context, number: int, state: Tensor) -> Tensor:
        assert self.peepholes is not None
        return c.apply("mul", _take(self.peepholes, number, 0), state)


def _take(tensor: Tensor, places: "int | slice | np.ndarray", axis: int) -> Tensor:
    index = (slice(None),) * axis + (places,)
    return rearrange(lambda array: array[index], tensor)


def _in_rows(tensor: Tensor, rows: int) -> Tensor:
    return rearrange(lambda array: array.reshape(rows, -1), tensor)


@operator("RNN", "GRU", "LSTM")
def recurrent(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    x = first(arguments)
    by_batch = bool(op.get("layout", 0))
    if by_batch:
        x = _swapped(x)
    steps, batch, _ = shape_of(x)
    optional = [*arguments[1:], *[None] * 8]
    weights, recurrence, biases, lengths, hidden_start, cell_start, peepholes = optional[:7]
    if weights is None or recurrence is None or op.get("input_forget", 0):
        raise UnsupportedOperatorError("it has no weights, or input_forget, which is not supported")
    if lengths is not None and (constant(lengths, "sequence_lens") != steps).any():
        raise UnsupportedOperatorError("sequences of different lengths are not supported")
    hidden = shape_of(recurrence)[2]
    directions = {"forward": [1], "reverse": [-1], "bidirectional": [1, -1]}[op.get("direction", "forward")]
    outputs, ends = [], []
    for number, direction in enumerate(directions):
        cell = _RecurrentCell(
            hidden,
            _take(weights, number, 0),
            _take(recurrence, number, 0),
            np.zeros((2, _GATES[op.kind] * hidden)) if biases is None else _in_rows(_take(biases, number, 0), 2),
            None if peepholes is None else _in_rows(_take(peepholes, number, 0), 3),
            _activations(op, number, len(directions)),
            bool(op.get("linear_before_reset", 0)),
        )
        state = [
            np.zeros((batch, hidden)) if start is None else _take(_swapped(start) if by_batch else start, number, 0)
            for start in (hidden_start, cell_start)
        ]
        results: list[Tensor] = []
        # a reverse direction begins at the last sample, but its results have the order of the samples
        for step in range(steps)[::direction]:
            state = _STEPS[op.kind](c, cell, _take(x, step, 0), state)
            # [1 step, 1 direction, batch, hidden]
            results.append(rearrange(lambda array: array[None, None], state[0]))
        outputs.append(join(c, results[::direction], 0))
        ends.append([rearrange(lambda array: array[None], each) for each in state])
    whole = join(c, outputs, 1)
    last = [join(c, [end[i] for end in ends], 0) for i in range(2 if op.kind == "LSTM" else 1)]
    if by_batch:
        return [rearrange(lambda array: array.transpose(2, 0, 1, 3), whole), *map(_swapped, last)]
    return [whole, *last]


def _swapped(tensor: Tensor) -> Tensor:
    return rearrange(lambda array: array.swapaxes(0, 1), tensor)


def _activations(op: Operator, number: int, directions: int) -> list[_Activation]:
    """Return the activations of a direction; lists of parameters belong to those that have some."""
    defaults = _DEFAULTS[op.kind]
    kinds = op.get("activations") or defaults * directions
    alphas, betas = (list(np.ravel(op.get(name, []))) for name in ("activation_alpha", "activation_beta"))
    result = []
    for kind in kinds:
        has_alpha = kind in ("Affine", "ScaledTanh", *_SLOPES)
        has_beta = kind in ("Affine", "ScaledTanh", "HardSigmoid")
        # the lists run through the activations of all directions
        alpha = float(alphas.pop(0)) if has_alpha and alphas else _SLOPES.get(kind)
        beta = float(betas.pop(0)) if has_beta and betas else None
        result.append(_Activation(kind, alpha, beta, op.get("clip", 0.0)))
    return result[number * len(defaults) : (number + 1) * len(defaults)]


def _rnn_step(c: Context, cell: _RecurrentCell, x: Tensor, state: Sequence[Tensor]) -> list[Tensor]:
    return [cell.gates(c, x, state[0], [0], cell.activations[0])[0], state[1]]


def _gru_step(c: Context, cell: _RecurrentCell, x: Tensor, state: Sequence[Tensor]) -> list[Tensor]:
    h, (gate, candidate) = state[0], cell.activations
    # h' = (1 - update) * proposal + update * h
    update, reset = cell.gates(c, x, h, [0, 1], gate)
    # proposal = g(W x + b_w + reset * (R h + b_r)), else g(W x + R (reset * h) + b_w + b_r)
    if cell.late_reset:
        places = np.arange(2 * cell.hidden, 3 * cell.hidden)
        biases = _take(cell.biases, places, 1)
        weights, recurrence = (rearrange(np.transpose, _take(t, places, 0)) for t in (cell.weights, cell.recurrence))
        own = affine(c, x, weights, _take(biases, 0, 0))
        remembered = affine(c, h, recurrence, _take(biases, 1, 0))
        proposal = candidate(c, c.apply("add", own, c.apply("mul", reset, remembered)))
    else:
        (proposal,) = cell.gates(c, x, c.apply("mul", reset, h), [2], candidate)
    new = c.apply("mul", c.apply("sub", 1.0, update), proposal)
    return [c.apply("add", new, c.apply("mul", update, h)), state[1]]


def _lstm_step(c: Context, cell: _RecurrentCell, x: Tensor, state: Sequence[Tensor]) -> list[Tensor]:
    # memory' = keep * memory + admit * proposal; h' = emit * output(memory')
    h, memory = state
    gate, candidate, output = cell.activations
    (proposal,) = cell.gates(c, x, h, [3], candidate)
    if cell.peepholes is None:
        admit, emit, keep = cell.gates(c, x, h, [0, 1, 2], gate)
        memory = c.apply("add", c.apply("mul", keep, memory), c.apply("mul", admit, proposal))
    else:
        # the output gate sees the new memory, the other two the old one, so that they are activated apart
        sums = cell.sums(c, x, h, [0, 1, 2])
        admitted, emitted, kept = (_take(sums, slice(cell.hidden * i, cell.hidden * (i + 1)), 1) for i in range(3))
        admit, keep = (
            gate(c, c.apply("add", each, cell.peephole(c, number, memory)))
            for each, number in ((admitted, 0), (kept, 2))
        )
        memory = c.apply("add", c.apply("mul", keep, memory), c.apply("mul", admit, proposal))
        emit = gate(c, c.apply("add", emitted, cell.peephole(c, 1, memory)))
    return [c.apply("mul", emit, output.unlimited(c, memory)), memory]


_STEPS = {"RNN": _rnn_step, "GRU": _gru_step, "LSTM": _lstm_step}
