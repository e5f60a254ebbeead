"""What the data determine of a result, and what they leave open."""

from kennfeld.optimize.trust.holding import Holding
from kennfeld.optimize.trust.inspection import Inspection
from kennfeld.optimize.trust.null_space import NullSpace, Remedy
from kennfeld.optimize.trust.trust import Trust
from kennfeld.optimize.trust.words import Direction

__all__ = ["Direction", "Holding", "Inspection", "NullSpace", "Remedy", "Trust"]
