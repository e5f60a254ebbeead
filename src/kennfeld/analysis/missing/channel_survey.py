"""The gaps of channels and their correlations with targets, over the scored training samples of all partitions."""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.threads import map_in_order
from kennfeld.domain.dataset import Dataset
from kennfeld.optimize.problem.problem import Problem


class JointMoments(NamedTuple):
    """The number of samples at which two channels are known, their means, and sums of products of the deviations.

    >>> JointMoments.of(np.array([1.0, 2.0, 4.0]), np.array([2.0, 4.0, 8.0])).correlation
    1.0
    """

    samples: int = 0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    yy: float = 0.0
    xy: float = 0.0

    @classmethod
    def of(cls, x: Float, y: Float) -> "JointMoments":
        """Return the moments of two channels, Float[samples] each."""
        known = np.isfinite(x) & np.isfinite(y)
        if not known.all():
            x, y = x[known], y[known]
        if not x.size:
            return cls()
        mean_x, mean_y = float(x.mean()), float(y.mean())
        x, y = x - mean_x, y - mean_y
        return cls(x.size, mean_x, mean_y, float(x @ x), float(y @ y), float(x @ y))

    def joined(self, other: "JointMoments") -> "JointMoments":
        """Return the moments of the samples of both (Chan, Golub, LeVeque, COMPSTAT 1982)."""
        samples = self.samples + other.samples
        if not samples:
            return self
        share, dx, dy = other.samples / samples, other.x - self.x, other.y - self.y
        own = self.samples * share
        xx, yy = self.xx + other.xx + own * dx * dx, self.yy + other.yy + own * dy * dy
        xy = self.xy + other.xy + own * dx * dy
        return JointMoments(samples, self.x + share * dx, self.y + share * dy, xx, yy, xy)

    @property
    def correlation(self) -> float:
        """The magnitude of the correlation; 0 if a channel is constant."""
        size = float(np.sqrt(self.xx * self.yy))
        return abs(self.xy) / size if size > 0 else 0.0


class ChannelSurvey(NamedTuple):
    """The scored samples of a channel.

    Attributes:
        samples: their number.
        missing: those without a value.
        moments: with each target.
    """

    samples: int
    missing: int
    moments: dict[str, JointMoments]

    @property
    def missing_share(self) -> float:
        """The share of the samples without a value; 1 without samples."""
        return self.missing / self.samples if self.samples else 1.0

    def joined(self, other: "ChannelSurvey") -> "ChannelSurvey":
        """Return the survey of the samples of both."""
        moments = {name: own.joined(other.moments[name]) for name, own in self.moments.items()}
        return ChannelSurvey(self.samples + other.samples, self.missing + other.missing, moments)


def survey_channels(problem: Problem, names: Sequence[str], targets: Sequence[str]) -> dict[str, ChannelSurvey]:
    """Return the survey of channels that all training data have, over all partitions in their order."""
    parts = problem.each(_surveys, names, targets)
    merged = reduce(lambda own, more: [a.joined(b) for a, b in zip(own, more, strict=True)], parts)
    return dict(zip(names, merged, strict=True))


def _surveys(problem: Problem, names: Sequence[str], targets: Sequence[str]) -> list[ChannelSurvey]:
    datasets = problem.fitted_datasets

    def survey(name: str) -> ChannelSurvey:
        values = scored_values(datasets, name)
        missing = values.size - int(np.count_nonzero(np.isfinite(values)))
        return ChannelSurvey(values.size, missing, {target: _moments(datasets, name, target) for target in targets})

    return [*map_in_order(survey, names)]


def _moments(datasets: Sequence[Dataset], name: str, target: str) -> JointMoments:
    both = [data for data in datasets if target in data]
    return JointMoments.of(scored_values(both, name), scored_values(both, target))


def scored_values(datasets: Sequence[Dataset], name: str) -> Float:
    """Return a channel at the scored samples of datasets, Float[samples]."""
    columns = [data[name].values if data.scored is None else data[name].values[data.scored] for data in datasets]
    return columns[0] if len(columns) == 1 else np.concatenate([np.zeros(0), *columns])
