"""The result of a cross-validation: the errors of every fold, and what they say about overfitting."""

from collections.abc import Iterator, Mapping
from typing import Any, Literal, Self

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.base.numeric import finite_or_none

Kind = Literal["auto", "files", "blocks", "random"]  # how folds are formed

MAX_RATIO = 1.3  # of the RMSE on held-out data to that in training; above it the fit follows noise


@dataclass(frozen=True)
class FoldQuality:
    """One criterion in one fold, in the unit of its target; `samples` counts those held out and scored."""

    fold: int
    held: str
    criterion: str
    samples: int
    rmse_training: float
    rmse_held: float
    status: str


@dataclass(frozen=True)
class CrossValidation(NotebookDisplay):
    """The errors of a cross-validation, by fold and criterion.

    Attributes:
        folds: a row for each fold and criterion: its number, the held-out data, samples, and RMSE on both sides.

    >>> from kennfeld import cross_validate
    >>> data = {"x": [0.0, 1.0, 2.0, 3.0], "z": [0.0, 2.0, 4.0, 6.0]}
    >>> validation = cross_validate("y = k * x", data, {"k": 1.0}, target="z", folds=2)
    >>> len(validation.folds), round(validation.mean("y"), 9)
    (2, 0.0)
    """

    folds: tuple[FoldQuality, ...]

    @property
    def criteria(self) -> tuple[str, ...]:
        """The criteria, in their order."""
        return tuple(dict.fromkeys(row.criterion for row in self.folds))

    def mean(self, criterion: str) -> float:
        """Return the mean RMSE on held-out data; NaN if no fold was scored."""
        errors = self._held_out(criterion)
        return float(np.mean(errors)) if errors else float("nan")

    def spread(self, criterion: str) -> float:
        """Return the standard deviation of the RMSE over the folds; NaN for fewer than two."""
        errors = self._held_out(criterion)
        return float(np.std(errors, ddof=1)) if len(errors) > 1 else float("nan")

    def training(self, criterion: str) -> float:
        """Return the mean RMSE on the fitted data."""
        errors = [row.rmse_training for row in self.folds if row.criterion == criterion]
        return float(np.mean(errors)) if errors else float("nan")

    def _held_out(self, criterion: str) -> list[float]:
        return [row.rmse_held for row in self.folds if row.criterion == criterion and row.samples]

    def conclusions(self) -> list[str]:
        """Return what the errors say about overfitting, one or more sentences for each criterion."""
        texts = [self._conclusion(name) for name in self.criteria]
        unfinished = {row.fold: row.status for row in self.folds if row.status != "converged"}
        if unfinished:
            names = ", ".join(f"{fold} ({status})" for fold, status in unfinished.items())
            texts.append(f"Not converged: fold {names}. Their errors say less.")
        return texts

    def _conclusion(self, criterion: str) -> str:
        held, training = self.mean(criterion), self.training(criterion)
        if not (np.isfinite(held) and training > 0):
            return f"The errors of {criterion} on held-out data do not compare with those in training."
        ratio = f"The RMSE of {criterion} on held-out data is {held / training:.3g} times that in training"
        if held <= MAX_RATIO * training:
            return f"{ratio}: no sign of overfitting."
        scored = [row for row in self.folds if row.criterion == criterion and row.samples]
        worst = max(scored, key=lambda row: row.rmse_held)
        others = [row.rmse_held for row in scored if row is not worst]
        if others and max(others) <= MAX_RATIO * training:
            return f"{ratio}, because of fold {worst.fold} ({worst.held}) alone: the other folds do not represent it."
        return (
            f"{ratio}: the fit follows its training data more than they can support. "
            "Use more smoothness, fewer values, or more data, or look for an effect that the function lacks."
        )

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Self:
        """Return what `as_json` wrote; raises `KeyError` or `TypeError` if it did not."""
        rows: Iterator[dict[str, Any]] = (
            {name: np.nan if value is None else value for name, value in row.items()} for row in content["folds"]
        )
        return cls(tuple(FoldQuality(**row) for row in rows))

    def as_json(self) -> dict[str, Any]:
        """Return the contents of `cross_validation.json`; numbers that are not finite are None."""
        return {
            "folds": [{name: finite_or_none(value) for name, value in vars(row).items()} for row in self.folds],
            "summary": [
                {
                    "criterion": name,
                    "rmse_training": finite_or_none(self.training(name)),
                    "rmse_held": finite_or_none(self.mean(name)),
                    "spread": finite_or_none(self.spread(name)),
                }
                for name in self.criteria
            ],
        }

    def table(self) -> list[tuple[str, ...]]:
        """Return the folds as rows of text with a heading."""
        head = ("fold", "held out", "criterion", "samples", "RMSE training", "RMSE held out", "status")
        rows = [
            (
                *(str(row.fold), row.held, row.criterion, str(row.samples)),
                *(f"{value:#.4g}" for value in (row.rmse_training, row.rmse_held)),
                row.status,
            )
            for row in self.folds
        ]
        return [head, *rows]

    def summary(self) -> list[str]:
        """Return a sentence for each criterion."""
        return [
            f"{name}: RMSE {self.mean(name):#.4g} +- {self.spread(name):#.2g} on held-out data, "
            f"{self.training(name):#.4g} in training"
            for name in self.criteria
        ]

    def __str__(self) -> str:
        table = self.table()
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
        return "\n".join([*lines, *self.summary()])
