"""How much one import may ask for: the operations of its graph, and the work to find them."""

from typing import Any

from kennfeld.graph.builder import GraphBuilder

__all__ = ["BoundedGraphBuilder", "GraphTooLargeError"]

_MOST_NODES = 500_000  # different operations in a step
_MOST_ASKED = 5_000_000  # operations that are asked for, equal ones and constants counted


class GraphTooLargeError(Exception):
    """The blocks ask for more operations than any model has that is calibrated; `place` is the block."""

    def __init__(self, place: str, message: str) -> None:
        super().__init__(message)
        self.place, self.message = place, message
        self.remedy = "Import a subsystem, or make the arrays in it smaller."


class BoundedGraphBuilder(GraphBuilder):
    """A graph builder with an end: `most` operations may be asked for; `place` is the block that is being built.

    Raises `TooLargeError`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.asked = 0
        self.most = _MOST_ASKED
        self.place = ""

    def node(self, op: str, args: tuple[int, ...] = (), payload: Any = None) -> int:
        """The number of this node, made where it does not exist yet."""
        self.asked += 1
        if self.asked > self.most or len(self.nodes) > _MOST_NODES:
            raise GraphTooLargeError(
                self.place, f"the blocks up to here ask for more than {_MOST_NODES} operations a step"
            )
        return super().node(op, args, payload)
