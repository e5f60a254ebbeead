"""Data-driven models: trained on recordings, stored as one readable file, used in a formula like any node."""

from kennfeld.surrogate.surrogate_file import (
    Surrogate,
    expansions,
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
    "expansions",
    "read_surrogate",
    "recognises_surrogate",
    "write_surrogate",
]
