"""Parts of a problem that can be fitted on their own: values that do not affect all criteria.

Tolerances are relative to the whole cost. Beside a pressure in Pa, a ratio is too small for them to see, although its
values may still be far from their optimum. If some values affect these criteria only, they minimise their own cost,
whatever the other values are.
"""

from collections.abc import Iterator

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import Graph
from kennfeld.graph.traversal import ancestors
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.samples import Samples
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.table_penalties import penalty_of
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem


@dataclass(frozen=True)
class SeparatePart:
    """Some criteria, and the values that affect no others."""

    criteria: frozenset[int]  # their numbers
    names: frozenset[str]  # of the parameters
    values: Bool  # Bool[values]: those of them, and of the breakpoints of their axes

    def compiled(self, whole: CompiledProblem) -> CompiledProblem:
        """Restrict a problem to the criteria of this part and the smoothness of its parameters."""
        problem = whole.problem
        part = whole.over_selection(_select_criteria, self.criteria)
        factors = {name: problem.factors(name) for name in problem.free_names if name in self.names}
        restraints = {name: each for name, each in problem.restraints.items() if name in self.names}
        # roughness of the other tables is constant here, but would raise the cost that tolerances are relative to
        part.roughness = penalty_of(problem.parameters, whole.values, factors, restraints)
        return part

    def limits(self, limits: LinearLimits, values: Float) -> LinearLimits:
        """Fix all values but those of this part at `values`, Float[values]."""
        lower, upper = (np.where(self.values, side, values) for side in (limits.lower, limits.upper))
        return LinearLimits(lower, upper, limits.rows, limits.tables)


def separate_parts(problem: Problem, layout: ValueLayout, limits: LinearLimits) -> Iterator[SeparatePart]:
    """Yield the parts with some of the criteria, those of the fewest first; none if all values affect all criteria."""
    scored = [number for number, criterion in enumerate(problem.criteria) if criterion.weight > 0]
    if len(scored) < 2:
        return
    graph = problem.graph
    reaching = {number: _parameters_of(graph, problem.differences[number]) for number in scored}
    affected = {name: frozenset(n for n in scored if name in reaching[n]) for name in problem.free_names}
    every = frozenset().union(*affected.values())
    # smaller parts first: a larger one contains their values, and begins where their search ended
    for criteria in sorted({*affected.values()} - {frozenset(), every}, key=lambda each: (len(each), sorted(each))):
        # values that affect a subset of these criteria affect no others either
        names = frozenset(name for name, own in affected.items() if own and own <= criteria)
        values = np.zeros(layout.free, dtype=bool)
        for name in names:
            values[layout.offsets[name] :][: problem.parameters[name].size] = True
        for key, axis in problem.free_axes.items():
            # moving a breakpoint changes all tables on its axis, so that all of them must belong to the part
            if layout.moving.get(key, layout.free) < layout.free and names.issuperset(name for name, _ in axis.places):
                values[layout.moving[key] :][: len(axis.axis)] = True
        values &= limits.movable
        if values.any():
            yield SeparatePart(criteria, names, values)


def _parameters_of(graph: Graph, name: str) -> set[str | None]:
    """Return the names of the parameters on which a node depends, through states as well."""
    reached: set[int] = set()
    roots = {graph.names[name]}
    while not roots <= reached:
        reached |= {*ancestors(graph.nodes, roots | reached)}
        # the first and the next value of a state may depend on further states: repeated until a round adds none
        states = [graph.states[graph.nodes[at].payload] for at in reached if graph.nodes[at].op == "state"]
        roots = {at for state in states for at in (state.init, state.next)}
    return {graph.nodes[at].parameter for at in reached}


def _select_criteria(compiled: CompiledProblem, criteria: frozenset[int]) -> Samples:
    """Return the samples with a weight of 0 for all other criteria."""
    factors = np.zeros(len(compiled.problem.criteria))
    factors[sorted(criteria)] = 1.0
    return compiled.samples.reweighted(factors)
