"""Trial values that were rejected because the model gives no finite numbers there, and the reasons.

A search continues with shorter steps, so this is not a failure, but it may point to a problem of the model: a time
constant without a lower bound, an unstable loop. The first rejected values are stored and simulated again afterwards.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.formatting import count_noun
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.traversal import ancestors, with_names
from kennfeld.optimize.problem.problem import Problem, time_constants
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.sums.rejected_trials import RejectedTrials

OVERFLOW = "the errors overflowed"


def describe_rejections(problem: Problem, rejected: RejectedTrials, parameters: Callable[[Float], ParameterSet]) -> str:
    """Return a sentence on the rejected trial values.

    Args:
        problem: the problem.
        rejected: trial values that were counted and stored, at least one.
        parameters: returns the parameter set of free values.
    """
    reasons = RejectionReasons(problem)
    counts = Counter(reasons.of(parameters(values)) for values in rejected.first)
    head = f"{count_noun(rejected.count, 'trial step')} {'were' if rejected.count > 1 else 'was'} rejected:"
    if len(counts) == 1:
        return f"{head} {next(iter(counts))}."
    of_first = f"of the first {len(rejected.first)}, " if rejected.count > len(rejected.first) else ""
    return f"{head} {of_first}{'; '.join(f'in {times} {reason}' for reason, times in counts.most_common())}."


class RejectionReasons:
    """Finds the reason why the training data of a problem cannot be simulated."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        graph, self.lags = _with_time_constants(problem.graph)
        self.names = [name for name in graph.names if name.isprintable() or name in self.lags]
        self.order = np.array([graph.names[name] for name in self.names])
        self.nodes = NodeSimulator(graph, problem.parameters, self.names)
        reached = _dependencies(graph, [graph.names[name] for name in problem.differences])
        self.matters = np.array([graph.names[name] in reached for name in self.names])

    def of(self, parameters: ParameterSet) -> str:
        """Return the first reason as a clause; nodes on which no criterion depends come last."""
        return self._first(parameters, self.matters) or self._first(parameters, ~self.matters) or OVERFLOW

    def _first(self, parameters: ParameterSet, included: Bool) -> str:
        for bound in self.problem.training:
            for at, values in self.nodes.blocks(bound, parameters):
                for clause, column in self._faults(values, included):
                    return f"{clause} at sample {bound.kept[at.start + column] + 1} of {bound.dataset.name}"
        return ""

    def _faults(self, values: Float, included: Bool) -> Iterator[tuple[str, int]]:
        """Yield the faults in a block of samples as clause and column: negative time constants first."""
        for row, name in enumerate(self.names):
            if included[row] and name in self.lags and (below := values[row] < 0).any():
                yield f"{self.lags[name]} was below 0", int(np.argmax(below))
        broken = ~np.isfinite(values) & included[:, None]
        if broken.any():
            column = int(np.argmax(broken.any(axis=0)))
            rows = np.flatnonzero(broken[:, column])
            # the first one in the order of computation, from which others have it
            row = rows[np.argmin(self.order[rows])]
            yield f"{self.lags.get(self.names[row], self.names[row])} was not finite", column


def _dependencies(graph: Graph, ends: Sequence[int]) -> set[int]:
    """Return the nodes on which some nodes depend, also through states."""
    todo, seen = list(ends), set(ends)
    while todo:
        op, args, payload = graph.nodes[todo.pop()]
        state = graph.states[payload] if op == "state" else None
        more = {*args, *((state.init, state.next) if state is not None else ())} - seen
        seen |= more
        todo += more
    return seen


def _with_time_constants(graph: Graph) -> tuple[Graph, dict[str, str]]:
    """Add the time constants of lags to the names of a graph; return their labels for messages by name.

    A label is `the time constant Lag of a PT1`, with the name of the node or of its only parameter.
    """
    visible = {at: name for name, at in reversed(list(graph.names.items()))}
    hidden, labels = {}, {}
    for number, at in enumerate(time_constants(graph)):
        hidden[at] = f"\0T{number}"
        # a time constant without a name has that of the only parameter in it
        lookups = [graph.nodes[i].payload for i in ancestors(graph.nodes, [at]) if graph.nodes[i].op == "lookup"]
        name = visible.get(at) or (lookups[0] if len(lookups) == 1 else "")
        labels[hidden[at]] = " ".join(filter(None, ("the time constant", name, "of a PT1")))
    return with_names(graph, hidden), labels
