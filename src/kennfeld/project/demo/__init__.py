"""Example projects with generated data."""

from kennfeld.project.demo.writing import NAMES, all_or_none, closing, prepare, projects, write

__all__ = ["NAMES", "all_or_none", "closing", "prepare", "projects", "write"]
