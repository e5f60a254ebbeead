"""Ready projects with their data, for a first look."""

from kennfeld.project.demo.writing import NAMES, closing, prepare, projects, write

__all__ = ["NAMES", "closing", "prepare", "projects", "write"]
