"""Uncertainty of a result: covariance, poorly determined directions, active limits."""

from kennfeld.optimize.trust.active_limits import ActiveLimit
from kennfeld.optimize.trust.assessment import TrustAssessment
from kennfeld.optimize.trust.direction_text import Direction
from kennfeld.optimize.trust.null_space import NullSpace
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.optimize.trust.trust import Trust

__all__ = ["ActiveLimit", "Direction", "NullSpace", "Remedy", "Trust", "TrustAssessment"]
