"""Warnings about an end that was reached as the search defines it, but that a user should not take for the optimum."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import groupby

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.solver.certificate import Certificate

STEEP = 1e-2  # share of the cost that an undamped step may promise without a warning, after it was tried
NOTICEABLE = 0.25, 0.05  # variances of the noise that it may promise, and as many for each fitted value
POOR, MEAN = -1e-6, 1e-9  # R2 that is clearly below 0, and clearly above it, not its rounding
SLOPED = 1e-4  # cosine between residuals and a column of J from which a value should have moved
HIDDEN = 1e-12  # share of the cost of which four digits are left
SLIGHT_VARIATION = 1e-5  # of an input, relative to its largest value
OUTLIERS = "If the largest errors are outliers, that is what a robust loss leaves of them. Otherwise:"
HELD = "Bounds, pins and limits hold all values where they are: check them."
LIMITED = "Limits of outputs are reached there: check them."
FREE_ALL = "End the sequence with a step that frees all of them on their whole grids."
SMOOTH = 'Search with continuation = "auto": it crosses kinks of lookups.'
OTHER_START = "Start closer to plausible values, set bounds around them, or search from several starts: starts = 10."


def find_poor_fits(
    quality: Sequence[Quality],
    scored: Collection[str],
    robust: Collection[str],
    limited: Callable[[], str],
    faded: Callable[[], bool],
) -> Iterator[Finding]:
    """Yield a warning for each criterion that the mean of its target would meet better, in all training datasets.

    One that is met as well by the mean has a warning if values have lost their effect: the output became a constant.

    Args:
        quality: of all criteria on all datasets.
        scored: the criteria with a weight.
        robust: those whose loss counts large errors less: a few outliers may make R2 negative.
        limited: returns a remedy if limits keep the values from better ones, else nothing.
        faded: returns True if parameters have lost their effect on the way.
    """
    training = [row for row in quality if row.use == "training" and row.criterion in scored and row.samples]
    for criterion, rows in groupby(sorted(training, key=lambda row: row.criterion), key=lambda row: row.criterion):
        best = max(row.r2_after for row in rows)  # NaN of a constant target is kept
        if best < POOR:
            message = f"{criterion} is reproduced worse than by the mean of its target (R2 = {best:.3g})"
            remedy = limited() or (f"{OUTLIERS} {OTHER_START}" if criterion in robust else OTHER_START)
            yield Finding(Location(), message, remedy, severity="warning")
        elif best < MEAN and faded():
            message = (
                f"{criterion} is reproduced no better than by the mean of its target: values have lost their effect"
            )
            yield Finding(Location(), message, OTHER_START, severity="warning")


def describe_outlier(losses: Float, quality: Sequence[Quality], scored: Collection[str]) -> str:
    """Return a sentence if the losses of all samples but one are lost to rounding beside it, else nothing.

    Args:
        losses: of each sample, Float[samples].
        quality: of all criteria on all datasets.
        scored: the criteria with a weight.
    """
    training = [row for row in quality if row.use == "training" and row.criterion in scored]
    # without the largest one, since the sum of all would hide the others
    if not training or not np.sum(np.delete(losses, np.argmax(losses))) < HIDDEN * losses.max():
        return ""
    worst = max(training, key=lambda row: row.max_abs_after)
    return (
        f"{worst.criterion} has an error of {worst.max_abs_after:.3g} in {worst.dataset}, beside which all other "
        "errors are lost to rounding. Correct this sample, or exclude it with where."
    )


def describe_offsets(inputs: Mapping[str, Sequence[Float]]) -> str:
    """Return a sentence on inputs that vary so little about a large number that their slope is hard to tell from it.

    Args:
        inputs: samples by name, each in parts, Float[samples].

    >>> describe_offsets({"t": [np.array([1.7e9, 1.7e9 + 36.0])]})
    't varies only by 36 about 1.7e+09. Subtract its first value in the function.'
    """
    sentences = []
    for name, parts in inputs.items():
        low, high = (pick(side(part) for part in parts if part.size) for pick, side in ((min, np.min), (max, np.max)))
        if 0 < high - low < SLIGHT_VARIATION * max(abs(low), abs(high)):
            sentences.append(f"{name} varies only by {high - low:.3g} about {low:.3g}.")
    return f"{' '.join(sentences)} Subtract its first value in the function." if sentences else ""


def steepness(residuals: int, values: int) -> float:
    """Return the share of the cost that slopes may promise without a warning.

    A cost that is lower by one variance of the noise, its share 1/n of n residuals, may move a value by one standard
    deviation.
    """
    variances = max(NOTICEABLE[0], NOTICEABLE[1] * values)
    return min(STEEP, variances / max(residuals, 1))


def find_slopes(
    certificate: Certificate | None, steep: float, *, moved: bool, in_steps: bool, unsmoothed: bool = False
) -> Iterator[Finding]:
    """Yield a warning if the slopes at an end promise a lower cost than the search reached.

    Args:
        certificate: of an end that counts as converged, if there is one.
        steep: see `steepness`.
        moved: if any value differs from its start.
        in_steps: if the search was a sequence, whose last step may keep some of the values.
        unsmoothed: if a continuation would smooth lookups, but is off.
    """
    if certificate is None:
        return
    message, remedy = "", OTHER_START
    if in_steps:
        if certificate.predicted_decrease > STEEP:
            message = f"All free values together would lower the cost by {certificate.predicted_decrease:.0%}"
            message += ": the last step of the sequence keeps some of them, or removes breakpoints"
            remedy = FREE_ALL
    # a search that has not moved at all, although a slope is there
    elif not moved and certificate.gradient > SLOPED:
        message = (
            "No value has moved from its start although the gradient is not zero there "
            f"(cosine {certificate.gradient:.2g} with the errors): no step lowers the cost"
        )
    elif certificate.predicted_decrease > steep:
        message = (
            f"The slopes at the end promise a cost {certificate.predicted_decrease:.2%} lower, but no step reaches it: "
            "the function has kinks or jumps there"
        )
        remedy = SMOOTH if unsmoothed else OTHER_START
    if message:
        yield Finding(Location(), message, remedy, severity="warning")
