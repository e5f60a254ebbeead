"""How well a data-driven model meets recordings."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Use

__all__ = ["Mode", "Quality", "quality_of"]

Mode = Literal["static", "leave one out", "one step", "free run"]


@dataclass(frozen=True)
class Quality:
    """One line: the residuals over one dataset, in the unit of the output."""

    dataset: str
    use: Use
    mode: Mode
    samples: int
    rmse: float
    r2: float
    max_abs: float

    def __str__(self) -> str:
        return (
            f"{self.dataset} ({self.use}), {self.mode}: RMSE {self.rmse:.4g}, "
            f"{f'R2 {self.r2:.4f}' if np.isfinite(self.r2) else 'no R2, for the target is constant'}, "
            f"maximum {self.max_abs:.4g} over {self.samples} samples"
        )


def quality_of(dataset: str, use: Use, mode: Mode, residual: Float, target: Float) -> Quality:
    """The line for residuals Float[samples] of a measured target Float[samples]; R2 is NaN where it never changes."""
    with np.errstate(over="ignore", invalid="ignore"):
        square = float(np.sum(residual**2))
        varying = target - target[:1]  # exactly 0 if the target is constant
        spread = float(np.sum((varying - varying.mean()) ** 2)) if target.size else 0.0
        worst = float(np.max(np.abs(residual), initial=0.0))
    r2 = 1 - square / spread if spread > 0 else np.nan
    rmse = float(np.sqrt(square / target.size)) if target.size else np.nan
    return Quality(dataset, use, mode, int(target.size), rmse, r2, worst)
