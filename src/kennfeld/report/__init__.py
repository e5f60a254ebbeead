"""HTML report of a calibration: errors before and after, parameters, uncertainty, settings.

>>> from kennfeld import Project, report
>>> project = Project.read("kennfeld.toml")
>>> text = report.document(project, project.calibrate(), project.check())
>>> text.startswith("<!doctype html>")
True
"""

from kennfeld.report.page import document, document_safely, from_folder

__all__ = ["document", "document_safely", "from_folder"]
