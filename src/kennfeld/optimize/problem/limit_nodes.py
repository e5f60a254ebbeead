"""Graph nodes for the sides of output limits: each must not exceed a number."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Limit
from kennfeld.models import Model
from kennfeld.models.formula import extend


@dataclass(frozen=True)
class LimitSide:
    """One side of a limit: `node` must be <= `bound`."""

    limit: Limit
    number: int
    sign: int

    @property
    def node(self) -> str:
        """Name of the node, which no formula text can contain."""
        return f"\0limit {self.number} {'above' if self.sign > 0 else 'below'}"

    @property
    def where(self) -> str:
        """Name of the node of the condition."""
        return f"\0limit {self.number} where"

    @property
    def bound(self) -> float:
        """Upper bound of the node."""
        return self.limit.upper if self.sign > 0 else -self.limit.lower

    def __str__(self) -> str:
        return f"{self.limit.node} {'<=' if self.sign > 0 else '>='} {self.sign * self.bound:g}"


def limit_sides(limits: Sequence[Limit]) -> tuple[LimitSide, ...]:
    """Return the sides with a finite bound."""
    sides = [LimitSide(limit, number, sign) for number, limit in enumerate(limits, 1) for sign in (1, -1)]
    return tuple(side for side in sides if np.isfinite(side.bound))


def add_limit_nodes(model: Model, limits: Sequence[Limit]) -> Model:
    """Add a node for each side and each condition to a model.

    Raises:
        InputError: an expression cannot be used; lists all problems.
    """
    texts: dict[str, str] = {}
    for side in limit_sides(limits):
        # a lower bound is an upper one of the negative node
        texts[side.node] = side.limit.node if side.sign > 0 else f"-({side.limit.node})"
        if side.limit.where:
            texts[side.where] = side.limit.where
    return extend(model, texts, Location("limit"))


def keeps_pieces(model: Model, limits: Sequence[Limit]) -> bool:
    """Return True if the model or a limit has memory or reads the time, so that pieces cannot be cut."""
    try:
        return add_limit_nodes(model, limits).graph.is_timed
    except InputError:
        return model.graph.is_timed


def channels_of(model: Model, limits: Sequence[Limit]) -> list[str]:
    """Return the inputs that only the limits read; empty if the limits cannot be used."""
    try:
        inputs = add_limit_nodes(model, limits).graph.inputs
    except InputError:
        return []
    return [name for name in inputs if name not in model.graph.inputs]
