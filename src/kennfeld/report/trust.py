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
    """The parts of a trust that are known, by parameter; what is not known is empty."""

    informed: Mapping[str, Bool] = field(default_factory=dict)
    samples: Mapping[str, Int] = field(default_factory=dict)
    deviation: Mapping[str, Float] = field(default_factory=dict)
    leverage: Mapping[str, Float] = field(default_factory=dict)
    by_smoothness: Mapping[str, Bool] = field(default_factory=dict)
    directions: tuple[Direction, ...] = ()


def view(trust: Any) -> TrustView:
    """The trust of a result: an object with these attributes, or a mapping of the informed values alone."""
    if trust is None:
        return TrustView()
    if isinstance(trust, Mapping):
        return TrustView(informed=trust)
    found = getattr(trust, "directions", ())
    directions = tuple(Direction(str(d.sentence), str(getattr(d, "remedy", ""))) for d in found)
    values = sum(np.size(array) for array in (getattr(trust, "deviation", None) or {}).values())
    parts = ["informed", "samples", "deviation", "by_smoothness", *(["leverage"] if values <= MANY else [])]
    known = {name: getattr(trust, name, None) for name in parts}
    return TrustView(directions=directions, **{n: v for n, v in known.items() if isinstance(v, Mapping)})
