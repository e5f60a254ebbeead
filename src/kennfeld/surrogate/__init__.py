"""Data-driven models: trained on recordings, stored in a readable file, used in a formula like any node."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names

if TYPE_CHECKING:
    from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
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
    "FilteredSurrogate",
    "StaticSurrogate",
    "Surrogate",
    "SurrogateQuality",
    "Validity",
    "as_parameters",
    "read_surrogate",
    "recognises_surrogate",
    "write_surrogate",
]

__getattr__ = lazy_names(
    __name__,
    {
        "filtered_surrogate": "FilteredSurrogate",
        "surrogate_file": "Surrogate as_parameters read_surrogate recognises_surrogate write_surrogate",
        "surrogate_models": "DynamicSurrogate StaticSurrogate SurrogateQuality",
        "validity": "Validity",
    },
)
