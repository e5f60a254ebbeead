"""Losses of scaled residuals: machine code and influence of each in one place.

`kennfeld.domain.criteria` has their names. The influence of a residual r is psi, half the slope of the loss; see Huber,
Robust Statistics (1981), sections 7.6 and 7.7, for the part that it has in the covariance of fitted values.
"""

from collections.abc import Callable, Mapping

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.ir import ONE, ZERO, FunctionWriter, literal
from kennfeld.domain.criteria import Loss

Code = tuple[str, str]  # of a loss, and of its slope over 2 r, which is the weight of the equivalent square
Influence = tuple[Float, Float]  # psi / r and psi', Float[samples] each


@dataclass(frozen=True)
class LossRule:
    """A loss: at least 0, falling nowhere as |r| grows, and not finite for a residual that is not.

    The weight of its equivalent square is at least 0. Values that make an output overflow are thus rejected.

    Attributes:
        code: writes the code of a residual, given as the name of its value, with the `delta` of the criterion.
        influence: computes that of residuals, Float[samples], with the `delta` of the criterion.
        value: computes the loss of residuals, Float[samples].
    """

    code: Callable[[FunctionWriter, str, float], Code]
    influence: Callable[[Float, float], Influence]
    value: Callable[[Float, float], Float]


def _square_code(f: FunctionWriter, r: str, delta: float) -> Code:
    return f.fmul(r, r), ONE


def _square_influence(r: Float, delta: float) -> Influence:
    return np.ones(r.size), np.ones(r.size)


def _square_value(r: Float, delta: float) -> Float:
    return r**2


def _huber_code(f: FunctionWriter, r: str, delta: float) -> Code:
    # r^2 up to delta, beyond it the tangent delta (2 |r| - delta), whose slope over 2 r is delta / |r|
    square, edge = f.fmul(r, r), literal(delta)
    size = f.new(f"call double @llvm.fabs.f64(double {r})")
    beyond = f.new(f"fcmp ogt double {size}, {edge}")
    line = f.fmul(edge, f.new(f"fsub double {f.fmul(literal(2.0), size)}, {edge}"))
    return f.select(beyond, line, square), f.select(beyond, f.new(f"fdiv double {edge}, {size}"), ONE)


def _huber_influence(r: Float, delta: float) -> Influence:
    inside = np.abs(r) <= delta
    # both sides of `where` are computed: the maximum keeps r = 0 out of the quotient
    return np.where(inside, 1.0, delta / np.maximum(np.abs(r), delta)), inside.astype(np.float64)


def _huber_value(r: Float, delta: float) -> Float:
    size = np.abs(r)
    return np.where(size > delta, delta * (2 * size - delta), r**2)


def _soft_l1_code(f: FunctionWriter, r: str, delta: float) -> Code:
    square = f.fmul(r, r)
    ratio = f.new(f"fdiv double {r}, {literal(delta)}")
    share = f.fmul(ratio, ratio)
    root = f.new(f"call double @llvm.sqrt.f64(double {f.new(f'fadd double {ONE}, {share}')})")
    # 2 r^2 / (root + 1) is 2 delta^2 (root - 1) without the cancellation
    loss = f.new(f"fdiv double {f.fmul(literal(2.0), square)}, {f.fadd(root, ONE)}")
    return loss, f.new(f"fdiv double {ONE}, {root}")


def _soft_l1_influence(r: Float, delta: float) -> Influence:
    # psi = r / root, and psi' = 1 / root - r^2 / delta^2 / root^3 = 1 / root^3
    root = np.sqrt(1 + (r / delta) ** 2)
    return 1 / root, root**-3


def _soft_l1_value(r: Float, delta: float) -> Float:
    loss: Float = 2 * r**2 / (np.sqrt(1 + (r / delta) ** 2) + 1)
    return loss


def _excess_code(f: FunctionWriter, r: str, delta: float) -> Code:
    square = f.fmul(r, r)
    # one-sided, as an excess below the limit costs nothing
    beyond = f.new(f"fcmp ogt double {r}, {ZERO}")
    return f.select(beyond, square, ZERO), f.select(beyond, ONE, ZERO)


def _excess_influence(r: Float, delta: float) -> Influence:
    above = (r > 0).astype(np.float64)
    return above, above


def _excess_value(r: Float, delta: float) -> Float:
    square: Float = np.maximum(r, 0.0) ** 2
    return square


LOSS_RULES: Mapping[Loss, LossRule] = FrozenDict(
    {
        "square": LossRule(_square_code, _square_influence, _square_value),
        "huber": LossRule(_huber_code, _huber_influence, _huber_value),
        "soft_l1": LossRule(_soft_l1_code, _soft_l1_influence, _soft_l1_value),
        "excess": LossRule(_excess_code, _excess_influence, _excess_value),
    }
)
