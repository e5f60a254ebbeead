"""Models, and the frontends that read them from formula text or a Simulink model."""

from kennfeld.models.model import Model, merge_start_values

__all__ = ["Model", "merge_start_values"]
