"""Sums of the errors of a criterion, over samples that may arrive in parts."""

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass


@dataclass
class ErrorSums:
    """Count, sum of squares and largest size of errors; not finite if an error is not."""

    count: int = 0
    squares: float = 0.0
    largest: float = 0.0

    @classmethod
    def of(cls, errors: Float) -> "ErrorSums":
        """Return the sums of errors, Float[samples]."""
        with np.errstate(over="ignore", invalid="ignore"):
            return cls(errors.size, float(np.sum(errors**2)), float(np.abs(errors).max(initial=0.0)))

    def merge(self, later: "ErrorSums") -> None:
        """Take in the sums of other errors."""
        self.count += later.count
        self.squares += later.squares
        self.largest = float(np.maximum(self.largest, later.largest))

    @property
    def rmse(self) -> float:
        """Root mean square; NaN without errors."""
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")
