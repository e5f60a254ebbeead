"""What a result leaves open, in a few lines."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kennfeld.optimize.trust import Trust

if TYPE_CHECKING:  # most projects have no surrogates
    from kennfeld.analysis.leaving import Leaving

__all__ = ["left_data", "left_open"]

MOST = 3  # lines of a kind


def left_open(trust: Trust) -> list[str]:
    """The worst directions that the data do not determine, and what limits of outputs hold, a line each.

    Each kind under a heading; nothing where there is none. A search that did not come to its end says so first. If
    nothing determines several changes, their number comes first, with what settles all of them.
    """
    remark = [trust.remark] if trust.remark else []
    outputs = [holding for holding in trust.holdings if holding.samples]  # the message tells of breakpoints
    whole = [f"  {trust.null_space}"] if trust.null_space.dimension > 1 else []
    heading, *directions = _listed("What the data leave open:", trust.directions) or ["What the data leave open:"]
    return [
        *remark,
        *([heading, *whole, *directions] if whole or directions else []),
        *_listed("What limits hold:", outputs),
    ]


def left_data(found: "Sequence[Leaving]", where: str = "; see result.json") -> list[str]:
    """The surrogates that are used outside their data, the largest share first; `where` tells of the others."""
    outside = sorted((row for row in found if row.worst is not None), key=lambda row: -row.share)
    return _listed("What leaves the data of surrogates:", outside, where)


def _listed(heading: str, found: Sequence[object], where: str = "; see result.json") -> list[str]:
    more = [f"  and {len(found) - MOST} more{where}"] if len(found) > MOST else []
    return [heading, *(f"  {one}" for one in found[:MOST]), *more] if found else []
