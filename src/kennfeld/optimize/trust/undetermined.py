"""Lines on what the data of a fit do not determine."""

from kennfeld.base.formatting import shorten, under_heading
from kennfeld.optimize.trust.trust import Trust

MAX_LINES = 3  # under one heading


def undetermined_lines(trust: Trust, pointer: str, settle: str = "") -> list[str]:
    """Return the directions that the data determine worst, and the active output limits, each under a heading.

    The remark on a search that did not converge comes first. If several directions are undetermined, their number and
    a remedy for all of them come before the single ones. Directions that are coupled, but determined, need none.

    Args:
        trust: the trust of a result.
        pointer: where to find the entries that are not listed.
        settle: the command that finds what settles the first direction; empty for none.
    """
    remark = [trust.remark] if trust.remark else []
    directions = [str(direction) for direction in trust.directions if not direction.determined]
    undetermined = shorten(directions, MAX_LINES, pointer)
    if trust.null_space.dimension > 1:
        undetermined.insert(0, str(trust.null_space))
    if directions and settle:
        undetermined.append(f"What would settle the first of them, if anything: {settle}")
    coupled = [direction.sentence for direction in trust.directions if direction.determined]
    outputs = [str(limit) for limit in trust.holdings if limit.samples]  # the message names those of breakpoints
    return [
        *remark,
        *under_heading("Parameters not determined by the data:", undetermined),
        *under_heading("Coupled, but determined:", shorten(coupled, MAX_LINES, pointer)),
        *under_heading("Active output limits:", shorten(outputs, MAX_LINES, pointer)),
    ]
