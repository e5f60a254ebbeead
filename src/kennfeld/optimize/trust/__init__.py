"""What the data determine of a result, and what they leave open."""

from kennfeld.optimize.trust.active_limits import Holding
from kennfeld.optimize.trust.assessment import Inspection
from kennfeld.optimize.trust.direction_text import Direction
from kennfeld.optimize.trust.null_space import NullSpace, Remedy
from kennfeld.optimize.trust.trust import Trust

__all__ = ["Direction", "Holding", "Inspection", "NullSpace", "Remedy", "Trust"]
