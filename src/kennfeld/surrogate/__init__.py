"""Data-driven models: trained on recordings, stored in a readable file, used in a formula like any node."""

from kennfeld.surrogate.surrogate_file import (
    Surrogate,
    as_parameters,
    read_surrogate,
    recognises_surrogate,
    write_surrogate,
)
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, StaticSurrogate, SurrogateQuality
from kennfeld.surrogate.validity import Validity

__all__ = [
    "DynamicSurrogate",
    "StaticSurrogate",
    "Surrogate",
    "SurrogateQuality",
    "Validity",
    "as_parameters",
    "read_surrogate",
    "recognises_surrogate",
    "write_surrogate",
]
