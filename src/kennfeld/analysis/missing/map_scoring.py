"""The scores of maps over two channels, of the pairs that are worth it.

A map over every pair of channels would cost hundreds of times what curves cost. Tried are pairs of the channels whose
curves are best, and pairs whose product is significant: one column for each pair, at each node.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.families import HatAxis, map_families, product_families
from kennfeld.analysis.missing.probes import Nodes, Probes
from kennfeld.analysis.missing.score import TermScore
from kennfeld.analysis.missing.scoring import CandidateScorer
from kennfeld.analysis.missing.shortlist import significant
from kennfeld.analysis.missing.terms import OF_CHANNELS, Form, Kind
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem

MULTIPLIED = 16  # channels whose products are tried, the best ones by their curves: 120 pairs
BEST = 3  # channels of which each pair is tried as a map, and pairs by their products

Pair = tuple[HatAxis, HatAxis]


@dataclass(frozen=True)
class MapScores:
    """The scores of maps, how many candidates were tried, and the cost of the data without them."""

    scores: tuple[TermScore, ...] = ()
    candidates: int = 0
    cost: float = 0.0


def map_kinds(kinds: Sequence[Form]) -> tuple[Kind, ...]:
    """Return how maps take part: as curves do, in each way if these do not; () if maps do not take part."""
    if "map" not in kinds:
        return ()
    return tuple(kind for kind in OF_CHANNELS if kind in kinds) or OF_CHANNELS


def score_maps(
    problem: Problem, channels: Channels, nodes: Nodes, kinds: Sequence[Kind], curves: Sequence[TermScore]
) -> MapScores:
    """Score maps over pairs of channels at the values of a problem.

    Args:
        problem: with its values, without automatic settings.
        channels: that take part.
        nodes: that take part.
        kinds: how maps are added to a node, of `add` and `multiply`.
        curves: scores of curves of the channels.
    """
    axes = _ordered(channels.axes, curves)
    if len(axes) < 2 or not kinds:
        return MapScores()
    probes = Probes.of(problem, nodes.names)
    compiled = CompiledProblem(probes.problem)
    free = compiled.values.free
    with blas_threads(free):
        scorer = CandidateScorer.of(compiled, probes)
        every = _pairs(channels.axes, axes[:MULTIPLIED])
        kind: Kind = "add" if "add" in kinds else "multiply"
        products = [*scorer.scores(product_families(probes, every, kind, free))]
        pairs = _chosen(every, products, _significant_channels(curves))
        maps = [*scorer.scores(map_families(probes, pairs, kinds, nodes.constant, free))]
    chances = {_place(score): score.p for score in products}
    scores = tuple(_with_product(score, chances) for score in maps)
    return MapScores(scores, len(products) + len(maps), scorer.linear.cost)


def rescored(problem: Problem, nodes: Nodes, scores: Sequence[TermScore], channels: Channels) -> list[TermScore]:
    """Return the scores of the same maps in another problem, in their order; without those it can produce itself.

    Args:
        problem: with its values.
        nodes: of the function.
        scores: of maps over the same channels.
        channels: their axes.
    """
    places = tuple(dict.fromkeys(score.term.node for score in scores))
    [pair] = _pairs(channels.axes, [axis for axis in channels.axes if axis.name in scores[0].term.channels])
    probes = Probes.of(problem, places)
    compiled = CompiledProblem(probes.problem)
    with blas_threads(compiled.values.free):
        kinds = tuple(dict.fromkeys(score.term.kind for score in scores))
        families = map_families(probes, [pair], kinds, nodes.constant, compiled.values.free)
        others = {score.term: score for score in CandidateScorer.of(compiled, probes).scores(families)}
    return [others[score.term] for score in scores if score.term in others]


def _best_merit(curves: Sequence[TermScore]) -> dict[str, float]:
    merits: dict[str, float] = {}
    for score in curves:
        if score.term.channel:
            merits[score.term.channel] = max(merits.get(score.term.channel, -np.inf), float(f"{score.merit:.9g}"))
    return merits


def _ordered(axes: Sequence[HatAxis], curves: Sequence[TermScore]) -> list[HatAxis]:
    """Return axes in the order of their best curves."""
    merits = _best_merit(curves)
    return sorted(axes, key=lambda axis: -merits.get(axis.name, -np.inf))


def _significant_channels(curves: Sequence[TermScore]) -> list[str]:
    merits = _best_merit(significant(curves))
    return sorted(merits, key=lambda name: -merits[name])[:BEST]


def _pairs(order: Sequence[HatAxis], some: Sequence[HatAxis]) -> list[Pair]:
    """Return all pairs of some axes, each pair and all pairs in one order."""
    kept = [axis for axis in order if axis in some]
    return [*combinations(kept, 2)]


def _chosen(pairs: Sequence[Pair], products: Sequence[TermScore], channels: Sequence[str]) -> list[Pair]:
    """Return the pairs of the best channels, and those of the best products."""
    joint = dict.fromkeys(score.term.channels for score in significant(products))
    if len(pairs) == 1:
        return [*pairs]
    best = [*joint][:BEST]
    named = [(pair[0].name, pair[1].name) for pair in pairs]
    kept = (pair for pair, names in zip(pairs, named, strict=True) if names in best or {*names} <= {*channels})
    return [*kept]


def _place(score: TermScore) -> tuple[str, tuple[str, ...]]:
    return score.term.node, score.term.channels


def _with_product(score: TermScore, chances: Mapping[tuple[str, tuple[str, ...]], float]) -> TermScore:
    """Return a score whose probability is that of all values of the map, or of the product alone.

    A weak effect on two channels together is lost among three dozen values, and seen in one.
    """
    return replace(score, p=min(2 * min(score.p, chances.get(_place(score), 1.0)), 1.0))
