"""What a result says about its trust, whatever form that has."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float, Int

__all__ = ["Direction", "TrustView", "view"]

MANY = 2000  # values up to which leverage is asked for: computing it costs their third power


@dataclass(frozen=True)
class Direction:
    """A change of values that the data cannot tell from none, in words, and what settles it."""

    sentence: str
    remedy: str


@dataclass(frozen=True)
class TrustView:
    """The parts of a trust that are known, by parameter or axis of free breakpoints; what is not known is empty."""

    informed: Mapping[str, Bool] = field(default_factory=dict)
    samples: Mapping[str, Int] = field(default_factory=dict)
    deviation: Mapping[str, Float] = field(default_factory=dict)
    leverage: Mapping[str, Float] = field(default_factory=dict)
    by_smoothness: Mapping[str, Bool] = field(default_factory=dict)
    directions: tuple[Direction, ...] = ()
    null_space: Direction | None = None  # all changes that nothing determines, counted
    holdings: tuple[str, ...] = ()  # limits that are met and what they hold, a sentence each
    remark: str = ""


def view(trust: Any) -> TrustView:
    """The trust of a result: an object with these attributes, or a mapping of the informed values alone."""
    if trust is None:
        return TrustView()
    if isinstance(trust, Mapping):
        return TrustView(informed=trust)
    found = getattr(trust, "directions", ())
    directions = tuple(Direction(str(d.sentence), str(getattr(d, "remedy", ""))) for d in found)
    whole = getattr(trust, "null_space", None)
    null_space = Direction(str(whole.sentence), str(whole.advice)) if whole is not None and whole.sentence else None
    holdings = tuple(str(holding) for holding in getattr(trust, "holdings", ()))
    remark = str(getattr(trust, "remark", ""))
    values = sum(np.size(array) for array in (getattr(trust, "deviation", None) or {}).values())
    parts = ["informed", "samples", "deviation", "by_smoothness", *(["leverage"] if values <= MANY else [])]
    known = {name: getattr(trust, name, None) for name in parts}
    arrays: dict[str, Any] = {name: value for name, value in known.items() if isinstance(value, Mapping)}
    return TrustView(directions=directions, null_space=null_space, holdings=holdings, remark=remark, **arrays)
