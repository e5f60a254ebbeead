"""Assessment of a result: its residuals, their location, active limits, and cross-validation."""

from kennfeld.analysis.autocorrelation import Autocorrelation, autocorrelation
from kennfeld.analysis.cell_errors import CellErrors
from kennfeld.analysis.cross_validation import CrossValidation, FoldQuality, cross_validate, cross_validated
from kennfeld.analysis.limit_margins import ActiveConstraint, OutputRange, active_constraints, output_ranges
from kennfeld.analysis.residuals import Errors, Residuals, Summary, WorstSample, residuals

__all__ = [
    "ActiveConstraint",
    "Autocorrelation",
    "CellErrors",
    "CrossValidation",
    "Errors",
    "FoldQuality",
    "OutputRange",
    "Residuals",
    "Summary",
    "WorstSample",
    "active_constraints",
    "autocorrelation",
    "cross_validate",
    "cross_validated",
    "output_ranges",
    "residuals",
]
