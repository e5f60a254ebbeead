"""Summary of a result in a sentence per criterion, and remarks to read before it is used."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kennfeld.formatting import count_noun
from kennfeld.report.markup import percent, shown, with_unit
from kennfeld.report.report_data import ReportData, Score

MAX_TEST_RATIO = 1.3  # of test to training error; above it the fit follows noise, or the test data extrapolate
MAX_BIAS = 0.3  # of the RMSE
MAX_OUTSIDE = 0.001  # share of samples outside the data of a surrogate; its own training data may reach it
MAX_DATASETS = 3  # named for each surrogate


@dataclass(frozen=True)
class Remark:
    """A sentence about the result, with its severity."""

    kind: Literal["good", "note", "warning"]
    text: str


def verdict(report: ReportData) -> str:
    """Return the result in one sentence per criterion."""
    scores = _score_per_criterion(report.scores)
    if not scores:
        return "No sample is scored, so the errors are unknown."
    result = report.result
    if result is None:
        errors = "; ".join(_error(score) for score in scores)
        return f"Not calibrated yet. With the start values, {errors}."
    if result.status in ("failed", "infeasible"):
        return f"The calibration failed: {result.message} With the last values, {_error(scores[0])}."
    unseen = not report.seen
    return " ".join(_sentence(score, unseen=unseen) for score in scores)


def _score_per_criterion(scores: Sequence[Score]) -> list[Score]:
    """Return one score per criterion: on all test data, or else on all training data."""
    test = [score for score in scores if score.use == "test"]
    numbers = dict.fromkeys(score.number for score in scores)
    return [pooled([s for s in test if s.number == n] or [s for s in scores if s.number == n]) for n in numbers]


def pooled(scores: Sequence[Score]) -> Score:
    """Combine the scores of several datasets; R2 is unknown if there is more than one."""
    count = np.array([score.samples for score in scores], dtype=np.float64)
    first = scores[0]
    if len(scores) == 1:
        return first
    with np.errstate(over="ignore", invalid="ignore"):
        rmse = np.sqrt(count @ np.array([s.rmse for s in scores]) ** 2 / count.sum())
    largest = np.max([s.largest for s in scores], axis=0)
    return replace(
        first,
        dataset=f"{len(scores)} datasets",
        samples=int(count.sum()),
        rmse=(float(rmse[0]), float(rmse[1])),
        r2=(float("nan"), float("nan")),
        largest=(float(largest[0]), float(largest[1])),
    )


def _error(score: Score) -> str:
    if not np.isfinite(score.rmse[1]):
        return f"{score.criterion} is not finite for some of the {score.samples} samples of {score.use} data"
    error = f"{score.criterion} deviates from {score.target} by {with_unit(score.rmse[1], score.unit)}"
    return f"{error} (RMSE over {score.samples} samples of {score.use} data)"


def _sentence(score: Score, *, unseen: bool) -> str:
    before, after = score.rmse
    test = "On unseen test data" if unseen else "On test data, some of which are also training data"
    where = test if score.use == "test" else "On the training data"
    now = f"{score.criterion} deviates from {score.target} by {with_unit(after, score.unit)}"
    largest = f"at most {with_unit(score.largest[1], score.unit)}"
    if not np.isfinite(before):
        return f"{where}, {now} (RMSE), {largest}."
    change = 1.0 - after / before if before > 0 else 0.0
    if abs(change) < 0.005:
        return f"{where}, {now} (RMSE), unchanged from the start values, {largest}."
    comparison = f"{percent(change)} less" if change > 0 else f"{percent(-change)} more"
    return f"{where}, {now} (RMSE; before {with_unit(before, score.unit)}, {comparison}), {largest}."


def remarks(report: ReportData) -> list[Remark]:
    """Return what to know before the result is used, warnings first."""
    unsorted = [*_search(report), *_extrapolation(report), *_data_remarks(report), *_values(report), *_errors(report)]
    order = ("warning", "note", "good")
    return sorted(unsorted, key=lambda remark: order.index(remark.kind))


def _search(report: ReportData) -> Iterator[Remark]:
    result = report.result
    if result is None:
        return
    if result.status == "converged":
        yield Remark("good", f"The search converged: {result.message}")
    else:
        yield Remark("warning", f"The search ended with status {result.status}: {result.message}")
    for warning in result.warnings:
        yield Remark("warning", str(warning))
    if report.stale:
        yield Remark(
            "warning",
            "The project or its data have changed since this result was written, so its errors cannot be reproduced. "
            "The tables of this report show the stored numbers, the figures show current ones. Calibrate again.",
        )


def _extrapolation(report: ReportData) -> Iterator[Remark]:
    for name in dict.fromkeys(row.name for row in report.extrapolation):
        rows = [row for row in report.extrapolation if row.name == name]
        outside = sorted((row for row in rows if row.worst is not None), key=lambda row: -row.share)
        if rows[0].outside is None:
            yield Remark("note", f"{rows[0]}, so extrapolation cannot be detected.")
        elif not outside:
            count = sum(row.samples for row in rows)
            yield Remark("good", f"{name} is used within its training data at all {count} samples.")
        for row in outside[:MAX_DATASETS]:
            frequent = row.share > MAX_OUTSIDE
            remedy = " Its output there is an extrapolation; add training data from this range." if frequent else ""
            yield Remark("warning" if frequent else "note", f"{row}.{remedy}")
        if len(outside) > MAX_DATASETS:
            more = len(outside) - MAX_DATASETS
            yield Remark("note", f"{name} is used outside its training data on {count_noun(more, 'further dataset')}.")


def _data_remarks(report: ReportData) -> Iterator[Remark]:
    if not any(score.use == "test" for score in report.scores):
        yield Remark(
            "note",
            "There are no test data, so this report cannot show how the function generalises to unseen data.",
        )
        return
    if report.seen:
        yield from (Remark("warning", str(finding)) for finding in report.seen)
        return
    for number in dict.fromkeys(score.number for score in report.scores):
        scores = [score for score in report.scores if score.number == number]
        training, test = ([s for s in scores if s.use == use] for use in ("training", "test"))
        if report.result is None or not training or not test:
            continue
        criterion = scores[0].criterion
        (before, fitted), (_, unseen) = pooled(training).rmse, pooled(test).rmse
        if fitted > before:
            continue  # nothing was learnt, noise included
        ratio = f"The RMSE of {criterion} on test data is {{}} times that on training data"
        if unseen > MAX_TEST_RATIO * fitted > 0:
            cause = "the tables follow noise, or the test data lie outside the range of the training data"
            yield Remark("warning", f"{ratio.format(shown(unseen / fitted, 2))}: {cause}.")
        elif fitted > 0:
            yield Remark(
                "good",
                f"{ratio.format(shown(unseen / fitted, 3))}: the calibration generalises to unseen data.",
            )


def _values(report: ReportData) -> Iterator[Remark]:
    changes = report.changes
    empty, total = sum(int(c.uncovered.sum()) for c in changes), sum(c.after.size for c in changes)
    if empty:
        yield Remark(
            "note",
            f"Values without training data: {empty} of {total}. "
            "They are hatched below, and follow from smoothness or keep their start values.",
        )
    at_bound = sum(int(np.count_nonzero(c.bound)) for c in changes)
    if at_bound and report.result is not None:
        yield Remark("note", f"Values at a bound: {at_bound} of {total}.")
    null_space = report.trust.null_space
    if null_space:
        yield Remark("warning" if null_space.remedy else "note", null_space.sentence)
    if report.trust.directions and not (null_space and null_space.remedy):
        count = len(report.trust.directions)
        yield Remark(
            "warning",
            f"{count_noun(count, 'direction')} in parameter space {'is' if count == 1 else 'are'} poorly determined "
            "by the data; see Parameters not determined by the data.",
        )


def _errors(report: ReportData) -> Iterator[Remark]:
    if report.result is None:
        return
    for of in report.residuals:
        for row in of.summaries:
            if row.samples > 20 and abs(row.mean) > MAX_BIAS * row.rmse:
                yield Remark(
                    "warning",
                    f"On {row.dataset}, {of.criterion} is {with_unit(abs(row.mean), of.unit)} too "
                    f"{'high' if row.mean > 0 else 'low'} on average.",
                )
            memory = row.autocorrelation
            if memory is not None and memory.independent < 0.5 * row.samples:
                yield Remark(
                    "note",
                    f"The errors of {of.criterion} on {row.dataset} are correlated in time: "
                    f"{row.samples} samples count as {shown(memory.independent, 2)} independent ones.",
                )
