"""Comparison of the deviations that a design predicted with those of a fit with the measured data."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import finite_or_none, nested_or_none
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.predicted_estimate import deviations
from kennfeld.design.value_text import ValueNames
from kennfeld.optimize.fit.result import aligned

TOLERATED = 1.1  # deviation relative to the predicted one that counts as reached
SAME_NOISE = 1.1  # ratio of noises that is not worth a sentence
MOST_NAMED = 5  # values that fall short
PLACE = Location("design")


@dataclass(frozen=True)
class ParameterComparison:
    """The deviations of one parameter: medians over its values with a finite prediction.

    Attributes:
        parameter: its name.
        values: number of values with a finite prediction.
        before: standard deviation when the design was made; inf if undetermined.
        predicted: with the points or segments of the design.
        reached: of the fit with the measured data.
        missed: number of values whose deviation is more than 10 % above the predicted one.
    """

    parameter: str
    values: int
    before: float
    predicted: float
    reached: float
    missed: int


@dataclass(frozen=True, eq=False)
class DesignComparison:
    """Deviations that a design predicted, beside those that were reached.

    Attributes:
        rows: the parameters.
        noise: by node, the noise of the fit relative to that when the design was made.
        missed: the values that fall short of the prediction, the worst first, with both deviations.
        within: number of them that are within the range of the prediction, as it depended on values not yet known.
        reached: standard deviation of each value now, by parameter.
        findings: warnings.
    """

    rows: tuple[ParameterComparison, ...]
    noise: Mapping[str, float]
    missed: tuple[str, ...]
    reached: Mapping[str, Float]
    findings: tuple[Finding, ...] = ()
    within: int = 0

    def table(self) -> list[tuple[str, ...]]:
        """Return the parameters as rows of text with a heading."""
        head = ("parameter", "values", "before", "predicted", "reached", "ratio")
        rows = [
            (row.parameter, str(row.values), *map(_text, (row.before, row.predicted, row.reached)), _ratio(row))
            for row in self.rows
        ]
        return [head, *rows]

    def summary(self) -> list[str]:
        """Return what was reached, a sentence a line."""
        values, missed = (
            sum(numbers) for numbers in zip(*((row.values, row.missed) for row in self.rows), strict=True)
        )
        lines = [f"{values - missed} of {count_noun(values, 'value')} are determined as well as predicted, to 10 %."]
        if self.missed:
            more = missed - len(self.missed[:MOST_NAMED])
            others = f", and {more} more" if more > 0 else ""
            lines.append(f"Furthest from it: {join_names(list(self.missed[:MOST_NAMED]))}{others}.")
        if self.within:
            lines.append(f"{self.within} of these {missed} are within the range of the prediction.")
        for node, ratio in self.noise.items():
            if not 1 / SAME_NOISE < ratio < SAME_NOISE:
                lines.append(
                    f"The noise of {node} is {ratio:.2f} times that of the prediction, which scales all deviations."
                )
        return lines

    def as_json(self) -> dict[str, Any]:
        """Return the content of `kennfeld design --compare --json`; numbers that are not finite are None."""
        rows = [{name: finite_or_none(value) for name, value in vars(row).items()} for row in self.rows]
        return {
            "parameters": rows,
            "noise": {node: finite_or_none(ratio) for node, ratio in self.noise.items()},
            "missed": list(self.missed),
            "within": self.within,
            "deviation": {name: nested_or_none(values) for name, values in self.reached.items()},
            "sentences": self.summary(),
            "findings": [str(finding) for finding in self.findings],
        }

    def __str__(self) -> str:
        return "\n".join([*aligned(self.table()), *self.summary()])


def compare(
    before: Mapping[str, Float],
    predicted: Mapping[str, Float],
    noise: Mapping[str, float],
    fitted: FittedFunction,
    most: Mapping[str, Float] | None = None,
) -> DesignComparison:
    """Compare the deviations of a fit with predicted ones.

    Args:
        before: standard deviation of each value when the design was made, by parameter.
        predicted: the same with what was to be measured.
        noise: of each node then.
        fitted: the fit with the measured data.
        most: the greatest deviation of each value that was predicted.

    Raises:
        InputError: no parameter has a prediction, or one has another number of values now.
    """
    reached = deviations(fitted)
    names = [name for name in predicted if name in reached and np.isfinite(predicted[name]).any()]
    if not names:
        message = "the design predicts no deviation of a parameter of this fit"
        raise InputError.of(PLACE, message, "Save a design around a fit as .json, and name that file.")
    equal = _of_equal_shape(names, predicted, reached)
    # a value for each recording, of which there are more now, is compared with nothing
    findings = [
        replace(_other_shape(name, predicted, reached), severity="remark") for name in names if name not in equal
    ]
    names = equal
    if all(np.array_equal(before[name], reached[name]) for name in names):
        message = "the deviations are those before the design"
        remedy = "Add the measured data to the training data."
        findings.append(Finding(PLACE, message, remedy, severity="warning"))
    now = fitted.trust.noise
    return DesignComparison(
        tuple(_row(name, before[name], predicted[name], reached[name]) for name in names),
        {node: now[node] / then for node, then in noise.items() if node in now and then > 0},
        tuple(_shortfalls(names, predicted, reached, fitted)),
        reached,
        tuple(findings),
        sum(_within(predicted[name], most[name], reached[name]) for name in names if most and name in most),
    )


def _within(predicted: Float, most: Float, reached: Float) -> int:
    """Count the values that fall short of the prediction, but not of the greatest deviation."""
    return int(np.sum((reached > TOLERATED * predicted) & (reached <= TOLERATED * most)))


def _of_equal_shape(names: list[str], predicted: Mapping[str, Float], reached: Mapping[str, Float]) -> list[str]:
    """Return the parameters with as many values as in the design, of which there must be one."""
    equal = [name for name in names if predicted[name].shape == reached[name].shape]
    if equal:
        return equal
    raise InputError([_other_shape(name, predicted, reached) for name in names])


def _other_shape(name: str, predicted: Mapping[str, Float], reached: Mapping[str, Float]) -> Finding:
    message = f"has the shape {list(reached[name].shape)}, but {list(predicted[name].shape)} in the design"
    return Finding(Location(name), message)


def _row(name: str, before: Float, predicted: Float, reached: Float) -> ParameterComparison:
    known = np.isfinite(predicted)
    then, promised, now = (float(np.median(each[known])) for each in (before, predicted, reached))
    missed = int(np.sum(reached[known] > TOLERATED * predicted[known]))
    return ParameterComparison(name, int(known.sum()), then, promised, now, missed)


def _shortfalls(
    names: list[str], predicted: Mapping[str, Float], reached: Mapping[str, Float], fitted: FittedFunction
) -> Iterator[str]:
    """Yield the values whose deviation is above the predicted one, the worst first."""
    words, located = ValueNames(fitted), list[tuple[float, int, float, float]]()
    for name in names:
        first, _ = fitted.blocks[name]
        for at, (then, now) in enumerate(
            zip(predicted[name].ravel().tolist(), reached[name].ravel().tolist(), strict=True)
        ):
            if np.isfinite(then) and now > TOLERATED * then:
                located.append((-now / then if then > 0 else -np.inf, first + at, then, now))
    for _, at, then, now in sorted(located):
        yield f"{words.name(at)}: {_text(now)} instead of {_text(then)}"


def _text(deviation: float) -> str:
    return f"{deviation:.3g}" if np.isfinite(deviation) else "undetermined"


def _ratio(row: ParameterComparison) -> str:
    return f"{row.reached / row.predicted:.2f}" if np.isfinite(row.reached) and row.predicted > 0 else "-"
