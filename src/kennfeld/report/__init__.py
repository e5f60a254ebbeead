"""HTML report of a calibration: errors before and after, parameters, uncertainty, settings."""

from kennfeld.report.page import document, document_safely, from_folder

__all__ = ["document", "document_safely", "from_folder"]
