"""Data-driven models: trained on recordings, stored as one readable file, used in a formula like any node."""

from kennfeld.surrogate.surrogate_file import (
    Surrogate,
    expansions,
    read_surrogate,
    recognises_surrogate,
    write_surrogate,
)
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, Quality, StaticSurrogate
from kennfeld.surrogate.validity import Validity

__all__ = [
    "DynamicSurrogate",
    "Quality",
    "StaticSurrogate",
    "Surrogate",
    "Validity",
    "expansions",
    "read_surrogate",
    "recognises_surrogate",
    "write_surrogate",
]
