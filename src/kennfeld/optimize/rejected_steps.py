"""Trial values at which the model gives no finite numbers: how many were rejected, and why.

A search rejects them and goes on from shorter steps. That is no failure, but it says something about the model: a time
constant that was let below 0, a loop that is not stable. The first of them are kept and simulated again afterwards.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.optimize.compiled import RejectedTrials
from kennfeld.optimize.problem import Problem, difference, time_constants
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.parameter_set import ParameterSet

__all__ = ["RejectionReasons", "told"]

ANYWAY = "errors were too large for numbers"


def told(problem: Problem, rejected: RejectedTrials, parameters: Callable[[Float], ParameterSet]) -> str:
    """A sentence on the trial values that were rejected, or nothing where none were."""
    if not rejected.count:
        return ""
    reasons = RejectionReasons(problem)
    found = Counter(reasons.of(parameters(values)) for values in rejected.first)
    head = f"{rejected.count} trial step{'s were' if rejected.count > 1 else ' was'} rejected:"
    if len(found) == 1:
        return f"{head} {next(iter(found))}."
    of_those = f"of the first {len(rejected.first)}, " if rejected.count > len(rejected.first) else ""
    return f"{head} {of_those}{'; '.join(f'in {times} {reason}' for reason, times in found.most_common())}."


class RejectionReasons:
    """Tells why the training data of a problem cannot be simulated with some values."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        graph, self.lags = _with_time_constants(problem.graph)
        self.names = [name for name in graph.names if name.isprintable() or name in self.lags]
        self.order = np.array([graph.names[name] for name in self.names])
        self.nodes = NodeSimulator(graph, problem.parameters, self.names)
        reached = _behind(graph, [graph.names[difference(i)] for i in range(len(problem.criteria))])
        self.matters = np.array([graph.names[name] in reached for name in self.names])

    def of(self, parameters: ParameterSet) -> str:
        """The first thing that goes wrong, as a clause; what no criterion depends on comes last."""
        found = self._first(parameters, self.matters)
        return found or self._first(parameters, ~self.matters) or ANYWAY

    def _first(self, parameters: ParameterSet, looked_at: Bool) -> str:
        for bound in self.problem.training:
            for at, values in self.nodes.blocks(bound, parameters):
                found = next(self._wrong(values, looked_at), None)
                if found is not None:
                    name, column = found
                    return f"{name} at sample {bound.kept[at.start + column] + 1} of {bound.dataset.name}"
        return ""

    def _wrong(self, values: Float, looked_at: Bool) -> Iterator[tuple[str, int]]:
        """What is wrong in a block of samples, and in which column: a negative time constant before all else."""
        for row, name in enumerate(self.names):
            if looked_at[row] and name in self.lags and (below := values[row] < 0).any():
                yield f"{self.lags[name]} was below 0", int(np.argmax(below))
        broken = ~np.isfinite(values) & looked_at[:, None]
        if broken.any():
            column = int(np.argmax(broken.any(axis=0)))
            rows = np.flatnonzero(broken[:, column])
            row = rows[np.argmin(self.order[rows])]
            yield f"{self.lags.get(self.names[row], self.names[row])} was no finite number", column


def _behind(graph: Graph, ends: Sequence[int]) -> set[int]:
    """The nodes that some nodes depend on, in earlier steps too."""
    todo, seen = list(ends), set(ends)
    while todo:
        op, args, payload = graph.nodes[todo.pop()]
        state = graph.states[payload] if op == "state" else None
        more = {*args, *((state.init, state.next) if state is not None else ())} - seen
        seen |= more
        todo += more
    return seen


def _with_time_constants(graph: Graph) -> tuple[Graph, dict[str, str]]:
    """The graph with the time constants of its lags among the names, and how to call each of them in a message."""
    names, said = dict(graph.names), {}
    visible = {at: name for name, at in reversed(list(graph.names.items()))}
    for number, at in enumerate(time_constants(graph)):
        key = f"\0T{number}"
        names[key] = at
        said[key] = f"{_called(graph, at, visible)} of a PT1"
    return GraphBuilder.of(graph).finish(names, graph.units, graph.outputs), said


def _called(graph: Graph, at: int, visible: dict[int, str]) -> str:
    """`the time constant Lag`, by the name of the node or of the parameters it is made of."""
    if at in visible:
        return f"the time constant {visible[at]}"
    parameters = _parameters(graph, [at])
    return f"the time constant {parameters[0]}" if len(parameters) == 1 else "the time constant"


def _parameters(graph: Graph, stack: Sequence[int]) -> list[str]:
    """The parameters that nodes look up within the step."""
    todo, seen, found = list(stack), set(stack), []
    while todo:
        op, args, payload = graph.nodes[todo.pop()]
        found += [payload] if op == "lookup" else []
        todo += [a for a in args if a not in seen]
        seen |= set(args)
    return found
