"""Limits how many trajectories run at once, as a function that keeps memory can hold only some of them."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from threading import Condition

from kennfeld.base.threads import computed_once
from kennfeld.graph.external_function import ExternalFunction, is_sequential, trajectories_at_once
from kennfeld.graph.node import Node


class TrajectoryGate:
    """Lets trajectories of a graph run when the functions that its nodes call have room for them."""

    def __init__(self, nodes: Iterable[Node]) -> None:
        calls = {(node.payload.function, node.args) for node in nodes if is_sequential(node)}
        counts = Counter(function for function, _ in calls)
        self._counts = sorted(counts.items(), key=lambda item: item[0].symbol)  # one order, so that no two wait in turn

    @contextmanager
    def room(self) -> Iterator[None]:
        """Wait until a trajectory can run, and keep the room of its functions meanwhile."""
        with ExitStack() as stack:
            for function, count in self._counts:
                stack.enter_context(_room_of(function).taken(count))
            yield


class _Room:
    """The number of trajectories that can still begin."""

    def __init__(self, size: int) -> None:
        self._size, self._free, self._changed = size, size, Condition()

    @contextmanager
    def taken(self, count: int) -> Iterator[None]:
        # more calls than there is room for would wait for ever
        count = min(count, self._size)
        with self._changed:
            self._changed.wait_for(lambda: self._free >= count)
            self._free -= count
        try:
            yield
        finally:
            with self._changed:
                self._free += count
                self._changed.notify_all()


@computed_once
def _room_of(function: ExternalFunction) -> _Room:
    return _Room(trajectories_at_once(function))
