"""A fit with some smoothness factors, and the factors that the problem linearised there proposes next."""

from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.optimize.choice.prediction import Prediction, minimised
from kennfeld.optimize.solver.gauss_newton import Descent

__all__ = ["NEAR", "Round"]

RANGE = 1e7  # most and least factor, relative to the data
NEAR = 0.1  # difference of logarithms that is not worth another fit
RISE = 0.25  # the same for a rise of the level of smoothness


@dataclass(frozen=True)
class Round:
    """A fit with some factors, and the criterion there.

    `live` are the factors whose tables the data reach, `middle` the logarithms at which these weigh as much as the
    data.
    """

    logarithms: Float
    fit: Descent
    value: float = np.inf
    prediction: Prediction | None = None
    live: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))
    middle: Float = field(default_factory=lambda: np.zeros(0))

    @property
    def cut_short(self) -> bool:
        """Whether the fit did not come to an end."""
        return self.fit.status in ("stopped", "failed")

    @property
    def stopped(self) -> bool:
        """Whether the user stopped the fit."""
        return self.fit.status == "stopped"

    def proposed(self, radius: float) -> tuple[Float, float]:
        """The best factors within a radius, in the problem linearised here, and the gain that they promise."""
        if self.prediction is None:
            return self.logarithms, 0.0
        here, spread = self.logarithms[self.live], np.log(RANGE)
        lower, upper = (np.clip(self.middle + side, here - radius, here + radius) for side in (-spread, spread))
        found = minimised(self.prediction, here, lower, upper)
        return self._with(found), self.value - self.prediction.at(found).value

    def raised(self, allowed: float, stride: float) -> tuple[Float, float]:
        """Raise the lowest factors to the highest common level at which the criterion is allowed, as linearised here.

        Levels are relative to the data: 0 is where roughness and data weigh the same. Factors above the level stay.

        Args:
            allowed: The largest value of the criterion.
            stride: The most by which the lowest level may rise.

        Returns:
            The logarithms of all factors, and the rise of the lowest level.
        """
        if self.prediction is None:
            return self.logarithms, 0.0
        prediction, here = self.prediction, self.logarithms[self.live]
        lowest = float(np.min(here - self.middle))
        low, high = lowest + RISE, min(lowest + stride, np.log(RANGE))

        def is_allowed(level: float) -> bool:
            return prediction.at(np.maximum(here, self.middle + level)).value <= allowed

        if high < low or not is_allowed(low):  # mostly so after one fit
            return self.logarithms, 0.0
        if is_allowed(high):
            low = high
        while high - low > RISE:
            middle = (low + high) / 2
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return self._with(np.maximum(here, self.middle + low)), low - lowest

    def _with(self, live: Float) -> Float:
        """All logarithms, with these where the data reach the table."""
        logarithms = self.logarithms.copy()
        logarithms[self.live] = live
        return logarithms
