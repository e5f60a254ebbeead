"""Dense layers of neural networks: y = a(W x + b), whose weights are the values of one parameter.

A layer is evaluated as a whole. Its nodes are its outputs, `dense`; code computes all of them in one call. The weights
of a layer are a value block with a row per input and, last, the row of the biases; a column per output.
"""

from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float

ACTIVATIONS = ("identity", "relu", "leaky_relu", "elu", "tanh", "sigmoid")


class DenseLayer(NamedTuple):
    """A dense layer.

    Attributes:
        name: parameter with the weights, Float[inputs + 1, outputs]; the biases are the last row.
        inputs: number of inputs.
        outputs: number of outputs.
        activation: one of `ACTIVATIONS`.
        alpha: slope of "leaky_relu" below 0, or minus the lower limit of "elu".
    """

    name: str
    inputs: int
    outputs: int
    activation: str = "identity"
    alpha: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the parameter."""
        return self.inputs + 1, self.outputs


class DenseOutput(NamedTuple):
    """An output of a layer: the payload of its nodes."""

    layer: DenseLayer
    number: int

    @property
    def name(self) -> str:
        """The parameter with the weights."""
        return self.layer.name


def evaluate_layer(layer: DenseLayer, values: Float, x: Float) -> tuple[Float, Float]:
    """Compute outputs and slopes of the activation: Float[points, inputs] -> two arrays Float[points, outputs]."""
    z = np.zeros((len(x), layer.outputs))
    for j in range(layer.inputs):
        z += x[:, j, None] * values[j]
    return _activate(layer, z + values[-1])


def _activate(layer: DenseLayer, z: Float) -> tuple[Float, Float]:
    with np.errstate(over="ignore", invalid="ignore"):
        match layer.activation:
            case "identity":
                return z, np.ones_like(z)
            case "relu":
                return np.where(z < 0, 0.0, z), np.where(z < 0, 0.0, 1.0)
            case "leaky_relu":
                return np.where(z < 0, layer.alpha * z, z), np.where(z < 0, layer.alpha, 1.0)
            case "elu":
                # e^z is also computed where it is not taken, and must not overflow
                below = np.minimum(z, 0.0)
                y = np.where(z < 0, layer.alpha * np.expm1(below), z)
                return y, np.where(z < 0, layer.alpha * np.exp(below), 1.0)
            case "tanh":
                y = np.tanh(z)
                return y, 1.0 - y * y
            case _:
                # 1 / (1 + e^-z) by e^-|z|, which cannot overflow; its slope y (1 - y) without cancellation
                e = np.exp(-np.abs(z))
                return np.where(z < 0, e, 1.0) / (1.0 + e), e / (1.0 + e) ** 2
