"""Assessment of a result: its residuals, their location, active limits, and cross-validation."""

from kennfeld.analysis.autocorrelation import autocorrelation
from kennfeld.analysis.cross_validation import CrossValidation, cross_validate
from kennfeld.analysis.limit_margins import active_constraints, output_ranges
from kennfeld.analysis.residuals import Residuals, residuals

__all__ = [
    "CrossValidation",
    "Residuals",
    "active_constraints",
    "autocorrelation",
    "cross_validate",
    "output_ranges",
    "residuals",
]
