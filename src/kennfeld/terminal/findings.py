"""What a result leaves open, in a few lines."""

from kennfeld.optimize.trust import Trust

__all__ = ["left_open"]

MOST = 3  # lines


def left_open(trust: Trust) -> list[str]:
    """The worst directions that the data do not determine, a line each under a heading; nothing where there is none."""
    found = trust.directions
    if not found:
        return []
    more = [f"  and {len(found) - MOST} more; see result.json"] if len(found) > MOST else []
    return ["What the data leave open:", *(f"  {direction}" for direction in found[:MOST]), *more]
