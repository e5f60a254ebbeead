"""Example projects with generated data."""

from kennfeld.project.demo.writing import NAMES, closing, prepare, projects, write

__all__ = ["NAMES", "closing", "prepare", "projects", "write"]
