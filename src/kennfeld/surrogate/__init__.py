"""Data-driven models: trained on recordings, stored as one readable file, used in a formula like any node."""

from kennfeld.surrogate.expansions import expansions
from kennfeld.surrogate.narx import DynamicSurrogate
from kennfeld.surrogate.quality import Quality
from kennfeld.surrogate.static import StaticSurrogate
from kennfeld.surrogate.stored import Surrogate, read_surrogate, recognises_surrogate, write_surrogate
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
