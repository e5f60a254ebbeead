"""The variables of a chart while one step of it is followed."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.stateflow.guards import Guard, Logic
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["ResizedError", "Variables"]


class ResizedError(Exception):
    """A variable turned out to have another size than was thought."""

    def __init__(self, key: str, shape: tuple[int, ...]) -> None:
        super().__init__(key)
        self.key, self.shape = key, shape


class Variables:
    """What each variable holds so far, by its key: nodes in the shape of the variable, Int[rows, columns].

    `sized` are the keys whose sizes the chart states.
    """

    def __init__(self, logic: Logic, values: Mapping[str, Nodes], sized: frozenset[str] = frozenset()) -> None:
        self.logic = logic
        self.values = dict(values)
        self.sized = sized

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def get(self, key: str, guard: Guard) -> Nodes:
        """What a variable holds where a guard holds."""
        return self.logic.simplified(self.values[key], guard)

    def one(self, key: str, guard: Guard) -> int:
        """The node of a variable that is a scalar."""
        return self.logic.simple(int(self.values[key].ravel()[0]), guard)

    def set(self, key: str, new: Nodes, guard: Guard) -> None:
        """Give a variable a value where a guard holds; a scalar fills an array, a new one is no number elsewhere."""
        old = self.values.get(key)
        if old is None:
            old = np.full(new.shape, self.logic.loom.const(math.nan), dtype=np.int64)
        if new.shape != old.shape:
            new = self._fitted(key, new, old.shape)
        self.values[key] = self.logic.chosen(guard, new, old)

    def _fitted(self, key: str, new: Nodes, shape: tuple[int, ...]) -> Nodes:
        if new.size == 1:
            return np.full(shape, new.ravel()[0], dtype=np.int64)
        if new.size == np.prod(shape) and 1 in new.shape and 1 in shape:
            return new.reshape(shape)
        if key in self.sized:
            sizes = " and ".join("x".join(map(str, one)) for one in (shape, new.shape))
            raise UnsupportedError(f"its variable {key} has the sizes {sizes}")
        raise ResizedError(key, new.shape)

    def put(self, key: str, node: int, guard: Guard) -> None:
        """Give a scalar a value where a guard holds."""
        self.set(key, np.array([[node]], dtype=np.int64), guard)

    def joined(
        self, before: Mapping[str, Nodes], ways: Sequence[tuple[Guard, Mapping[str, Nodes]]]
    ) -> dict[str, Nodes]:
        """The values after ways that exclude each other, each with the guard where it is taken."""
        made = dict(before)
        for guard, after in ways:
            for key, nodes in after.items():
                old = before.get(key)
                if old is None:
                    made[key] = nodes
                elif nodes is not old:
                    made[key] = self.logic.chosen(guard, self.logic.simplified(nodes, guard), made[key])
        return made
