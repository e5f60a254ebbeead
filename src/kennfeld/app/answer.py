"""Answers to the questions of a page."""

import math
from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any

from kennfeld.base.lazy_dataclass import dataclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from kennfeld.base.arrays import Float


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a question: a head that JSON can hold, and arrays that are drawn."""

    head: Mapping[str, Any] = field(default_factory=dict)
    arrays: "Mapping[str, NDArray[Any]]" = field(default_factory=dict)


def finite(value: float) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return float(value) if math.isfinite(value) else None  # NumPy takes ten times as long for one number


def finite_list(values: "Float") -> list[float | None]:
    """Return numbers of any shape for JSON in C order: None for those that are not finite."""
    return [value if math.isfinite(value) else None for value in values.ravel().tolist()]
