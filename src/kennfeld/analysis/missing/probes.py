"""Probes: the problem with an offset and a factor at each node, whose slopes are those of the outputs by the nodes.

The offset k and the factor m of a node n, as in n (1 + m) + k, are free values of 0. The compiled derivative returns
the slopes of the outputs by all of them in the sweep that it does anyway, through states as well; that by m is n times
that by k.
"""

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

from kennfeld.analysis.missing.terms import Correction, with_corrections
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.builder import CONDITIONS
from kennfeld.graph.traversal import ancestors_in_time, dependents
from kennfeld.optimize.problem.problem import Problem

MAX_NODES = 60


@dataclass(frozen=True)
class Nodes:
    """The nodes at which terms may be missing.

    Attributes:
        names: one name each.
        constant: those that depend neither on inputs nor on states, such as time constants.
        left_out: number of further ones.
    """

    names: tuple[str, ...]
    constant: frozenset[str] = frozenset()
    left_out: int = 0

    @classmethod
    def of(cls, problem: Problem, patterns: Sequence[str] = ("*",)) -> "Nodes":
        """Return the named nodes that a scored output depends on.

        Inputs are measured, and conditions have no slope. Of several names of one node, the first counts.

        Raises:
            ArgumentError: a pattern matches no node.
        """
        graph = problem.model.graph
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in graph.names):
                raise ArgumentError(
                    f"nodes: the function has no node {pattern}. {nearest(pattern, graph.names)}".strip()
                )
        roots = {criterion.node for criterion in problem.criteria} | _target_nodes(problem)
        reached = ancestors_in_time(graph, [graph.names[name] for name in roots])
        names: dict[int, str] = {}
        for name, at in graph.names.items():
            plain = graph.nodes[at].op not in ("input", "const") and graph.nodes[at].op not in CONDITIONS
            if plain and at in reached and any(fnmatchcase(name, pattern) for pattern in patterns):
                names.setdefault(at, name)
        moving = dependents(graph, lambda node: node.op in ("input", "state"))
        constant = frozenset(name for at, name in names.items() if at not in moving)
        kept = tuple(names.values())
        # the outputs come last in most functions
        return cls(kept[-MAX_NODES:], constant, max(len(kept) - MAX_NODES, 0))


def _target_nodes(problem: Problem) -> set[str]:
    return {node for c in problem.criteria if (node := problem.target_node(c)) is not None}


@dataclass(frozen=True)
class Probes:
    """A problem with probes.

    Attributes:
        problem: with an offset and a factor at each node.
        nodes: the nodes, in the order of the probes.
    """

    problem: Problem
    nodes: tuple[str, ...]

    @classmethod
    def of(cls, problem: Problem, nodes: Sequence[str]) -> "Probes":
        """Return the problem with probes; its parameters are the values at which it is linearised."""
        graph = problem.model.graph
        corrections = {graph.names[name]: _probe(number) for number, name in enumerate(nodes)}
        scalars = [Scalar(name, 0.0) for number in range(len(nodes)) for name in (offset(number), factor(number))]
        model = replace(problem.model, graph=with_corrections(graph, corrections), equations=None)
        parameters = problem.parameters.with_parameters(*scalars)
        free = (*problem.free, *(scalar.name for scalar in scalars))
        return cls(replace(problem, model=model, parameters=parameters, free=free), tuple(nodes))


def offset(number: int) -> str:
    """Return the name of the offset of a node; no formula text can contain it."""
    return f"\0add {number}"


def factor(number: int) -> str:
    """Return the name of the factor of a node."""
    return f"\0multiply {number}"


def is_probe(name: str) -> bool:
    """Return True for the name of an offset or a factor."""
    return name.startswith("\0")


def _probe(number: int) -> Correction:
    def correct(b: GraphBuilder, node: int, _: dict[str, int]) -> int:
        scaled = b.call("mul", node, b.call("add", b.const(1.0), b.lookup(factor(number))))
        return b.call("add", scaled, b.lookup(offset(number)))

    return correct
