"""Models and where they come from: one frontend a file or folder."""

from kennfeld.models.model import Model, started

__all__ = ["Model", "started"]
