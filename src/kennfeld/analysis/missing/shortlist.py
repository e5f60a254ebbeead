"""The shortlist: candidates that differ in what they explain, each with the places that explain the same."""

from collections.abc import Sequence

from kennfeld.analysis.missing.score import TermScore
from kennfeld.base.lazy_dataclass import dataclass

LEVEL = 0.01  # of all candidates together (C. Bonferroni)
LENGTH = 5
EQUAL = 9.2  # difference of gains in units of the dispersion: odds of 100 to 1 between two terms


@dataclass(frozen=True)
class CandidateGroup:
    """The best candidate of its kind, and others that the data cannot distinguish from it, best first."""

    best: TermScore
    equal: tuple[TermScore, ...]


def significant(scores: Sequence[TermScore], candidates: int = 0) -> list[TermScore]:
    """Return the scores that chance does not explain, the best first.

    Args:
        scores: of candidates.
        candidates: number of all that were tried, if not only these.
    """
    tried = max(len(scores), candidates)
    improbable = [score for score in scores if score.p * tried < LEVEL and score.merit > 0]
    # by few digits, so that the order of equal candidates is that in which they were scored
    return sorted(improbable, key=lambda score: -float(f"{score.merit:.9g}"))


def shortlist(scores: Sequence[TermScore], length: int = LENGTH, candidates: int = 0) -> list[CandidateGroup]:
    """Return the best candidates that explain different things: one for each channel, pair of them, lag and delay."""
    groups: list[CandidateGroup] = []
    rest = significant(scores, candidates)
    while rest and len(groups) < length:
        best = rest[0]
        alike = [score for score in rest if _subject(score) == _subject(best)]
        equal = tuple(score for score in alike[1:] if best.merit - score.merit < EQUAL * best.dispersion)
        groups.append(CandidateGroup(best, equal))
        rest = [score for score in rest if _subject(score) != _subject(best)]
    return groups


def alike(scores: Sequence[TermScore], group: CandidateGroup) -> list[TermScore]:
    """Return the significant candidates of the channels, or of the kind, of a group, the best first."""
    return [score for score in significant(scores) if _subject(score) == _subject(group.best)]


def _subject(score: TermScore) -> tuple[str, str]:
    return (score.term.channel, score.term.second) if score.term.channel else ("", score.term.kind)
