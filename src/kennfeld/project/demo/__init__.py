"""Ready projects with their data, for a first look."""

from kennfeld.project.demo.writing import NAMES, noise, write

__all__ = ["NAMES", "noise", "write"]
