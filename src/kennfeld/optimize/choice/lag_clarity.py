"""How clearly a lag stands out among the others, in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

__all__ = ["Minimum", "sentence_on"]

CLEAR = 10.0  # likelihood ratio, as a difference of -2 log L, from which another lag is ruled out
APART = 2.0  # samples from a lag in time, within which others must be about as good
NEAR_END = 0.6  # samples


@dataclass(frozen=True)
class Minimum:
    """The lag of a channel, and the mean costs of fits at all lags of the window, in samples.

    `shift` is the lag in its `unit`: in s, for steady-state points in samples; `step` is that of a sample. So many
    samples are `scored`.
    """

    channel: str
    dataset: str
    shift: float
    step: float
    unit: Literal["s", "samples"]
    lag: float
    most: int
    costs: Mapping[float, float]
    scored: int

    @property
    def at_the_end(self) -> bool:
        """Whether it lies at the end of the window."""
        return abs(self.lag) > self.most - NEAR_END

    @property
    def rival(self) -> float:
        """The best of the other lags; of those in time, of the ones that are not its neighbours."""
        near = 0.5 if self.unit == "samples" else APART
        others = [lag for lag in self.costs if abs(lag - self.lag) > near] or list(self.costs)
        return min(others, key=lambda lag: self.costs[lag])

    @property
    def clear(self) -> bool:
        """Whether the data rule out the rival, were all errors independent."""
        best, other = min(self.costs.values()), self.costs[self.rival]
        if not (np.isfinite(other) and best > 0):
            return not other <= best
        return self.scored * float(np.log(other / best)) > CLEAR

    def __str__(self) -> str:
        best, other = (float(np.sqrt(cost)) for cost in (min(self.costs.values()), self.costs[self.rival]))
        where = f"{self.channel} in {self.dataset}"
        shift, rival = f"{self.shift:g} {self.unit}", f"{self.rival * self.step:g} {self.unit}"
        if self.clear:
            return f"The shift of {where}, {shift}, is clear: the error is {best:.4g} there, {other:.4g} at {rival}."
        return (
            f"The shift of {where} is not clear: the error is {best:.4g} at {shift} and {other:.4g} at {rival}. "
            "Give it as a number."
        )


def sentence_on(minima: Sequence[Minimum]) -> str:
    """Sentences on lags, those at the end of their window first."""
    said = []
    for most in sorted({m.most for m in minima if m.at_the_end}):
        names = ", ".join(f"{m.channel} in {m.dataset}" for m in minima if m.at_the_end and m.most == most)
        said.append(
            f"The shift of {names} reached the end of the window of {most} samples; shift it by a number first."
        )
    return " ".join([*said, *(str(m) for m in minima if not m.at_the_end)])
