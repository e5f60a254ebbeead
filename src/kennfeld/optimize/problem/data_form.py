"""`DataForm`: the properties of data on which compiled code depends."""

from collections.abc import Sequence

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.graph.external_function import is_sequential
from kennfeld.graph.node import STEPS
from kennfeld.graph.traversal import rewrite
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.sample_weights import SampleWeights


@dataclass(frozen=True)
class DataForm:
    """The properties of the training data on which the compiled code of a problem depends.

    Attributes:
        weighting: criteria with sample weights.
        restarts: True if steady-state points are held until the model has settled, and follow each other in longer
            pieces within which its states restart. Functions that keep memory have a piece for each point instead.
        step: time step in s, if it is the same everywhere.
        partitioned: True if the data are evaluated in partitions.
    """

    weighting: SampleWeights
    restarts: bool
    step: float | None
    partitioned: bool

    @classmethod
    def of(cls, problem: Problem) -> "DataForm":
        """Return the form of the data of a problem."""
        training, partitions = problem.training, problem.partitions
        weighting = SampleWeights.of(problem.criteria, training)
        restarts = any(bound.hold is not None for bound in training) and not any(
            map(is_sequential, problem.graph.nodes)
        )
        step = even_step(training) if partitions is None else partitions.step
        return cls(weighting, restarts, step, partitions is not None)


def even_step(bounds: Sequence[BoundDataset]) -> float | None:
    """Return the time step if it is the same everywhere, else None."""
    clocks = [bound.clock[name] for bound in bounds for name in STEPS if name in bound.clock]
    # equal if smallest and largest are
    steps = {float(step) for dt in clocks if dt.size for step in (dt.min(), dt.max())}
    return steps.pop() if len(steps) == 1 else None


def with_step(graph: Graph, step: float | None) -> Graph:
    """Replace the steps before and after a sample by a constant if it is known."""
    if step is None:
        return graph

    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        node = graph.nodes[at]
        return b.const(step) if node.op == "input" and node.payload in STEPS else b.rebuild(node, args)

    return rewrite(graph, resolve)
