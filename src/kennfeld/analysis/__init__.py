"""What a result is worth: the errors that remain, and where they lie."""

from kennfeld.analysis.autocorrelation import Autocorrelation, autocorrelation
from kennfeld.analysis.cells import Cells
from kennfeld.analysis.residuals import Errors, Residuals, Summary, WorstSample, residuals

__all__ = [
    "Autocorrelation",
    "Cells",
    "Errors",
    "Residuals",
    "Summary",
    "WorstSample",
    "autocorrelation",
    "residuals",
]
