"""Uncertainty of a result: covariance, poorly determined directions, active limits."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names

if TYPE_CHECKING:
    from kennfeld.optimize.trust.active_limits import ActiveLimit
    from kennfeld.optimize.trust.assessment import TrustAssessment
    from kennfeld.optimize.trust.direction_text import Direction
    from kennfeld.optimize.trust.null_space import NullSpace
    from kennfeld.optimize.trust.remedies import Remedy
    from kennfeld.optimize.trust.trust import Trust

__all__ = ["ActiveLimit", "Direction", "NullSpace", "Remedy", "Trust", "TrustAssessment"]

__getattr__ = lazy_names(
    __name__,
    {
        "active_limits": "ActiveLimit",
        "assessment": "TrustAssessment",
        "direction_text": "Direction",
        "null_space": "NullSpace",
        "remedies": "Remedy",
        "trust": "Trust",
    },
)
