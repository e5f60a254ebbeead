"""Criteria of a calibration: nodes, their targets, losses and weights."""

from collections.abc import Sequence
from typing import Literal, get_args

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import number

RobustLoss = Literal["huber", "soft_l1"]
Loss = Literal["square", RobustLoss, "excess"]
ROBUST_LOSSES: tuple[RobustLoss, ...] = get_args(RobustLoss)  # those that large errors enter less, with a `delta`


@dataclass(frozen=True)
class Target:
    """Target of a node: a channel, another node, or a number.

    Attributes:
        kind: `channel`, `node` or `number`; a bare name, kind `name`, is a channel if the data have one of that name,
            else a node.
        name: of the channel or node.
        value: the number.

    >>> Target.of("Torque"), Target.of(0.0).kind
    (Target(kind='name', name='Torque', value=0.0), 'number')
    """

    kind: Literal["name", "channel", "node", "number"]
    name: str = ""
    value: float = 0.0

    @classmethod
    def of(cls, target: "Target | str | float") -> "Target":
        """Return the target of a name or a number."""
        if isinstance(target, Target):
            return target
        if isinstance(target, str):
            return cls("name", target)
        return cls("number", value=number(target, "target", "a criterion"))

    def __str__(self) -> str:
        return f"{self.value:g}" if self.kind == "number" else self.name


@dataclass(frozen=True)
class Region:
    """Samples with their own weight.

    Attributes:
        where: a condition in formula text over channels; the samples at which it is true.
        weight: multiplies their loss.

    Raises:
        ArgumentError: the condition is empty, or the weight is negative.

    >>> Region("Speed > 3000", 2.0)
    Region(where='Speed > 3000', weight=2.0)
    """

    where: str
    weight: float

    def __post_init__(self) -> None:
        if not self.where.strip():
            raise ArgumentError("where of a region is empty; it must be a condition such as 'Speed > 3000'")
        weight = number(self.weight, "weight", f"the region {self.where}", least=0)
        object.__setattr__(self, "weight", weight)


@dataclass(frozen=True)
class Criterion:
    """A node that the calibration fits to its target.

    Its part of the cost is `weight` times the sum of losses of (node - target) / scale.

    Attributes:
        node: the node.
        target: a channel, a node or a number: a name, a number or a `Target`.
        weight: multiplies the losses of all samples.
        loss: `square`; a robust loss, `huber` or `soft_l1`, with its `delta`; or `excess`, the square above the target
            only.
        delta: error in units of the scale at which a robust loss leaves the square.
        scale: what errors are divided by, in the unit of the node.
        weight_channel: channel that multiplies the loss of each sample; empty for none.
        regions: samples with a weight of their own; the weights of all regions that contain a sample are multiplied.

    Raises:
        ArgumentError: a value cannot be used.

    >>> Criterion("TorquePredict", "Torque").target
    Target(kind='name', name='Torque', value=0.0)
    """

    node: str
    target: Target
    weight: float = 1.0
    loss: Loss = "square"
    delta: float = 1.0
    scale: float = 1.0
    weight_channel: str = ""
    regions: tuple[Region, ...] = ()

    @property
    def internal(self) -> bool:
        """True if it stands for something else, such as a limit; no formula text can have the name of its node."""
        return self.node.startswith("\0")

    def __init__(
        self,
        node: str,
        target: Target | str | float,
        weight: float = 1.0,
        loss: Loss = "square",
        *,
        delta: float = 1.0,
        scale: float = 1.0,
        weight_channel: str = "",
        regions: Sequence[Region] = (),
    ) -> None:
        if loss not in get_args(Loss):
            *most, last = get_args(Loss)
            raise ArgumentError(f"loss={loss!r} of the criterion on {node} must be {', '.join(most)} or {last}")
        owner = f"the criterion on {node}"
        values = {
            "node": node,
            "target": Target.of(target),
            "weight": number(weight, "weight", owner, least=0),
            "loss": loss,
            "delta": number(delta, "delta", owner, above=0),
            "scale": number(scale, "scale", owner, above=0),
            "weight_channel": weight_channel,
            "regions": tuple(regions),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
