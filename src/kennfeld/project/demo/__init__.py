"""Ready projects with their data, for a first look."""

from kennfeld.project.demo.writing import NAMES, write

__all__ = ["NAMES", "write"]
