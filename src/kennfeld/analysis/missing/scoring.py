"""The scores of all candidates of a problem, from one linearisation."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.analysis.missing.candidate_series import goes_along
from kennfeld.analysis.missing.candidate_sums import (
    BlockSums,
    FamilySums,
    block_sums,
    family_sums,
    merged,
    merged_blocks,
)
from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.families import (
    Family,
    Series,
    channel_families,
    offset_families,
    passes,
    series_families,
)
from kennfeld.analysis.missing.probes import Nodes, Probes, factor, offset
from kennfeld.analysis.missing.recordings import recording_count
from kennfeld.analysis.missing.score import Linearisation, TermScore, detected_gain
from kennfeld.analysis.missing.shortlist import LEVEL, significant
from kennfeld.analysis.missing.terms import OF_CHANNELS, Form
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning.holdout_blocks import Divisions, HoldoutBlocks

BLOCKS = 40  # of recordings in time, from which the dispersion of scores follows
LAGS = 10  # time constants that are tried
DELAYS = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144)  # steps that are tried; then those between the best neighbours
BETWEEN = 8  # of these, at most, at a time
BLOCKS_OF_RECORDING = 4  # at least, if recordings are compared
CLOSE = 0.5  # share of the best merit from which a node takes part in that
LONGEST = 0.1  # share of a recording, of a lag or a delay


@dataclass(frozen=True)
class Scored:
    """The scores of all candidates of a problem.

    Attributes:
        scores: of the candidates.
        own_share: share of the cost that the values themselves would take off.
        cost: of the data and of the roughness.
        weights: sum of the weights of the linearised problem; the cost of the data divided by it is a mean square.
        smallest: RMSE of the least effect of a curve that nearly always is significant.
        problem: with the values at which it is linearised.
    """

    scores: tuple[TermScore, ...]
    own_share: float
    data_cost: float
    weights: float
    smallest: float

    @property
    def share(self) -> float:
        """Share of the cost that the best significant candidate takes off; 0 without one."""
        best = significant(self.scores)[:1]
        return best[0].gain / self.data_cost if best and self.data_cost > 0 else 0.0


def score_problem(
    problem: Problem, channels: Channels, nodes: Nodes, kinds: Sequence[Form], lags: int = LAGS
) -> Scored:
    """Score all candidates at the values of a problem.

    Args:
        problem: with its values, without automatic settings.
        channels: that take part.
        nodes: that take part.
        kinds: that take part; maps are scored by `score_maps`.
        lags: time constants that are tried.
    """
    probes = Probes.of(problem, nodes.names)
    compiled = CompiledProblem(probes.problem)
    with blas_threads(compiled.values.free):
        scorer = CandidateScorer.of(compiled, probes, BLOCKS)
        linear = scorer.linear
        scores = [*scorer.scores(_families(problem, probes, channels, nodes, kinds, lags, compiled))]
        if "delay" in kinds:
            scores += _finer_delays(scores, lambda series: scorer.scores(_series_families(probes, series, compiled)))
        if "offset" in kinds and (count := recording_count(problem)):
            # recordings of few blocks would show no scatter beside their mean
            own = scorer if BLOCKS_OF_RECORDING * count <= BLOCKS else scorer.finer(BLOCKS_OF_RECORDING * count)
            scores += own.scores([*offset_families(probes, nodes.constant, count)])
    dispersions = [score.dispersion for score in scores] or [linear.variance]
    freedom = linear.blocks - 1.0 if linear.blocks else max(linear.count - linear.rank, 1.0)
    typical = float(np.median(dispersions))
    least = detected_gain(typical, 5, freedom, LEVEL / max(len(scores), 1)) if typical > 0 else 0.0
    smallest = float(np.sqrt(least)) * linear.sums.mean_effect if least > 0 else 0.0
    share = linear.own_gain / linear.cost if linear.cost > 0 else 0.0
    return Scored(tuple(scores), share, linear.cost, linear.sums.weights or 1.0, smallest)


@dataclass(frozen=True)
class CandidateScorer:
    """Scores families by one linearisation, with the recordings divided into blocks.

    Attributes:
        compiled: the problem with probes.
        probes: the nodes.
        linear: the linearisation.
        divisions: of the recordings into blocks.
        blocks: number of blocks.
    """

    compiled: CompiledProblem
    probes: Probes
    linear: Linearisation
    divisions: Divisions
    blocks: int

    @classmethod
    def of(cls, compiled: CompiledProblem, probes: Probes, blocks: int = BLOCKS) -> "CandidateScorer":
        """Linearise a problem."""
        holdout = HoldoutBlocks.of(compiled, blocks)
        divisions, count = (holdout.divisions, holdout.sizes.size) if holdout is not None else ({}, 0)
        own: Sequence[BlockSums] = [*compiled.each(block_sums, compiled.start, divisions, count)]
        names = [name for number in range(len(probes.nodes)) for name in (offset(number), factor(number))]
        linear = Linearisation(compiled, compiled.start, merged_blocks(own), names)
        return cls(compiled, probes, linear, divisions, count)

    def finer(self, blocks: int) -> "CandidateScorer":
        """Return a scorer with more blocks."""
        return CandidateScorer.of(self.compiled, self.probes, blocks)

    def scores(self, families: Iterable[Family]) -> Iterator[TermScore]:
        """Yield the scores of the candidates of families."""
        arguments = (self.compiled.start, self.divisions, self.blocks)
        stored = _stored(self.compiled)
        for group in passes(families, self.compiled.values.free, self.blocks, stored):
            sums: list[FamilySums] = merged(self.compiled.each(family_sums, group, *arguments))
            for family, own in zip(group, sums, strict=True):
                yield from self.linear.scores(family, own)


def _families(
    problem: Problem,
    probes: Probes,
    channels: Channels,
    nodes: Nodes,
    kinds: Sequence[Form],
    lags: int,
    compiled: CompiledProblem,
) -> Sequence[Family]:
    of_channels = [kind for kind in OF_CHANNELS if kind in kinds]
    families = [*channel_families(probes, channels.axes, of_channels, nodes.constant, compiled.values.free)]
    moving = [name for name in nodes.names if name not in nodes.constant]
    return [*families, *_series_families(probes, trial_series(problem, moving, kinds, lags), compiled)]


def _series_families(probes: Probes, series: Sequence[Series], compiled: CompiledProblem) -> list[Family]:
    return [*series_families(probes, series, _stored(compiled))]


def _stored(compiled: CompiledProblem) -> int:
    """Return how many numbers of each series are stored."""
    return 0 if goes_along(compiled) else compiled.sample_count


def _finer_delays(
    scores: Sequence[TermScore], score: Callable[[Sequence[Series]], Iterator[TermScore]]
) -> list[TermScore]:
    """Return the scores of further delays, between the neighbours of the best one, at nodes that are nearly as good.

    Args:
        scores: of all candidates.
        score: scores series.
    """
    tried = [each for each in significant(scores) if each.term.kind == "delay"]
    finer: list[TermScore] = []
    while tried:
        best = max(tried, key=lambda each: each.merit)
        known = sorted({each.term.steps for each in (*scores, *finer) if each.term.kind == "delay"})
        at = known.index(best.term.steps)
        # the last delay that was tried has no neighbour beyond
        ends = known[max(at - 1, 0) : at + 2]
        steps = sorted({number for a, b in pairwise(ends) for number in _between(a, b)})
        if not steps:
            break
        nodes = dict.fromkeys(each.term.node for each in tried if each.merit >= CLOSE * best.merit)
        finer += score([Series(node, "delay", steps=number) for node in nodes for number in steps])
        tried = [each for each in (*tried, *finer) if each.term.node in nodes]
    return finer


def _between(first: int, last: int) -> list[int]:
    """Return whole numbers between two, evenly spaced, at most half of `BETWEEN`."""
    count = min(last - first - 1, BETWEEN // 2)
    return sorted({round(x) for x in np.linspace(first, last, count + 2)[1:-1].tolist()} - {first, last})


def is_timed(problem: Problem) -> bool:
    """Return True if all training data have time, so that lags and delays can be tried."""
    return all(data.time is not None and data.settling is None for data in problem.fitted_datasets)


def trial_series(problem: Problem, nodes: Sequence[str], kinds: Sequence[Form], lags: int = LAGS) -> list[Series]:
    """Return the lags and delays that are tried, if all training data have time."""
    datasets = problem.fitted_datasets
    if not is_timed(problem):
        return []
    steps = [float(np.median(np.diff(data.time))) for data in datasets if data.time is not None and data.samples > 1]
    pieces = [piece.stop - piece.start for data in datasets for piece in data.pieces]
    if problem.partitions is not None:
        pieces = [part.last - part.first for each in problem.partitions.training for part in each.parts]
    if not steps or max(pieces, default=0) < 10:
        return []
    step, longest = float(np.median(steps)), LONGEST * max(pieces)
    constants = np.geomspace(2 * step, max(longest * step, 4 * step), lags)
    tried = [float(f"{seconds:.2g}") for seconds in constants] if "lag" in kinds else []
    delays = [count for count in DELAYS if count <= longest] if "delay" in kinds else []
    return [
        *(Series(node, "lag", seconds=seconds) for node in nodes for seconds in dict.fromkeys(tried)),
        *(Series(node, "delay", steps=count) for node in nodes for count in delays),
    ]
