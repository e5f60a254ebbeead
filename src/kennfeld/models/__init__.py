"""Models, and the frontends that read them from formula text or a Simulink model."""

from kennfeld.models.model import Model, ambiguity, ambiguous_names, bind_scalars, merge_start_values

__all__ = ["Model", "ambiguity", "ambiguous_names", "bind_scalars", "merge_start_values"]
