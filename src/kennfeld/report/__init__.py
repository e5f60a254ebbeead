"""The report: one HTML file that says what a calibration achieved, and how far to trust it."""

from kennfeld.report.page import document, from_folder, safely

__all__ = ["document", "from_folder", "safely"]
