"""A round of a search: the judge of its candidates, and the channels and nodes that take part."""

from collections.abc import Callable

from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.judging import Judge
from kennfeld.analysis.missing.probes import Nodes
from kennfeld.base.lazy_dataclass import dataclass


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
