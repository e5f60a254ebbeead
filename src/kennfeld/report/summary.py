"""What a result is worth, in one sentence, and what to know before it is used."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kennfeld.report.markup import percent, shown, with_unit
from kennfeld.report.report_data import ReportData, Score

__all__ = ["pooled", "remarks", "verdict"]

TUNED = 1.3  # ratio of test to training error from which a fit has learnt the data, or the test covers other ground
BIASED = 0.3  # of the RMSE
RARE = 0.001  # share of the samples outside the data of a surrogate, which its own training data may reach
MOST_LEFT = 3  # datasets named for each surrogate


@dataclass(frozen=True)
class Remark:
    """Something to know; `good` news, a mere `note`, or a `warning`."""

    kind: Literal["good", "note", "warning"]
    text: str


def verdict(subject: ReportData) -> str:
    """The result in a sentence or two."""
    judged = _judged(subject.scores)
    if not judged:
        return "No sample is scored, so nothing can be said about the errors."
    result = subject.result
    if result is None:
        said = "; ".join(_missing(score) for score in judged)
        return f"Nothing has been calibrated yet. With the start, {said}."
    if result.status in ("failed", "infeasible"):
        return f"The calibration failed: {result.message} With the values it ended at, {_missing(judged[0])}."
    unseen = not subject.seen
    return " ".join(_sentence(score, unseen=unseen) for score in judged)


def _judged(scores: Sequence[Score]) -> list[Score]:
    """One score a criterion: on all test data, or else on all training data."""
    test = [score for score in scores if score.use == "test"]
    found = []
    for number in dict.fromkeys(score.number for score in scores):
        mine = [s for s in test if s.number == number] or [s for s in scores if s.number == number]
        found.append(pooled(mine))
    return found


def pooled(scores: Sequence[Score]) -> Score:
    """Several datasets as one; R2 is that of a single one, else unknown."""
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


def _missing(score: Score) -> str:
    if not np.isfinite(score.rmse[1]):
        return f"{score.criterion} gives no finite number for some of the {score.samples} samples of {score.use} data"
    error = f"{score.criterion} deviates from {score.target} by {with_unit(score.rmse[1], score.unit)}"
    return f"{error} (RMSE over {score.samples} samples of {score.use} data)"


def _sentence(score: Score, *, unseen: bool) -> str:
    before, after = score.rmse
    test = "On data that the fit has not seen" if unseen else "On test data, some of which the fit has seen"
    where = test if score.use == "test" else "On the data it was fitted to"
    now = f"{score.criterion} deviates from {score.target} by {with_unit(after, score.unit)}"
    most = f"by at most {with_unit(score.largest[1], score.unit)}"
    if not np.isfinite(before):
        return f"{where}, {now} (RMSE), {most}."
    change = 1.0 - after / before if before > 0 else 0.0
    if abs(change) < 0.005:
        return f"{where}, nothing has improved: {now} (RMSE), as with the start, {most}."
    how = f"{percent(change)} less" if change > 0 else f"{percent(-change)} more"
    return f"{where}, {now} (RMSE; before {with_unit(before, score.unit)}, {how}), {most}."


def remarks(subject: ReportData) -> list[Remark]:
    """What to know before the result is used, the weightiest first."""
    found = [*_search(subject), *_left(subject), *_data_remarks(subject), *_values(subject), *_errors(subject)]
    order = ("warning", "note", "good")
    return sorted(found, key=lambda remark: order.index(remark.kind))


def _search(subject: ReportData) -> Iterator[Remark]:
    result = subject.result
    if result is None:
        return
    if result.status == "converged":
        yield Remark("good", f"The search converged: {result.message}")
    else:
        yield Remark("warning", f"The search ended with the status {result.status}: {result.message}")
    for warning in result.warnings:
        yield Remark("warning", str(warning))
    if subject.stale:
        yield Remark(
            "warning",
            "Project or data have changed since this result was written: its errors cannot be reproduced. "
            "The tables of this report show the written numbers, the pictures show today's. Calibrate again.",
        )


def _left(subject: ReportData) -> Iterator[Remark]:
    """Where surrogates are used outside the data they were trained on."""
    for name in dict.fromkeys(row.name for row in subject.left):
        mine = [row for row in subject.left if row.name == name]
        outside = sorted((row for row in mine if row.worst is not None), key=lambda row: -row.share)
        if mine[0].outside is None:
            yield Remark("note", f"{mine[0]}: nothing tells where it is used outside them.")
        elif not outside:
            count = sum(row.samples for row in mine)
            yield Remark("good", f"{name} is used within the data it was trained on, at all of {count} samples.")
        for row in outside[:MOST_LEFT]:
            remedy = "" if row.share <= RARE else " What it says there is a guess: train it on data from there, too."
            yield Remark("warning" if row.share > RARE else "note", f"{row}.{remedy}")
        if len(outside) > MOST_LEFT:
            yield Remark("note", f"{name} is used outside them on {len(outside) - MOST_LEFT} further datasets.")


def _data_remarks(subject: ReportData) -> Iterator[Remark]:
    if not any(score.use == "test" for score in subject.scores):
        yield Remark(
            "note",
            "There are no test data: nothing here says how well the function works on data it was not fitted to.",
        )
        return
    if subject.seen:
        yield from (Remark("warning", str(finding)) for finding in subject.seen)
        return
    for number in dict.fromkeys(score.number for score in subject.scores):
        mine = [score for score in subject.scores if score.number == number]
        training, test = ([s for s in mine if s.use == use] for use in ("training", "test"))
        if subject.result is None or not training or not test:
            continue
        criterion = mine[0].criterion
        (given, fitted), (_, fresh) = pooled(training).rmse, pooled(test).rmse
        if fitted > given:
            continue  # neither noise nor anything else was learnt
        if fresh > TUNED * fitted > 0:
            yield Remark(
                "warning",
                f"The error of {criterion} on test data is {shown(fresh / fitted, 2)} times that on training data: "
                "the tables follow noise, or the test data lie where there are no training data.",
            )
        elif fitted > 0:
            yield Remark(
                "good",
                f"The error of {criterion} on test data is {shown(fresh / fitted, 3)} times that on "
                "training data: what was learnt holds beyond the data it was learnt from.",
            )


def _values(subject: ReportData) -> Iterator[Remark]:
    changes = subject.changes
    empty, total = sum(int(c.uncovered.sum()) for c in changes), sum(c.after.size for c in changes)
    if empty:
        yield Remark(
            "note",
            f"Values without training data near them: {empty} of {total}; "
            "they are hatched below and rest on smoothness, or on the start.",
        )
    at = sum(int(np.count_nonzero(c.bound)) for c in changes)
    if at and subject.result is not None:
        yield Remark("note", f"Values at a bound: {at} of {total}.")
    null_space = subject.trust.null_space
    if null_space:
        yield Remark("warning" if null_space.remedy else "note", null_space.sentence)
    if subject.trust.directions and not (null_space and null_space.remedy):
        count = len(subject.trust.directions)
        yield Remark(
            "warning",
            f"There {'is one change' if count == 1 else f'are {count} changes'} of the values that "
            "the data can hardly tell from none; see what the data do not determine.",
        )


def _errors(subject: ReportData) -> Iterator[Remark]:
    if subject.result is None:
        return
    for of in subject.residuals:
        for row in of.summaries:
            if row.samples > 20 and abs(row.mean) > BIASED * row.rmse:
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
                    f"{row.samples} samples are worth {shown(memory.independent, 2)} independent ones.",
                )
