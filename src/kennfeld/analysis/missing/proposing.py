"""`propose`: the terms that a function lacks."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.independence import Beside
from kennfeld.analysis.missing.judging import Judge, error_of
from kennfeld.analysis.missing.map_scoring import map_kinds
from kennfeld.analysis.missing.map_search import MapSearch
from kennfeld.analysis.missing.mean_errors import has_squares, mean_squares, unequal_criteria
from kennfeld.analysis.missing.probes import Nodes
from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
from kennfeld.analysis.missing.recordings import FEWEST as FEWEST_RECORDINGS
from kennfeld.analysis.missing.recordings import MOST, can_be_numbered, numbered
from kennfeld.analysis.missing.refit import Addition, refit_options
from kennfeld.analysis.missing.scoring import Scored, is_timed, score_problem
from kennfeld.analysis.missing.settled import settled_problem
from kennfeld.analysis.missing.shortlist import CandidateGroup, alike, shortlist
from kennfeld.analysis.missing.terms import FORMS, Form, describe
from kennfeld.base.arrays import ignore_floating_errors
from kennfeld.base.errors import ArgumentError, renamed
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.partitions import Partition, join_files
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.isolated_call import isolated
from kennfeld.optimize.search.multistart import run

UNFINISHED = 1e-3  # share of the cost that the values themselves would take off, from which a fit has not ended
DERIVED = 0.1  # share of the RMSE that remains, below which a channel may be derived from the target
FEWEST = 20  # samples more than there are values
UNTRIED = "No such term could be tried, or the function can produce all of them itself: nothing is known."

Report = Callable[[str], None]


@dataclass(frozen=True)
class PartialSearch:
    """A search that has not ended.

    Attributes:
        found: the proposals so far, which are not compared with each other yet.
        fitted: candidates that were fitted.
        to_fit: all that are.
    """

    found: TermProposals
    fitted: int
    to_fit: int


Watch = Callable[[PartialSearch], None]


@dataclass(frozen=True)
class SearchScope:
    """The channels, nodes and kinds of terms that take part."""

    channels: Sequence[str] = ("*",)
    nodes: Sequence[str] = ("*",)
    kinds: Sequence[Form] = FORMS
    least: float = 0.0

    def check(self) -> None:
        """Raise `ArgumentError` if a kind is unknown or a pattern is not in a list."""
        for name, patterns in (("channels", self.channels), ("nodes", self.nodes), ("kinds", self.kinds)):
            if isinstance(patterns, str):
                raise ArgumentError(f"{name}={patterns!r} must be a list: {name}=[{patterns!r}]")
        for kind in self.kinds:
            if kind not in FORMS:
                remedy = nearest(kind, FORMS) or f"Use {', '.join(FORMS)}."
                raise ArgumentError(f"kinds: unknown kind {kind!r}. {remedy}")
        if not self.least >= 0:
            raise ArgumentError(f"least must be >= 0, got {self.least!r}")


def propose(
    model: Any,
    data: Any = None,
    parameters: Any = None,
    target: str | float | None = None,
    *,
    channels: Sequence[str] = ("*",),
    nodes: Sequence[str] = ("*",),
    kinds: Sequence[Form] = FORMS,
    least: float = 0.0,
    options: Options | None = None,
    progress: Report | None = None,
    report: Report | None = None,
    **arguments: Any,
) -> TermProposals:
    """Find terms that a function lacks: which channel or lag, and at which node.

    All candidates are scored by one linearisation. The best five are fitted, and those that make the errors smaller on
    held-out parts of the training data are proposed.

    Args:
        model: a `Problem`, such as `Project.problem()` gives; or the model, with `data`, `parameters` and all else as
            in `calibrate`. Channels that the function does not read take part as well.
        data: training data.
        parameters: the calibration. It is fitted further if that lowers the cost by a thousandth or more.
        target: the channel that the model's output shall follow.
        channels: glob patterns of the channels that take part.
        nodes: glob patterns of the nodes that take part.
        kinds: `add` and `multiply` by a curve of a channel, `map` by one over two channels, `lag` by a PT1, `delay` by
            steps, `offset` of each recording.
        least: effect that a proposal must explain on held-out data, in the unit of the target.
        options: of the fits.
        progress: called with lines of text.
        report: former name of `progress`.
        arguments: as in `calibrate`.

    Returns:
        The proposals, the best one first; none if nothing is missing that the channels explain.

    Raises:
        InputError: the input cannot be used.

    >>> import numpy as np
    >>> x, z = np.tile([0.0, 1.0, 2.0, 3.0], 50), np.repeat(np.arange(10.0), 20)
    >>> found = propose("y = a + b * x", {"x": x, "z": z, "m": 1 + 2 * x + z}, {"a": 0.0, "b": 0.0}, target="m")
    >>> found[0].change
    'Add a curve of z to y'
    """
    progress = renamed(progress, report, "progress", "report")
    scope = SearchScope(channels, nodes, kinds, least)
    scope.check()
    if isinstance(model, Problem):
        if arguments or data is not None or parameters is not None or target is not None:
            raise ArgumentError("propose(problem) accepts only channels, nodes, kinds, least, options and progress")
        problem = model
    else:
        problem = ProblemSetup(model, data, parameters, target, **arguments).problem()
    return find_terms(problem, scope, options or Options(), progress or (lambda line: None))


@isolated
def find_terms(
    problem: Problem, scope: SearchScope, options: Options, report: Report, watch: Watch | None = None
) -> TermProposals:
    """Return the terms that a problem lacks; see `propose`.

    `watch` is called with what is known, after all candidates were scored and after each that was fitted.
    """
    with ignore_floating_errors():
        return _TermSearch(problem, scope, refit_options(options), report, watch or (lambda search: None)).proposals()


class _TermSearch:
    def __init__(self, problem: Problem, scope: SearchScope, options: Options, report: Report, watch: Watch) -> None:
        self._scope, self._options, self._report, self._watch = scope, options, report, watch
        self._remarks: list[str] = []
        self._began = time.perf_counter()
        self._names: tuple[str, ...] = ()
        problem = _with_whole_files(problem)
        if "offset" in scope.kinds:
            problem, self._names = numbered(problem)
        self._unit = _unit(problem)
        base, result = self._fitted(problem)
        self._judge = Judge(base, result, options, scope.least, self._names, self._unit)

    def _fitted(self, problem: Problem) -> tuple[Problem, Result]:
        """Return the problem at its minimum, with automatic settings as they were chosen, and the fit."""
        self._report("fitting the function as it is")
        result = run(problem, self._options)
        if result.cost_before - result.cost_after > UNFINISHED * result.cost_after:
            text = f"The values were fitted further first: cost {result.cost_before:.4g} -> {result.cost_after:.4g}."
            self._remarks.append(text)
        if not result.converged:
            self._remarks.append(f"That fit ended early ({result.status}): {result.message}")
        settled = settled_problem(problem, result)
        if remark := unequal_criteria(settled, result):
            self._remarks.append(remark)
        if not has_squares(settled):
            self._remarks.append("Errors are roots of the mean loss, as in the cost: outliers count for less.")
        return settled, result

    def proposals(self) -> TermProposals:
        problem, result = self._judge.problem, self._judge.result
        samples = mean_squares(problem, result, "training")[1]
        if samples < problem.free_size + FEWEST:
            message = f"{samples} samples are too few for {problem.free_size} values: no term can be judged."
            return TermProposals(
                proposals=(),
                smallest_effect=0.0,
                status="failed",
                message=message,
                remarks=tuple(self._remarks),
                unit=self._unit,
            )
        channels = Channels.of(problem, self._scope.channels)
        nodes = Nodes.of(problem, self._scope.nodes)
        if nodes.left_out:
            self._remarks.append(f"The last {len(nodes.names)} nodes took part, not {nodes.left_out} others.")
        self._judge = replace(self._judge, gaps=channels.gaps)
        self._report("scoring candidates")
        scored = score_problem(problem, channels, nodes, self._scope.kinds)
        if scored.own_share > UNFINISHED:
            self._remarks.append(f"{scored.own_share:.1%} of the cost is still to be had from the values themselves.")
        groups = shortlist(scored.scores)
        seconds = time.perf_counter() - self._began
        smallest = scored.smallest

        def known(kept: Sequence[TermProposal], rejected: Sequence[str], status: str, message: str) -> TermProposals:
            return TermProposals(
                proposals=tuple(kept),
                smallest_effect=smallest,
                status=status,
                message=message,
                candidates=len(scored.scores),
                share_left=scored.own_share,
                share=scored.share,
                best=describe(groups[0].best.term) if groups else "",
                rejected=tuple(rejected),
                excluded=channels.excluded,
                remarks=tuple(self._remarks),
                seconds=(seconds, time.perf_counter() - self._began - seconds),
                unit=self._unit,
                problem=problem,
            )

        def tell(kept: list[TermProposal], rejected: list[str]) -> None:
            partial = known(sorted(kept, key=error_of), rejected, "unfinished", "")
            self._watch(PartialSearch(partial, len(kept) + len(rejected), len(groups)))

        tell([], [])
        kept, rejected = self._judged(groups, scored, tell) if groups else ([], [])
        kept.sort(key=error_of)
        kinds, tried = map_kinds(self._scope.kinds), 0
        beside = Beside(self._judge, channels, nodes, self._report)
        kept, extended = beside.independent(kept, rejected, len(scored.scores), follows=bool(kinds))
        if kinds:
            search = MapSearch(self._judge, channels, nodes, self._report)
            maps, tried = search.proposals(kinds, kept, extended, scored, rejected)
            if maps:
                kept, _ = beside.independent(sorted([*kept, *maps], key=error_of), rejected, len(scored.scores))
        self._remarks += [*_gap_remarks(kept, channels), *_doubts(problem, kept)]
        if not len(scored.scores) + tried:
            self._remarks += impossible_kinds(problem, self._scope.kinds)
            return replace(known([], [], "failed", UNTRIED), smallest_effect=0.0)
        if set(self._scope.kinds) != set(FORMS):
            self._remarks += impossible_kinds(problem, self._scope.kinds)
        status = "found" if kept else "none"
        return replace(
            known(kept, rejected, status, self._message(kept, smallest)), candidates=len(scored.scores) + tried
        )

    def _message(self, kept: Sequence[TermProposal], smallest: float) -> str:
        unit = f" {self._unit}" if self._unit else ""
        least = max(smallest, self._scope.least)
        if kept:
            return f"Effects from {least:.3g}{unit} on would have been seen."
        return f"Nothing is missing that these channels explain; an effect of {least:.3g}{unit} would have been seen."

    def _judged(
        self,
        groups: Sequence[CandidateGroup],
        scored: Scored,
        tell: Callable[[list[TermProposal], list[str]], None],
    ) -> tuple[list[TermProposal], list[str]]:
        """Return the proposals, and in words the candidates that are no better on data that their fit has not seen."""
        self._report("fitting the function to parts of the data")
        kept: list[TermProposal] = []
        rejected: list[str] = []
        for number, group in enumerate(groups, 1):
            self._report(f"fitting candidate {number} of {len(groups)}: {describe(group.best.term)}")
            group = self._judge.after_few_steps(group, alike(scored.scores, group), scored.weights)
            addition = Addition.of(self._judge.problem, group.best)
            judge = self._judge.where_known(addition)
            change = judge.held_out(*judge.parts(whole=group.best.term.kind != "offset"), addition)
            if reason := judge.fault(change):
                rejected.append(f"{describe(group.best.term)}: {reason}")
            else:
                kept.append(judge.proposal(group, addition, change, len(scored.scores), scored.weights))
            tell(kept, rejected)
        return kept, rejected


def _doubts(problem: Problem, proposals: Sequence[TermProposal]) -> list[str]:
    """Return a sentence on each new channel that explains too much: a curve may undo how it was computed.

    The correlation, by which channels are excluded, tells only those that are a straight line of the target.
    """
    known = {*problem.model.graph.inputs}
    names = {
        name: 1 - (each.held_out.after / each.held_out.before) ** 2
        for each in proposals
        for name in each.term.channels
        if name not in known and each.held_out.after < DERIVED * each.held_out.before
    }
    return [
        f"{name} explains {share:.2%} of the squared errors: make sure that it is not derived from the target."
        for name, share in names.items()
    ]


def impossible_kinds(problem: Problem, kinds: Sequence[Form]) -> list[str]:
    """Return a sentence on each of these kinds of terms that the data do not allow."""
    remarks = []
    if not is_timed(problem) and (series := [kind for kind in ("lag", "delay") if kind in kinds]):
        remarks.append(f"No {' or '.join(series)} was tried: the training data have no time.")
    if "offset" in kinds and not can_be_numbered(problem):
        needed = f"{FEWEST_RECORDINGS} to {MOST} training recordings that are not in partitions"
        remarks.append(f"No offset was tried: that needs {needed}.")
    return remarks


def _gap_remarks(proposals: Sequence[TermProposal], channels: Channels) -> list[str]:
    """Return a sentence for each channel of proposals that has gaps."""
    names = dict.fromkeys(name for each in proposals for name in each.term.channels)
    return [
        f"{name} is missing in {channels.gaps[name]:.1%} of the samples; all errors with it are those of the others."
        for name in names
        if name in channels.gaps
    ]


def _with_whole_files(problem: Problem) -> Problem:
    """Return a problem whose partitions are whole files: a lag remembers what was before, and files are held out."""
    if problem.partitions is None:
        return problem
    parts = [part for partition in join_files(problem.partitions.training) for part in partition.parts]
    whole = replace(problem.partitions, training=tuple(Partition((part,)) for part in parts))
    return replace(problem, partitions=whole)


def _unit(problem: Problem) -> str:
    """Return the unit of the RMSE; "" if criteria have different ones."""
    units = {problem.error_unit(criterion) for criterion in problem.criteria}
    [unit] = units if len(units) == 1 else [""]
    return "" if unit == "-" else unit
