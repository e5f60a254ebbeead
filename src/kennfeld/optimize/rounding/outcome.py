"""Errors of a calibration before and after rounding to storable values, and the share of each label."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from typing import Any

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import finite_or_none
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import RoundingMethod
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.quality.recording_quality import error_text

ERRORS = ("unrounded", "nearest", "joint")
LARGE_SHARE = 0.2  # of the loss, from which a label would profit from finer storage
NOTICEABLE = 1.005  # RMSE on training data, relative to the unrounded one, below which no label is named
COARSE_BITS = 8  # a label with more bits profits little from still more


@dataclass(frozen=True)
class LabelRounding:
    """The rounding of one parameter, or of the breakpoints of one axis.

    Attributes:
        name: the parameter, or the axis: `AxisSpeed`, `MapTorque.x`.
        step: distance of storable values, in the unit of the label.
        bits: of a stored number; 0 if unknown.
        values: number of rounded values.
        moved: values that are not the storable ones nearest to the fit.
        largest_shift: the largest distance from the fit, in steps.
        share: the part of the loss that would vanish if this label alone were stored without steps.
    """

    name: str
    step: float
    bits: int
    values: int
    moved: int
    largest_shift: float
    share: float

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "labels" in `result.json`."""
        return {key: finite_or_none(value) for key, value in vars(self).items() if key != "name"}


@dataclass(frozen=True)
class RoundingResult:
    """The errors of a calibration before and after rounding, and what each label contributes.

    Attributes:
        method: the rounding that the result has, "joint" or "nearest".
        max_shift: the largest distance from the fit that was allowed, in steps.
        unrounded: RMSE of the fit by `criterion/dataset`, in the unit of the target.
        nearest: the same if each value is rounded on its own.
        joint: the same if all values are rounded together.
        labels: the rounded parameters and axes.
        finer: the label that would profit most from finer storage; empty if none stands out.
        fit: the values before rounding; None if the result was read from a file.
    """

    method: RoundingMethod
    max_shift: float
    unrounded: Mapping[str, float]
    nearest: Mapping[str, float]
    joint: Mapping[str, float]
    labels: tuple[LabelRounding, ...] = ()
    finer: str = ""
    fit: ParameterSet | None = field(default=None, compare=False, repr=False)

    def as_json(self) -> dict[str, Any]:
        """Return "rounding" of `result.json`."""
        errors = {key: _finite(getattr(self, key)) for key in ERRORS}
        labels = {label.name: label.as_json() for label in self.labels}
        return {"method": self.method, "max_shift": self.max_shift, **errors, "labels": labels, "finer": self.finer}

    def table(self) -> list[tuple[str, ...]]:
        """Return the RMSE of each criterion and dataset as rows of text with a heading."""
        rows = [
            (key, *(error_text(errors[key]) for errors in (self.unrounded, self.nearest, self.joint)))
            for key in self.unrounded
        ]
        return [("Rounded to storage: RMSE", "unrounded", "nearest", "joint"), *rows]

    def label_table(self) -> list[tuple[str, ...]]:
        """Return the labels as rows of text with a heading, those with the largest share first."""
        head = ("label", "step", "bits", "values", "not the nearest", "largest shift", "share of the loss")
        ordered = sorted(self.labels, key=lambda label: -label.share)
        return [
            head,
            *(
                (
                    label.name,
                    f"{label.step:.6g}",
                    str(label.bits or "-"),
                    str(label.values),
                    str(label.moved),
                    f"{label.largest_shift:.2f} steps",
                    _percent(label.share),
                )
                for label in ordered
            ),
        ]

    def advice(self) -> list[str]:
        """Return a sentence on the label that would profit most from finer storage; nothing if none does."""
        if not self.finer:
            return []
        label = next(label for label in self.labels if label.name == self.finer)
        storage = "16 bit" if label.bits == COARSE_BITS else "a finer step"
        share = f"its step causes {_percent(label.share)} of what rounding costs"
        return [f"{label.name} would profit most from {storage}: {share}."]


def errors_by_criterion(quality: Iterable[Quality]) -> dict[str, float]:
    """Return the RMSE after by `criterion/dataset`; criteria on the same node are numbered from the second one on."""
    errors: dict[str, float] = {}
    for row in quality:
        if row.samples:
            key, number = f"{row.criterion}/{row.dataset}", 2
            while key in errors:
                key, number = f"{row.criterion} ({number})/{row.dataset}", number + 1
            errors[key] = row.rmse_after
    return errors


def finer_label(labels: Sequence[LabelRounding], before: Iterable[Quality], after: Iterable[Quality]) -> str:
    """Return the label that would profit most from finer storage; empty if rounding costs little, or all share it."""
    pairs = [(old, new) for old, new in zip(before, after, strict=True) if old.use == "training" and old.samples]
    noticed = any(new.rmse_after > NOTICEABLE * old.rmse_after for old, new in pairs)
    coarse = [label for label in labels if label.bits <= COARSE_BITS and label.share >= LARGE_SHARE]
    return max(coarse, key=lambda label: label.share).name if noticed and coarse else ""


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _finite(errors: Mapping[str, float]) -> dict[str, Any]:
    return {key: finite_or_none(value) for key, value in errors.items()}
