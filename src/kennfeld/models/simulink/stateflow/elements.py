"""Elements of a chart's arrays, read and written; a place that changes is a choice between all elements.

Beyond the array, where a chart would stop, there is not a number to read, and nothing is written.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.expressions.arrays import each, fold
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.stateflow.actions import changed
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.values import Values

__all__ = ["Elements"]

_MOST_ELEMENTS = 1_000  # of an array whose element is chosen while the model runs


class Elements:
    """The elements of the variables of a machine."""

    def __init__(self, values: "Values") -> None:
        self.values = values
        self.loom = values.loom
        self.variables = values.variables

    def get(self, key: str, indices: tuple[m.Expression, ...], context: Context, guard: Guard) -> Nodes:
        """Elements of a variable."""
        array = self.variables.get(key, guard)
        places = self._places(array.shape, indices, context, guard)
        try:
            fixed = self._fixed(places)
            if fixed is not None:
                return _taken(array, fixed)
            elements = self._elements(array, places, context)
        except IndexError:
            raise UnsupportedError(f"{context.place}: it takes elements of {key} that are not there") from None
        found = self.loom.const(math.nan)
        for where, element in elements:
            found = self.loom.call("select", where, element, found)
        return np.array([[found]], dtype=np.int64)

    def set(self, key: str, indices: tuple[m.Expression, ...], new: Nodes, context: Context, guard: Guard) -> None:
        """Give elements of an array a value."""
        array = self.variables.get(key, guard)
        places = self._places(array.shape, indices, context, guard)
        made = array.copy()
        try:
            fixed = self._fixed(places)
            if fixed is not None:
                _put(made, fixed, new)
                return self.variables.set(key, made, guard)
            elements = self._elements(array, places, context)
        except (IndexError, ValueError):
            raise UnsupportedError(f"{context.place}: it assigns to elements of {key} that are not there") from None
        if new.size != 1:
            raise UnsupportedError(f"{context.place}: it assigns to several elements of {key} that change")
        chosen = [self.loom.call("select", where, int(new.item()), element) for where, element in elements]
        return self.variables.set(key, np.array(chosen, dtype=np.int64).reshape(array.shape), guard)

    def _places(
        self, shape: tuple[int, ...], indices: tuple[m.Expression, ...], context: Context, guard: Guard
    ) -> list[Nodes | None]:
        """The nodes of each index, None of a colon."""
        found: list[Nodes | None] = []
        if len(indices) not in (1, 2):
            raise UnsupportedError(f"{context.place}: it indexes with {len(indices)} numbers")
        for axis, index in enumerate(indices):
            size = math.prod(shape) if len(indices) == 1 else shape[axis]
            if isinstance(index, m.Colon):
                found.append(None)
            else:
                found.append(self._place(self._ended(index, size, context), context, guard))
        return found

    def _ended(self, index: m.Expression, size: int, context: Context) -> m.Expression:
        """An index in which `end` is a number, but not within an index of another array."""
        if isinstance(index, m.End):
            return m.Number(float(size))
        if isinstance(index, m.Call) and self.values.key_of(index.of, context) is not None:
            return index
        return changed(index, lambda part: self._ended(part, size, context))

    def _place(self, index: m.Expression, context: Context, guard: Guard) -> Nodes:
        """The nodes of an index, made whole as its language does."""
        whole = "floor" if self.values.diagram.language.name == "C" else "round"
        return each(self.loom, whole, self.values.nodes(index, context, guard))

    def _fixed(self, places: Sequence[Nodes | None]) -> list[list[int] | None] | None:
        """The indices as numbers counted from 0; None where one changes. Raises `IndexError` where one is no number."""
        found: list[list[int] | None] = []
        for place in places:
            if place is None:
                found.append(None)
                continue
            numbers = [self.loom.value(int(node)) for node in place.ravel()]
            if None in numbers:
                return None
            if not np.all(np.isfinite(np.array(numbers, dtype=np.float64))):
                raise IndexError
            found.append([int(number or 0) - 1 for number in numbers])
        return found

    def _elements(self, array: Nodes, places: Sequence[Nodes | None], context: Context) -> "list[tuple[int, int]]":
        """Each element, rows first, with the node that is 1 where the indices mean it; raises `IndexError`."""
        if array.size > _MOST_ELEMENTS or any(place is None or place.size != 1 for place in places):
            raise UnsupportedError(f"{context.place}: it indexes an array in a way that is not supported")
        for place, size in zip(places, array.shape if len(places) == 2 else (array.size,), strict=True):
            number = self.loom.value(int(place.item())) if place is not None else None
            if number is not None and not 1 <= number <= size:
                raise IndexError
        made = []
        for at in np.ndindex(*array.shape):
            wanted = at if len(places) == 2 else (at[0] + at[1] * array.shape[0],)
            equal = [
                self.loom.call("eq", int(place.item()), self.loom.const(float(index + 1)))
                for place, index in zip(places, wanted, strict=True)
                if place is not None
            ]
            made.append((fold(self.loom, "and", equal), int(array[at])))
        return made


def _flat(indices: list[int], shape: tuple[int, ...]) -> tuple[Any, ...]:
    if min(indices, default=0) < 0:
        raise IndexError
    return np.unravel_index(np.array(indices, dtype=np.int64), shape, order="F")


def _taken(array: Nodes, indices: list[list[int] | None]) -> Nodes:
    if len(indices) == 1:
        chosen = indices[0]
        if chosen is None:
            return array.reshape(-1, 1, order="F")
        try:
            found = array[_flat(chosen, array.shape)]
        except ValueError:
            raise IndexError from None
        found = np.asarray(found, dtype=np.int64)
        return found.reshape(-1, 1) if array.shape[1] == 1 and array.shape[0] != 1 else found.reshape(1, -1)
    return np.asarray(array[_grid(indices, array.shape)])


def _put(array: Nodes, indices: list[list[int] | None], new: Nodes) -> None:
    if len(indices) == 1:
        chosen = indices[0] if indices[0] is not None else list(range(array.size))
        array[_flat(chosen, array.shape)] = new.item() if new.size == 1 else new.ravel(order="F")
    else:
        array[_grid(indices, array.shape)] = new.item() if new.size == 1 else new


def _grid(indices: list[list[int] | None], shape: tuple[int, ...]) -> Any:
    chosen = [list(range(size)) if one is None else one for one, size in zip(indices, shape, strict=True)]
    if any(place < 0 for one in chosen for place in one):
        raise IndexError
    return np.ix_(*chosen)
