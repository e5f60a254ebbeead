"""Proposals that explain what better ones leave."""

from collections.abc import Sequence
from dataclasses import replace

from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.map_scoring import score_maps
from kennfeld.analysis.missing.probes import Nodes
from kennfeld.analysis.missing.proposal import TermProposal
from kennfeld.analysis.missing.refit import hold_out
from kennfeld.analysis.missing.scoring import score_problem
from kennfeld.analysis.missing.search_round import SearchRound
from kennfeld.analysis.missing.shortlist import LEVEL
from kennfeld.optimize.problem.problem import Problem


class Beside(SearchRound):
    """Adds proposals one after the other, and asks what the next one explains beside them."""

    def independent(
        self, proposals: Sequence[TermProposal], rejected: list[str], candidates: int, *, follows: bool = False
    ) -> tuple[list[TermProposal], Problem]:
        """Return the proposals that explain what the better ones leave, and are not mere copies of what these do.

        Args:
            proposals: the best first.
            rejected: where the others are added in words.
            candidates: number of those that were tried.
            follows: True if the function with all of them is needed.

        Returns:
            The proposals, and the function with them.
        """
        chosen: list[TermProposal] = []
        problem = self.judge.problem
        for proposal in proposals:
            if chosen and not (
                self._is_significant(problem, proposal, candidates) and self._is_better_still(problem, proposal)
            ):
                rejected.append(f"{proposal.change}: explains what better proposals explain")
                continue
            chosen.append(proposal)
            if len(proposals) > 1 or follows:
                problem = self._with(problem, proposal, len(chosen))
        return chosen, problem

    def _with(self, problem: Problem, proposal: TermProposal, number: int) -> Problem:
        """Return the function with one proposal more, fitted."""
        if proposal.addition is None:
            return problem
        if number == 1 and proposal.fit is not None:
            extended = proposal.addition.to(problem, problem.parameters)
            return replace(extended, parameters=proposal.fit.parameters)
        self.report(f"fitting the function with {number} of the proposals")
        return self.fitted_with(problem, [proposal.addition], problem.parameters)[0]

    def _is_significant(self, problem: Problem, proposal: TermProposal, candidates: int) -> bool:
        term = proposal.term
        axes = Channels(tuple(axis for axis in self.channels.axes if axis.name in term.channels), {})
        place = Nodes((term.node,), self.nodes.constant & {term.node})
        if term.second:
            scores = score_maps(problem, axes, place, [term.kind], []).scores
        else:
            scores = score_problem(problem, axes, place, [term.kind]).scores
        return min((score.p for score in scores), default=1.0) * candidates < LEVEL

    def _is_better_still(self, problem: Problem, proposal: TermProposal) -> bool:
        """Return if a proposal lowers the error on held-out parts of the function with the better ones."""
        if proposal.addition is None:
            return False
        known = proposal.addition if self.judge.reads_gaps(proposal.addition) else None
        name, parts = hold_out(problem, self.judge.options, whole=proposal.term.kind != "offset", known=known)
        return not self.judge.fault(self.judge.held_out(name, parts, proposal.addition))
