"""Summary of a result in a sentence per criterion, and observations to read before it is used."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.markup import decimal, percent, quantity
from kennfeld.report.report_data import ReportData, Score

MAX_TEST_RATIO = 1.3  # of test to training error; above it the fit follows noise, or the test data extrapolate
MAX_BIAS = 0.3  # of the RMSE
MAX_OUTSIDE = 0.001  # share of samples outside the data of a surrogate; its own training data may reach it
MAX_DATASETS = 3  # named for each surrogate


@dataclass(frozen=True)
class Observation:
    """A sentence about the result, with its severity."""

    kind: Literal["good", "note", "warning"]
    text: str


def verdict(report: ReportData) -> str:
    """Return the result in one sentence per criterion."""
    # on all test data, or else on all training data
    scores = [pool_scores([s for s in own if s.use == "test"] or own) for own in by_criterion(report.scores)]
    if not scores:
        return "No sample is scored, so the errors are unknown."
    result = report.result
    if result is None:
        return f"Not calibrated yet. With the start values, {'; '.join(map(_error, scores))}."
    if result.status in ("failed", "infeasible"):
        return f"The calibration failed: {result.message} With the last values, {_error(scores[0])}."
    return " ".join(_sentence(score, unseen=not report.seen) for score in scores)


def by_criterion(scores: Sequence[Score]) -> list[list[Score]]:
    """Return the scores of each criterion."""
    return [[s for s in scores if s.number == number] for number in dict.fromkeys(s.number for s in scores)]


def pool_scores(scores: Sequence[Score]) -> Score:
    """Combine the scores of several datasets; R2 is unknown if there is more than one."""
    if len(scores) == 1:
        return scores[0]
    count = np.array([score.samples for score in scores], dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        # RMSEs are pooled by their squares
        before, after = np.sqrt(count @ np.array([s.rmse for s in scores]) ** 2 / count.sum()).tolist()
    largest_before, largest_after = np.max([s.largest for s in scores], axis=0).tolist()
    return replace(
        scores[0],
        dataset=f"{len(scores)} datasets",
        samples=int(count.sum()),
        rmse=(before, after),
        r2=(np.nan, np.nan),
        largest=(largest_before, largest_after),
    )


def _error(score: Score) -> str:
    if not np.isfinite(score.rmse[1]):
        return f"{score.criterion} is not finite for some of the {score.samples} samples of {score.use} data"
    return f"{_deviation(score)} (RMSE over {score.samples} samples of {score.use} data)"


def _deviation(score: Score) -> str:
    return f"{score.criterion} deviates from {score.target} by {quantity(score.rmse[1], score.unit)}"


def _sentence(score: Score, *, unseen: bool) -> str:
    before, after = score.rmse
    test = "On unseen test data" if unseen else "On test data, some of which are also training data"
    error = f"{test if score.use == 'test' else 'On the training data'}, {_deviation(score)} (RMSE"
    largest = f"at most {quantity(score.largest[1], score.unit)}."
    if not np.isfinite(before):
        return f"{error}), {largest}"
    change = 1.0 - after / before if before > 0 else 0.0
    if abs(change) < 0.005:
        return f"{error}), unchanged from the start values, {largest}"
    comparison = f"{percent(change)} less" if change > 0 else f"{percent(-change)} more"
    return f"{error}; before {quantity(before, score.unit)}, {comparison}), {largest}"


def observations(report: ReportData) -> list[Observation]:
    """Return what to know before the result is used, warnings first."""
    unsorted = [*_search(report), *_extrapolation(report), *_unseen_data(report), *_values(report), *_errors(report)]
    order = ("warning", "note", "good")
    return sorted(unsorted, key=lambda observation: order.index(observation.kind))


def _search(report: ReportData) -> Iterator[Observation]:
    result = report.result
    if result is None:
        return
    if result.status == "converged":
        yield Observation("good", f"The search converged: {result.message}")
    else:
        yield Observation("warning", f"The search ended with status {result.status}: {result.message}")
    yield from (Observation("warning", str(warning)) for warning in result.warnings)
    if report.stale:
        yield Observation(
            "warning",
            "The project or its data have changed since this result was written, so its errors cannot be reproduced. "
            "The tables of this report show the stored numbers, the figures show current ones. Calibrate again.",
        )


def _extrapolation(report: ReportData) -> Iterator[Observation]:
    for name in dict.fromkeys(row.name for row in report.extrapolation):
        rows = [row for row in report.extrapolation if row.name == name]
        outside = sorted((row for row in rows if row.worst is not None), key=lambda row: -row.share)
        if rows[0].outside is None:
            yield Observation("note", f"{rows[0]}, so extrapolation cannot be detected.")
        elif not outside:
            count = sum(row.samples for row in rows)
            yield Observation("good", f"{name} is used within its training data at all {count} samples.")
        for row in outside[:MAX_DATASETS]:
            frequent = row.share > MAX_OUTSIDE
            remedy = " Its output there is an extrapolation; add training data from this range." if frequent else ""
            yield Observation("warning" if frequent else "note", f"{row}.{remedy}")
        if more := outside[MAX_DATASETS:]:
            datasets = count_noun(len(more), "further dataset")
            yield Observation("note", f"{name} is used outside its training data on {datasets}.")


def _unseen_data(report: ReportData) -> Iterator[Observation]:
    if not any(score.use == "test" for score in report.scores):
        if report.validation is not None:
            yield from (Observation("note", text) for text in report.validation.conclusions())
        else:
            text = "There are no test data, so this report cannot show how the function generalises to unseen data."
            yield Observation("note", text)
        return
    if report.seen:
        yield from (Observation("warning", str(finding)) for finding in report.seen)
        return
    for scores in by_criterion(report.scores):
        training, test = ([s for s in scores if s.use == use] for use in ("training", "test"))
        if report.result is None or not training or not test:
            continue
        (before, fitted), (_, unseen) = pool_scores(training).rmse, pool_scores(test).rmse
        if fitted > before:
            continue  # nothing was learnt, noise included
        ratio = f"The RMSE of {scores[0].criterion} on test data is {{}} times that on training data: {{}}."
        if unseen > MAX_TEST_RATIO * fitted > 0:
            cause = "the tables follow noise, or the test data lie outside the range of the training data"
            yield Observation("warning", ratio.format(decimal(unseen / fitted, 2), cause))
        elif fitted > 0:
            consequence = "the calibration generalises to unseen data"
            yield Observation("good", ratio.format(decimal(unseen / fitted, 3), consequence))


def _values(report: ReportData) -> Iterator[Observation]:
    changes = report.changes
    empty, total = sum(int(c.uncovered.sum()) for c in changes), sum(c.after.size for c in changes)
    if empty:
        yield Observation(
            "note",
            f"Values without training data: {empty} of {total}. "
            "They are hatched below, and follow from smoothness or keep their start values.",
        )
    at_bound = sum(int(np.count_nonzero(c.bound)) for c in changes)
    if at_bound and report.result is not None:
        yield Observation("note", f"Values at a bound: {at_bound} of {total}.")
    null_space = report.trust.null_space
    if null_space:
        yield Observation("warning" if null_space.remedy else "note", null_space.sentence)
    if report.trust.directions and not (null_space and null_space.remedy):
        count = len(report.trust.directions)
        yield Observation(
            "warning",
            f"{count_noun(count, 'direction')} in parameter space {'is' if count == 1 else 'are'} poorly determined "
            "by the data; see Parameters not determined by the data.",
        )


def _errors(report: ReportData) -> Iterator[Observation]:
    if report.result is None:
        return
    rows = [(criterion, row) for criterion in report.residuals for row in criterion.summaries]
    for of, row in rows:
        if row.samples > 20 and abs(row.mean) > MAX_BIAS * row.rmse:
            bias = f"{quantity(abs(row.mean), of.unit)} too {'high' if row.mean > 0 else 'low'}"
            yield Observation("warning", f"On {row.dataset}, {of.criterion} is {bias} on average.")
        memory = row.autocorrelation
        if memory is not None and memory.independent < 0.5 * row.samples:
            yield Observation(
                "note",
                f"The errors of {of.criterion} on {row.dataset} are correlated in time: "
                f"{row.samples} samples count as {decimal(memory.independent, 2)} independent ones.",
            )
