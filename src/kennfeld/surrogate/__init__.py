"""Data-driven models: trained on recordings, stored as one readable file, used in a formula like any node."""

from kennfeld.surrogate.narx import DynamicSurrogate
from kennfeld.surrogate.static import StaticSurrogate
from kennfeld.surrogate.stored import Surrogate, read_surrogate, write_surrogate

__all__ = ["DynamicSurrogate", "StaticSurrogate", "Surrogate", "read_surrogate", "write_surrogate"]

from kennfeld.surrogate.expand import compress_map, expand_data
from kennfeld.surrogate.gaussian_process import GaussianProcess, gaussian_process
from kennfeld.surrogate.quality import Quality
from kennfeld.surrogate.stored import recognises_surrogate
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate
from kennfeld.surrogate.validity import Validity

__all__ = [
    "DynamicSurrogate",
    "GaussianProcess",
    "Quality",
    "StaticSurrogate",
    "SurrogateSettings",
    "Validity",
    "compress_map",
    "expand_data",
    "gaussian_process",
    "read_surrogate",
    "recognises_surrogate",
    "train_surrogate",
    "write_surrogate",
]
