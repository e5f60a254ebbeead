"""The second round of a search: maps over two channels that explain more than the curves of the first round."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.analysis.missing.map_scoring import rescored, score_maps
from kennfeld.analysis.missing.proposal import TermProposal
from kennfeld.analysis.missing.refit import Addition, hold_out, pooled
from kennfeld.analysis.missing.scoring import Scored
from kennfeld.analysis.missing.search_round import SearchRound
from kennfeld.analysis.missing.shortlist import CandidateGroup, shortlist
from kennfeld.analysis.missing.terms import Kind, describe
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Parameter
from kennfeld.optimize.problem.problem import Problem

LENGTH = 2  # maps that are fitted
MARGIN = 1e-2  # of the held-out RMSE with the best curves, by which a map must lower it
SHARE = 0.1  # of what the curves explain, that a map with six times their values must explain more
OPEN = "cannot be judged, as the fit with a proposed curve of its channels has not ended: apply the curve first"
LITTLE = "explains little that better proposals do not"


class MapSearch(SearchRound):
    """Scores, fits and judges maps."""

    def proposals(
        self,
        kinds: Sequence[Kind],
        curves: Sequence[TermProposal],
        extended: Problem,
        scored: Scored,
        rejected: list[str],
    ) -> tuple[list[TermProposal], int]:
        """Return maps that explain more on held-out data than the first round, and how many were tried.

        They are scored beside these, with more breakpoints: a map must explain more than a curve.

        Args:
            kinds: how maps are added to a node.
            curves: the proposals of the first round.
            extended: the function with these.
            scored: the first round.
            rejected: where candidates that explain no more are added in words.
        """
        self.report("scoring maps of two channels")
        extended, converged = self._with_finer_curves(curves, extended)
        known = {channel for each in curves for channel in each.term.channels}
        maps = score_maps(extended, self.channels, self.nodes, kinds, scored.scores)
        better: list[TermProposal] = []
        for group in shortlist(maps.scores, LENGTH, maps.candidates):
            if curves and group.best.gain < SHARE * (scored.data_cost - maps.cost):
                rejected.append(f"{describe(group.best.term)}: {LITTLE}")
                continue
            if not converged and known & set(group.best.term.channels):
                rejected.append(f"{describe(group.best.term)}: {OPEN}")
                continue
            self.report(f"fitting a candidate: {describe(group.best.term)}")
            # without the curves, the function can take over less of a map
            scores = rescored(self.judge.problem, self.nodes, (group.best, *group.equal), self.channels)
            if not scores:
                continue
            group = CandidateGroup(replace(scores[0], p=group.best.p), tuple(scores[1:]))
            own = self.judge.after_few_steps(group, group.equal, scored.weights)
            addition = Addition.of(self.judge.problem, own.best)
            if reason := self._fault_beside(addition, curves, extended):
                rejected.append(f"{describe(own.best.term)}: {reason}")
                continue
            judge = self.judge.where_known(addition)
            change = judge.held_out(*judge.parts(), addition)
            if reason := judge.fault(change):
                rejected.append(f"{describe(own.best.term)}: {reason}")
                continue
            better.append(judge.proposal(own, addition, change, maps.candidates, scored.weights))
        return better, maps.candidates

    def _with_finer_curves(self, curves: Sequence[TermProposal], extended: Problem) -> tuple[Problem, bool]:
        """Return the function with curves of twice the breakpoints, fitted, and if that fit has converged.

        What a curve of few points leaves of its own bends, a map over a correlated channel would seem to explain.
        """
        start, additions, finer = extended.parameters, list[Addition](), list[Parameter]()
        for each in curves:
            assert each.addition is not None
            parameter = each.addition.parameter
            if parameter is not None and each.term.channel and not each.term.second:
                x = np.array(each.term.breakpoints)
                x = np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])]))
                finer.append(Curve(parameter.name, Axis(x, each.term.channel), start[parameter.name](x)))
                additions.append(replace(each.addition, parameter=finer[-1]))
            else:
                additions.append(each.addition)
        if not finer:
            return extended, True
        return self.fitted_with(self.judge.problem, additions, start.with_parameters(*finer))

    def _fault_beside(self, addition: Addition, curves: Sequence[TermProposal], extended: Problem) -> str:
        """Return why a map in place of the curves of its channels is no better than they are; "" if it is."""
        if not curves:
            return ""
        others = [each for each in curves if not set(each.term.channels) & set(addition.term.channels)]
        without = self.judge.problem
        for each in others:
            if each.addition is not None:
                without = each.addition.to(without, without.parameters)
        known = addition if self.judge.reads_gaps(addition) else None
        name, with_curves = hold_out(extended, self.judge.options, known=known)
        plain = self.judge.where_known(addition).parts()[1]
        parts = hold_out(without, self.judge.options, known=known)[1] if others else plain
        # as if the function without these curves were as good as with them
        rivals = [replace(part, squares=curve.squares) for part, curve in zip(parts, with_curves, strict=True)]
        change = self.judge.held_out(name, rivals, addition)
        if reason := self.judge.fault(change, MARGIN):
            return f"beside better proposals, {reason}"
        explained = pooled([part.squares for part in plain], rivals) ** 2 - change.rmse.before**2
        return LITTLE if change.rmse.explained**2 < SHARE * explained else ""
