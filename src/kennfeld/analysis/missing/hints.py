"""Lines after a calibration: what the best term would take off the cost, and what the values themselves would."""

from dataclasses import replace
from typing import Any

from kennfeld.analysis.missing.excerpt import excerpt
from kennfeld.analysis.missing.settled import settled_problem
from kennfeld.base.arrays import ignore_floating_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.fit.result import Result, Seconds
from kennfeld.optimize.problem.problem import Problem

SHARE_OF_TIME = 0.1  # of a calibration, that scores may take
ALWAYS = 0.3  # s that they may take after any
EVALUATIONS = 20.0  # of the calibration, that scores of all samples take as long as
PER_NODE, PER_CUBE = 4e-4, 1e-10  # s for a node of the graph to be compiled, for a value cubed to be factored
FEWEST = 20_000  # samples that are always scored, which takes less than ALWAYS
MAX_NODES = 12  # the last of the function, which take part
LAGS = 3  # time constants that are tried
LEAST = 0.01  # share of the cost that is worth a line
UNFINISHED = 1e-3  # the same, of what the values themselves would take off


@dataclass(frozen=True)
class Hints:
    """The terms that a calibrated function may lack.

    Attributes:
        share_left: share of the cost that the values themselves would take off, if the search stopped early.
        scored: True if terms were scored, which takes too long after the calibration of some large functions.
        best: the best term in words; "" if none is significant.
        share: share of the cost that it would take.

    >>> Hints(scored=True, best="Add a curve of Throttle to dragTorque", share=0.12).lines()
    ['Add a curve of Throttle to dragTorque: would take 12% off the cost; see kennfeld propose.']
    """

    share_left: float = 0.0
    scored: bool = False
    best: str = ""
    share: float = 0.0

    def lines(self) -> list[str]:
        """Return at most two sentences."""
        lines = self.left_lines()
        if self.best and self.share >= LEAST:
            lines.append(f"{self.best}: would take {self.share:.0%} off the cost; see kennfeld propose.")
        elif self.scored:
            text = "No lag, and no curve of a channel that the function reads, would take 1% off the cost"
            lines.append(f"{text}; kennfeld propose also tries maps, other channels, delays and offsets of recordings.")
        return lines

    def left_lines(self) -> list[str]:
        """Return a sentence on what the values themselves would take off the cost, if that is worth one."""
        if self.share_left <= UNFINISHED:
            return []
        return [f"{self.share_left:.1%} of the cost is still to be had from the values themselves."]

    def as_json(self) -> dict[str, Any]:
        """Return the entry `missing` of `result.json`."""
        shares = {"share_left": float(f"{self.share_left:.6g}"), "share": float(f"{self.share:.6g}")}
        return {"scored": self.scored, "best": self.best, **shares}

    @classmethod
    def from_json(cls, content: Any) -> "Hints | None":
        """Return what `as_json` has written; None if it is something else."""
        match content:
            case {
                "share_left": float() | int() as share_left,
                "scored": bool(scored),
                "best": str(best),
                "share": float() | int() as share,
            }:
                return cls(float(share_left), scored, best, float(share))
        return None


def hints(problem: Problem, result: Result) -> Hints:
    """Return what a calibrated function lacks.

    Only channels that the function reads take part, and of large data as many samples as can be scored in a tenth of
    the time of the calibration. No terms are scored if the function alone is too large for that.

    Args:
        problem: as it was calibrated, with its start.
        result: of the calibration.
    """
    certificate = result.certificate
    share_left = 0.0 if result.converged or certificate is None else certificate.predicted_decrease
    # of data in partitions, this process has an excerpt
    settled = settled_problem(replace(problem, partitions=None), result)
    samples = sum(data.samples for data in settled.fitted_datasets)
    fixed = PER_NODE * len(problem.model.graph.nodes) + PER_CUBE * problem.free_size**3
    count = affordable_samples(result.seconds, result.evaluations, samples, fixed)
    return _scored(excerpt(settled, count / max(samples, 1)), share_left) if count else Hints(share_left)


def affordable_samples(seconds: Seconds, evaluations: int, samples: int, fixed: float) -> int:
    """Return how many samples can be scored in a share of the time of a calibration; 0 if none.

    Args:
        seconds: of the calibration.
        evaluations: of the calibration.
        samples: of the training data.
        fixed: time that scores take whatever the samples, in s.
    """
    allowed = SHARE_OF_TIME * seconds.total
    if fixed > max(allowed, ALWAYS):
        return 0
    each = EVALUATIONS * seconds.optimize / max(evaluations, 1) / max(samples, 1)
    return max(FEWEST, int(min((allowed - fixed) / each, samples)) if each > 0 else samples)


def _scored(problem: Problem, share_left: float) -> Hints:
    from kennfeld.analysis.missing.channels import Channels
    from kennfeld.analysis.missing.probes import Nodes
    from kennfeld.analysis.missing.scoring import score_problem
    from kennfeld.analysis.missing.shortlist import significant
    from kennfeld.analysis.missing.terms import describe

    nodes = Nodes.of(problem)
    last = replace(nodes, names=nodes.names[-MAX_NODES:])
    with ignore_floating_errors():
        scored = score_problem(problem, Channels.of(problem), last, ("add", "multiply", "lag"), LAGS)
    best = significant(scored.scores)[:1]
    return Hints(share_left, True, describe(best[0].term) if best else "", scored.share)
