"""Models, and the frontends that read them from formula text or a Simulink model."""

from kennfeld.models.model import Model, bind_scalars, merge_start_values

__all__ = ["Model", "bind_scalars", "merge_start_values"]
