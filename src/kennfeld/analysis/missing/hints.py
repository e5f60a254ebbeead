"""Lines after a calibration: what the best term would take off the cost, and what the values themselves would."""

from kennfeld.base.arrays import ignore_floating_errors
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.problem import Problem

SHARE_OF_TIME = 0.1  # of a calibration, that scores may take
COMPILATIONS, EVALUATIONS = 4.0, 40.0  # that scores take as long as, at most
LEAST = 0.01  # share of the cost that is worth a line
UNFINISHED = 1e-3  # the same, of what the values themselves would take off


def hints(problem: Problem, result: Result) -> list[str]:
    """Return at most two lines on a calibration.

    Candidates are scored only if that takes no more than a tenth of the time of the calibration, and only channels that
    the function reads take part.
    """
    lines = []
    certificate = result.certificate
    if not result.converged and certificate is not None and certificate.predicted_decrease > UNFINISHED:
        share = certificate.predicted_decrease
        lines.append(f"{share:.1%} of the cost is still to be had from the values themselves.")
    if is_affordable(result) and problem.partitions is None:
        lines += _best(problem, result)
    return lines


def is_affordable(result: Result) -> bool:
    """Return if scores take no more than their share of the time of a calibration."""
    seconds, evaluations = result.seconds, max(result.evaluations, 1)
    estimate = COMPILATIONS * seconds.compile + EVALUATIONS * seconds.optimize / evaluations
    return estimate <= SHARE_OF_TIME * seconds.total


def _best(problem: Problem, result: Result) -> list[str]:
    # a short calibration, which is not prolonged, does not wait for these modules either
    from kennfeld.analysis.missing.channels import Channels
    from kennfeld.analysis.missing.probes import Nodes
    from kennfeld.analysis.missing.proposal import describe
    from kennfeld.analysis.missing.proposing import score_problem, settled_problem
    from kennfeld.analysis.missing.shortlist import significant

    problem = settled_problem(problem, result)
    with ignore_floating_errors():
        scored = score_problem(problem, Channels.of(problem), Nodes.of(problem), ("add", "multiply", "lag"))
    best = significant(scored.scores)[:1]
    if not best or scored.share < LEAST:
        return []
    return [f"{describe(best[0].term)}: would take {scored.share:.0%} off the cost; see kennfeld propose."]
