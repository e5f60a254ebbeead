"""What a result is worth: the errors that remain, and where they lie."""

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
