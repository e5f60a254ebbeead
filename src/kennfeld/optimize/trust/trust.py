"""How far the values of a result can be trusted."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import ArgumentError
from kennfeld.formatting import nearest
from kennfeld.optimize.trust.active_limits import ActiveLimit
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.direction_text import Direction
from kennfeld.optimize.trust.null_space import NullSpace
from kennfeld.threads import blas_threads

__all__ = ["Trust"]


@dataclass(frozen=True, eq=False)
class Trust:
    """What the data determine of the free values; empty for a fit that failed, and where limits cannot be kept.

    Mappings are by parameter, arrays of the shape of its values; those of the noise are by criterion. Breakpoints that
    are fitted stand behind the parameters, by axis: `AxisSpeed` for a group axis, else `MapTorque.x`.

    Attributes:
        noise: standard deviation of the residuals in the target's unit, for the degrees of freedom that the fit used;
            under a robust loss, of the noise without outliers that would scatter the values as much; of samples with
            weights of their own, that of a sample of mean weight.
        persistence: samples in a row that count as one independent sample; 1 for steady-state data.
        freedom: degrees of freedom that the fit used, in effect the number of values that the data decide.
        informed: values that data or smoothness inform; the others keep their start.
        samples: training samples that touch each value.
        deviation: standard deviation of each value's error in its unit. 0 where a lock, a bound or a pin holds it, inf
            where nothing determines it, NaN where there are too few samples to tell the noise.
        scatter: the part of `deviation` that repeated measurements would show. Less than it where smoothness decides.
        by_smoothness: values that no sample touches and that smoothness holds.
        directions: common changes of values that the data do not see, or hardly; worst first.
        null_space: how many independent changes nothing determines, and values to hold that settle all of them.
        holdings: limits of outputs that are met, and what they hold; breakpoints at their least distance.
        remark: a sentence where the search did not come to its end; else empty.
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

    @cached_property
    def leverage(self) -> Mapping[str, Float]:
        """What each value takes of `freedom`: 1 where the data alone decide, 0 where smoothness or a limit does.

        Sums up to `freedom` over all values; see `Estimate.leverage`.
        """
        if self.estimate is None:
            return {}
        with blas_threads(self.estimate.seen.size):
            whole = self.estimate.leverage()
        return {name: whole[columns].reshape(self.deviation[name].shape) for name, columns in self._columns().items()}

    def covariance(self, names: Sequence[str] | None = None, *, scatter: bool = False) -> Float:
        """Covariances between values, shape (values, values).

        The values come parameter by parameter, in the order of `names` or else of `deviation`, each in C order (the
        last axis runs fastest). By default they are those of the errors, with `scatter` those that repeated
        measurements would show. An undetermined value has inf on the diagonal and NaN beside it.
        Raises `ArgumentError` for a name that is no free parameter.
        """
        columns = self._chosen(names)
        if self.estimate is None:
            return np.zeros((0, 0))
        with blas_threads(self.estimate.seen.size):
            found = self.estimate.covariance(scatter=scatter)[np.ix_(columns, columns)]
        open_values = self.estimate.undetermined[columns]
        found[open_values] = np.nan
        found[:, open_values] = np.nan
        found[open_values, open_values] = np.inf
        return found

    def correlation(self, names: Sequence[str] | None = None, *, scatter: bool = False) -> Float:
        """Correlations between values, in the order of `covariance`; NaN beside values held or undetermined."""
        covariance = self.covariance(names, scatter=scatter)
        deviation = np.sqrt(np.diag(covariance))
        usable = np.isfinite(deviation) & (deviation > 0)
        units = np.where(usable, deviation, np.nan)
        found: Float = np.clip(covariance / np.outer(units, units), -1.0, 1.0)
        np.fill_diagonal(found, 1.0)
        return found

    def __str__(self) -> str:
        values = 0 if self.estimate is None else self.estimate.reduction.size  # free breakpoints among them
        noise = [f"The noise of {name} is {value:.4g}." for name, value in self.noise.items()]
        decided = [f"The data decide {self.freedom:.1f} of {values} values."] if values else []
        remark = [self.remark] if self.remark else []
        whole = [str(self.null_space)] if self.null_space.sentence else []
        return "\n".join([*remark, *noise, *decided, *map(str, self.holdings), *whole, *map(str, self.directions)])

    def as_json(self) -> dict[str, Any]:
        """What `result.json` tells of it; numbers that are not finite, or where nothing is known, are None."""
        known = self.estimate is not None
        return {
            "noise": {name: _finite(value) for name, value in self.noise.items()},
            "persistence": {name: _finite(value) for name, value in self.persistence.items()},
            "freedom": _finite(self.freedom) if known else None,
            "undetermined": _counted(np.isinf(v) for v in self.deviation.values()) if known else None,
            "by_smoothness": _counted(self.by_smoothness.values()) if known else None,
            "null_space": self.null_space.as_json() if known else None,
            "directions": [
                {
                    "sentence": direction.sentence,
                    "remedy": direction.remedy,
                    "exact": direction.exact,
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

    def _chosen(self, names: Sequence[str] | None) -> Int:
        columns = self._columns()
        for name in names or ():
            if name not in columns:
                raise ArgumentError(f"{name} is no free parameter of this result. {nearest(name, columns)}".strip())
        parts = [columns[name] for name in (columns if names is None else names)]
        return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def _counted(marks: Iterable[Bool]) -> int:
    return sum(int(np.count_nonzero(each)) for each in marks)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
