"""The project file `kennfeld.toml`: what is calibrated, with which data, how; and what runs it."""

from kennfeld.project.project import Project

__all__ = ["Project"]
