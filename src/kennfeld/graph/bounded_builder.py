"""Graph builder with a limit on the size of the graph, for imports from untrusted or very large sources."""

from typing import Any

from kennfeld.graph.builder import GraphBuilder

_MAX_NODES = 500_000  # different operations in a step
_MAX_REQUESTS = 5_000_000  # requested operations, including duplicates and constants


class GraphTooLargeError(Exception):
    """The import requires more operations than allowed; `place` is the block that exceeded the limit."""

    def __init__(self, place: str, message: str) -> None:
        super().__init__(message)
        self.place, self.message = place, message
        self.remedy = "Import a subsystem, or make the arrays in it smaller."


class BoundedGraphBuilder(GraphBuilder):
    """Graph builder that accepts at most `most` requests for nodes; `place` names the block under construction.

    Raises:
        GraphTooLargeError: the limit is exceeded.
    """

    def __init__(self) -> None:
        super().__init__()
        self.asked = 0
        self.most = _MAX_REQUESTS
        self.place = ""

    def node(self, op: str, args: tuple[int, ...] = (), payload: Any = None) -> int:
        self.asked += 1
        if self.asked > self.most or len(self.nodes) > _MAX_NODES:
            raise GraphTooLargeError(
                self.place, f"the blocks up to here require more than {_MAX_NODES} operations per step"
            )
        return super().node(op, args, payload)
