"""Uncertainty of the values of a result."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import nearest
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.base.threads import blas_threads
from kennfeld.optimize.trust.active_limits import ActiveLimit
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.direction_text import Direction
from kennfeld.optimize.trust.null_space import NullSpace

_MAPPINGS = ("noise", "persistence", "informed", "samples", "deviation", "scatter", "by_smoothness", "columns")


@dataclass(frozen=True, eq=False)
class Trust(NotebookDisplay):
    """Uncertainty of the free values of a fit; empty if the fit failed or its limits cannot be satisfied.

    Mappings are by parameter, with arrays in the shape of its values; `noise` and `persistence` are by criterion.
    Fitted breakpoints follow the parameters, by axis: `AxisSpeed` for a group axis, else `MapTorque.x`.

    Attributes:
        noise: standard deviation of the residuals in the unit of the target, for the degrees of freedom that the fit
            used. With a robust loss, that of outlier-free noise which would scatter the values as much; with sample
            weights, that of a sample of mean weight.
        persistence: number of consecutive samples worth one independent sample; 1 for steady-state data.
        freedom: degrees of freedom used by the fit, the effective number of values determined by the data.
        informed: True for values determined by data or smoothness; the others keep their start values.
        samples: number of training samples that influence each value.
        deviation: standard deviation of the error of each value in its unit. 0 for values fixed by a lock, a bound or
            a pin, inf for undetermined values, NaN if there are too few samples to estimate the noise. It includes the
            distance to a second minimum that fits about as well, see `directions`.
        scatter: the part of `deviation` that repeated measurements would show; smaller for values determined by
            smoothness.
        by_smoothness: True for values that no sample influences and smoothness determines.
        directions: joint changes of values with no or almost no effect on the data, worst first; those that are
            coupled, but determined, last. A second minimum with the same cost is one of them.
        null_space: number of undetermined combinations of values, and values to fix that determine all of them.
        holdings: active limits of outputs and what they determine; breakpoints at their minimum distance.
        remark: a sentence if the search did not converge, else empty.
        columns: by name, the first column of its values in `covariance`.
        estimate: what `covariance` and `leverage` are computed from.

    >>> from kennfeld import calibrate
    >>> data = {"x": [1.0, 2.0, 3.0], "m": [2.1, 3.9, 6.0]}
    >>> trust = calibrate("y = a * b * x", data, {"a": 1.0, "b": 1.0}, target="m").trust
    >>> trust.null_space.dimension, trust.directions[0].sentence
    (1, 'Scaling a by 1.01 and b by 1/1.01 has no effect on the fit.')
    """

    noise: Mapping[str, float] = field(default_factory=dict)
    persistence: Mapping[str, float] = field(default_factory=dict)
    freedom: float = 0.0
    informed: Mapping[str, Bool] = field(default_factory=dict)
    samples: Mapping[str, Int] = field(default_factory=dict)
    deviation: Mapping[str, Float] = field(default_factory=dict)
    scatter: Mapping[str, Float] = field(default_factory=dict)
    by_smoothness: Mapping[str, Bool] = field(default_factory=dict)
    directions: tuple[Direction, ...] = ()
    null_space: NullSpace = field(default_factory=NullSpace)
    holdings: tuple[ActiveLimit, ...] = ()
    remark: str = ""
    estimate: Estimate | None = field(default=None, repr=False)
    columns: Mapping[str, int] = field(default_factory=dict, repr=False)  # of a parameter's first value

    def __post_init__(self) -> None:
        for name in _MAPPINGS:
            object.__setattr__(self, name, FrozenDict(getattr(self, name)))

    @cached_property
    def leverage(self) -> Mapping[str, Float]:
        """Share of each value in `freedom`: 1 if the data alone determine it, 0 if smoothness or a limit does.

        The sum over all values is `freedom`; see `Estimate.leverage`.
        """
        if self.estimate is None:
            return {}
        with blas_threads(self.estimate.seen.size):
            leverage = self.estimate.leverage()
        return {name: leverage[at].reshape(self.deviation[name].shape) for name, at in self._columns().items()}

    def covariance(self, names: Sequence[str] | None = None, *, scatter: bool = False) -> Float:
        """Return the covariance matrix of the values.

        Args:
            names: parameters in the order of rows and columns, each in C order; by default the order of `deviation`.
            scatter: return the covariance that repeated measurements would show instead of that of the errors.

        Returns:
            Array of shape (values, values), in the product of the units of the values. The row and the column of an
            undetermined value are NaN, with inf on the diagonal.

        Raises:
            ArgumentError: a name is not a free parameter.
        """
        own = self._columns()
        for name in names or ():
            if name not in own:
                raise ArgumentError(f"{name} is not a free parameter of this result. {nearest(name, own)}".strip())
        if self.estimate is None:
            return np.zeros((0, 0))
        chosen = [own[name] for name in (own if names is None else names)]
        columns = np.concatenate([np.zeros(0, dtype=np.int64), *chosen])
        with blas_threads(self.estimate.seen.size):
            covariance: Float = self.estimate.covariance(scatter=scatter)[np.ix_(columns, columns)]
        undetermined = self.estimate.undetermined[columns]
        covariance[undetermined] = np.nan
        covariance[:, undetermined] = np.nan
        covariance[undetermined, undetermined] = np.inf
        return covariance

    def correlation(self, names: Sequence[str] | None = None, *, scatter: bool = False) -> Float:
        """Return the correlation matrix of the values, in the order of `covariance`.

        Args:
            names: see `covariance`.
            scatter: see `covariance`.

        Returns:
            Array of shape (values, values), from -1 to 1; NaN for fixed and undetermined values.

        Raises:
            ArgumentError: a name is not a free parameter.
        """
        covariance = self.covariance(names, scatter=scatter)
        deviation = np.sqrt(np.diag(covariance))
        usable = np.isfinite(deviation) & (deviation > 0)
        # fixed values have a deviation of 0, undetermined ones inf
        units = np.where(usable, deviation, np.nan)
        correlation: Float = np.clip(covariance / np.outer(units, units), -1.0, 1.0)
        np.fill_diagonal(correlation, 1.0)
        return correlation

    def __str__(self) -> str:
        values = 0 if self.estimate is None else self.estimate.reduction.size  # free breakpoints among them
        noise = [f"The noise of {name} is {value:.4g}." for name, value in self.noise.items()]
        freedom = f"The data determine {self.freedom:.1f} of {values} values." if values else ""
        null_space = str(self.null_space) if self.null_space.sentence else ""
        lines = [self.remark, *noise, freedom, *map(str, self.holdings), null_space, *map(str, self.directions)]
        return "\n".join(line for line in lines if line)

    def as_json(self) -> dict[str, Any]:
        """Return the entry `trust` of `result.json`; numbers that are unknown or not finite are None."""
        known = self.estimate is not None
        return {
            "noise": {name: _finite(value) for name, value in self.noise.items()},
            "persistence": {name: _finite(value) for name, value in self.persistence.items()},
            "freedom": _finite(self.freedom) if known else None,
            "undetermined": _count_true(np.isinf(v) for v in self.deviation.values()) if known else None,
            "by_smoothness": _count_true(self.by_smoothness.values()) if known else None,
            "null_space": self.null_space.as_json() if known else None,
            "directions": [
                {
                    "sentence": direction.sentence,
                    "remedy": direction.remedy,
                    "exact": direction.exact,
                    "determined": direction.determined,
                    "ratio": _finite(direction.ratio),
                    "parameters": list(direction.parts),
                }
                for direction in self.directions
            ],
            "holdings": [vars(holding) | {"parameters": list(holding.parameters)} for holding in self.holdings],
            "remark": self.remark,
        }

    def _columns(self) -> dict[str, Int]:
        return {name: at + np.arange(self.deviation[name].size) for name, at in self.columns.items()}


def _count_true(marks: Iterable[Bool]) -> int:
    return sum(int(np.count_nonzero(each)) for each in marks)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
