"""A round of a search: the judge of its candidates, and the channels and nodes that take part."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.judging import Judge
from kennfeld.analysis.missing.probes import Nodes
from kennfeld.analysis.missing.refit import Addition
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run


@dataclass(frozen=True)
class SearchRound:
    """A round of a search; each kind of round is a class of its own.

    Attributes:
        judge: of candidates.
        channels: that take part.
        nodes: that take part.
        report: called with lines of text.
    """

    judge: Judge
    channels: Channels
    nodes: Nodes
    report: Callable[[str], None]

    def fitted_with(self, problem: Problem, additions: Sequence[Addition], start: ParameterSet) -> tuple[Problem, bool]:
        """Return a function with terms, fitted, and if that fit has converged.

        Args:
            problem: the function without them.
            additions: the terms.
            start: values at which the fit begins, of all parameters that it has; others begin without effect.
        """
        for addition in additions:
            problem = addition.to(problem, problem.parameters)
        own = [start[name] for name in problem.parameters if name in start]
        began = replace(problem, parameters=problem.parameters.with_parameters(*own))
        result = run(began, self.judge.options)
        return replace(began, parameters=result.parameters), result.converged
