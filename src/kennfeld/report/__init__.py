"""HTML report of a calibration: errors before and after, parameters, uncertainty, settings."""

from kennfeld.report.page import document, from_folder, safely

__all__ = ["document", "from_folder", "safely"]
