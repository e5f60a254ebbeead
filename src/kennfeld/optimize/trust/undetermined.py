"""Lines on what the data of a fit do not determine."""

import numpy as np

from kennfeld.base.formatting import join_names, shorten, under_heading
from kennfeld.optimize.trust.trust import Trust

MAX_LINES = 3  # under one heading


def undetermined_lines(trust: Trust, pointer: str, settle: str = "") -> list[str]:
    """Return what no sample uses, the directions that the data determine worst, and the active output limits.

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
        *unused_values(trust),
        *under_heading("Parameters not determined by the data:", undetermined),
        *under_heading("Coupled, but determined:", shorten(coupled, MAX_LINES, pointer)),
        *under_heading("Active output limits:", shorten(outputs, MAX_LINES, pointer)),
    ]


def unused_values(trust: Trust) -> list[str]:
    """Return a line with the numbers of values that smoothness alone determines, by parameter; none if there are none.

    >>> from kennfeld import Curve, calibrate
    >>> data = {"x": [1.0, 1.5, 2.0], "m": [2.0, 3.1, 4.0]}
    >>> curve = Curve("C", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0])
    >>> unused_values(calibrate("y = C(x)", data, {"C": curve}, target="m", smoothness={"C": 0.1}).trust)
    ['No training sample uses 1 of 3 values of C; filled in by smoothness.']
    """
    counts = [
        f"{np.count_nonzero(unused)} of {unused.size} values of {name}"
        for name, unused in trust.by_smoothness.items()
        if unused.any()
    ]
    return [f"No training sample uses {join_names(counts)}; filled in by smoothness."] if counts else []
