"""Candidates are judged by fits to parts of the data, and become proposals by a fit to all of them."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import NamedTuple

import numpy as np

from kennfeld.analysis.missing.few_steps import after_few_steps
from kennfeld.analysis.missing.mean_errors import errors_by_criterion, mean_squares
from kennfeld.analysis.missing.proposal import EqualPlace, HeldOutErrors, RmseChange, TermProposal
from kennfeld.analysis.missing.refit import Addition, HeldOut, held_out_squares, hold_out, pooled
from kennfeld.analysis.missing.score import TermScore
from kennfeld.analysis.missing.shortlist import CandidateGroup
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Use
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run

MARGIN = 5e-3  # of the held-out RMSE, by which a term must lower it


class HeldOutChange(NamedTuple):
    """The errors on the held-out parts that were tried, what was held out, and how many parts are better."""

    rmse: RmseChange
    name: str
    better: int
    parts: int
    errors: tuple[HeldOutErrors, ...]


@dataclass(frozen=True)
class Judge:
    """Fits a function with candidates.

    Attributes:
        problem: the function as it is, at the end of its fit.
        result: of that fit.
        options: of the fits.
        least: effect that a proposal must explain.
        names: of the recordings, for offsets.
        unit: of the RMSE.
        gaps: share of the samples at which channels are missing, of those that have gaps.
    """

    problem: Problem
    result: Result
    options: Options
    least: float
    names: tuple[str, ...]
    unit: str
    gaps: Mapping[str, float] = field(default_factory=dict)
    _parts: dict[bool, tuple[str, list[HeldOut]]] = field(default_factory=dict, repr=False)

    def where_known(self, addition: Addition) -> "Judge":
        """Return a judge of the function as it is over the samples that it has with a term.

        Samples at which a channel of the term is missing drop out of its fit. Their errors are not what it explains.
        """
        if not self.reads_gaps(addition):
            return self
        result = run(addition.without_effect(self.problem), self.options)
        values = [result.parameters[name] for name in self.problem.parameters]
        problem = replace(self.problem, parameters=self.problem.parameters.with_parameters(*values))
        parts = {True: hold_out(problem, self.options, known=addition)}
        return replace(self, problem=problem, result=result, _parts=parts)

    def reads_gaps(self, addition: Addition) -> bool:
        """Return True if a channel of a term has gaps."""
        return any(name in self.gaps for name in addition.term.channels)

    def parts(self, *, whole: bool = True) -> tuple[str, list[HeldOut]]:
        """Return what is held out, in words, and the parts with fits of the function as it is to the others.

        Args:
            whole: True if whole recordings are held out where there are enough.
        """
        if whole not in self._parts:
            self._parts[whole] = hold_out(self.problem, self.options, whole=whole)
        return self._parts[whole]

    def after_few_steps(self, group: CandidateGroup, others: Sequence[TermScore], weights: float) -> CandidateGroup:
        """Return a group as a few steps of a fit leave it; see `few_steps`."""
        squares = mean_squares(self.problem, self.result, "training")[0]
        return after_few_steps(self.problem, group, others, self.options, squares, weights)

    def held_out(self, name: str, parts: Sequence[HeldOut], addition: Addition) -> HeldOutChange:
        """Return the errors on held-out parts, up to the part with which they can no longer be lower."""
        squares = held_out_squares(parts, addition, self.options)
        before = pooled([part.squares for part in parts[: len(squares)]], parts)
        better = sum(after < part.squares for after, part in zip(squares, parts, strict=False))
        errors = tuple(
            HeldOutErrors(part.name, part.samples, RmseChange(float(np.sqrt(part.squares)), float(np.sqrt(after))))
            for part, after in zip(parts, squares, strict=False)
        )
        return HeldOutChange(RmseChange(before, pooled(squares, parts)), name, better, len(parts), errors)

    def fault(self, change: HeldOutChange, margin: float = MARGIN) -> str:
        """Return why a candidate is not proposed, given its errors on all held-out parts; "" if it is."""
        if len(change.errors) < change.parts:
            return f"no better on held-out {change.name} ({change.rmse})"
        # of most parts, not of one alone that is far off
        if not change.rmse.after < (1 - margin) * change.rmse.before or 2 * change.better <= change.parts:
            share = f"better in {change.better} of {change.parts} parts"
            return f"no better on held-out {change.name} ({change.rmse}, {share})"
        if change.rmse.explained < self.least:
            return f"explains {change.rmse.explained:.3g} on held-out {change.name}, less than {self.least:g}"
        return ""

    def proposal(
        self, group: CandidateGroup, addition: Addition, change: HeldOutChange, candidates: int, weights: float
    ) -> TermProposal:
        """Return the proposal of a group.

        Args:
            group: the candidate and equal places.
            addition: how it is added to the problem.
            change: of the errors on held-out parts.
            candidates: number of those that were tried.
            weights: sum of the weights.
        """
        problem, result = self.problem, self.result
        term = group.best.term
        extended = addition.to(problem, problem.parameters)
        refit = run(extended, self.options)

        def errors(use: Use) -> RmseChange:
            fits = (problem, result), (extended, refit)
            return RmseChange(*(float(np.sqrt(mean_squares(*fit, use)[0])) for fit in fits))

        parameter = None if addition.parameter is None else refit.parameters[addition.parameter.name]
        if parameter is not None and term.kind == "lag":
            term = replace(term, seconds=float(parameter.values))
        test = errors("test")
        location = problem.model.locations.get(term.node)
        return TermProposal(
            term=term,
            equal_places=tuple(
                EqualPlace(s.term.node, s.term.kind, s.term.channel, Addition.of(problem, s)) for s in group.equal
            ),
            rmse=errors("training"),
            held_out=change.rmse,
            held_name=change.name,
            test=None if np.isnan(test.before) else test,
            predicted=float(np.sqrt(max(group.best.predicted, 0.0) / weights)),
            probability=min(group.best.p * candidates, 1.0),
            parameter=parameter,
            better=change.better,
            parts=change.parts,
            unit=self.unit,
            location="" if location is None else str(location),
            addition=addition,
            offsets=self._offsets(parameter) if term.kind == "offset" else {},
            held_out_parts=change.errors,
            criteria=_by_criterion(problem, result, refit),
            fit=refit,
        )

    def _offsets(self, parameter: Parameter | None) -> dict[str, float]:
        values = [] if parameter is None else parameter.values.tolist()
        return dict(zip(self.names, values, strict=False))


def error_of(proposal: TermProposal) -> tuple[bool, float]:
    """Return the order: recordings held out whole are harder to meet than the parts of them that judge an offset."""
    return proposal.term.kind == "offset", float(f"{proposal.held_out.after:.6g}")


def _by_criterion(problem: Problem, before: Result, after: Result) -> tuple[tuple[str, RmseChange], ...]:
    """Return the errors of each criterion on the training data, if there are several."""
    nodes = [criterion.node for criterion in problem.criteria]
    errors = zip(*(errors_by_criterion(problem, each, "training") for each in (before, after)), strict=True)
    return tuple(zip(nodes, (RmseChange(*own) for own in errors), strict=True)) if len(nodes) > 1 else ()
