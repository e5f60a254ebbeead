"""Models and where they come from: one frontend a file or folder."""

from kennfeld.models.model import Model, merge_start_values

__all__ = ["Model", "merge_start_values"]
