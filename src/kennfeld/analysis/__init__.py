"""What a result is worth: the errors that remain, and where they lie."""

from kennfeld.analysis.autocorrelation import Autocorrelation, autocorrelation
from kennfeld.analysis.cell_errors import Cells
from kennfeld.analysis.cross_validation import CrossValidation, FoldQuality, cross_validate, cross_validated
from kennfeld.analysis.limit_margins import OutputRange, Pressing, output_ranges, pressing
from kennfeld.analysis.residuals import Errors, Residuals, Summary, WorstSample, residuals

__all__ = [
    "Autocorrelation",
    "Cells",
    "CrossValidation",
    "Errors",
    "FoldQuality",
    "OutputRange",
    "Pressing",
    "Residuals",
    "Summary",
    "WorstSample",
    "autocorrelation",
    "cross_validate",
    "cross_validated",
    "output_ranges",
    "pressing",
    "residuals",
]
