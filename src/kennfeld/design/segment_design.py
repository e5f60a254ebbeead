"""Choice of the pieces of recordings to drive next, and of the recordings that add nothing."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.design.candidate_data import CandidateData
from kennfeld.design.coverage import Stop, WeightedCoverage, never
from kennfeld.design.design_result import ChosenSegment, Design, Watch, stopped_early
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.information import Information
from kennfeld.design.limits_of_design import beyond_axes
from kennfeld.design.measured_kinds import kind_of, measured_kinds
from kennfeld.design.open_directions import (
    SETTLED,
    amount_of,
    factors_with,
    open_directions,
    reduced_functions,
)
from kennfeld.design.predicted_estimate import describe_range, deviation_range, deviations
from kennfeld.design.segments import RecordedSegment, cut_files, cut_segments, owners
from kennfeld.design.value_text import ValueNames
from kennfeld.domain.dataset import Dataset
from kennfeld.graph.external_function import is_sequential

PLACE = Location("design")
BEYOND, MOST_BEYOND = 0.05, 0.05  # of an axis, and share of the samples that may be as far beyond its ends
ADDS_NOTHING = 1.05  # mean variance over the use without recordings that add nothing, relative to that with all


def design_segments(
    fitted: FittedFunction,
    candidates: Sequence[Dataset],
    use: Sequence[Dataset],
    count: int,
    length: float,
    warmup: float | None,
    seed: int = 0,
    watch: Watch = never,
) -> Design:
    """Choose pieces of recordings, or of planned manoeuvres, by coverage weighted by use.

    Args:
        fitted: the fit of the present data.
        candidates: recordings with time stamps; their targets are not read.
        use: the operation that matters.
        count: number of segments.
        length: of a segment, in s.
        warmup: time before each segment, in s; by default three of the largest time constants.
        seed: of the sets of values over which information is averaged.
        watch: is asked after each segment; True ends the search with those so far.

    Raises:
        InputError: no candidate has time stamps or is long enough.
    """
    findings = Findings()
    timed = [data for data in candidates if data.time is not None]
    if not timed:
        names = join_names([data.name for data in candidates])
        remedy = "Name the time channel `time`, or ask for points with n."
        raise InputError.of(PLACE, f"{names} has no time stamps, so that there are no segments", remedy)
    if len(timed) < len(candidates):
        untimed = join_names([data.name for data in candidates if data.time is None])
        findings.warning(PLACE, f"{untimed} has no time stamps, and is left out", "Name the time channel `time`.")
    lead = fitted.warmup() if warmup is None else warmup
    if warmup is None and lead == 0 and _has_memory(fitted):
        message = "the function has a memory whose time constants are unknown, so that segments have no warm-up"
        findings.warning(PLACE, message, "Write warmup = ... in [design], in s.")
    segments = cut_segments(timed, length, lead)
    if lead > length:
        message = f"segments of {length:g} s are shorter than their warm-up of {lead:.3g} s"
        findings.warning(PLACE, message, f"Use a length of {3 * lead:.0f} s or more, which costs less driving.")
    if not segments:
        message = f"no recording is as long as a segment of {length:g} s with its warm-up of {lead:.3g} s"
        raise InputError.of(PLACE, message, "Reduce length or warmup, or name other recordings with --from.")
    segments = _without_gaps(fitted, segments, timed, findings)
    measured = kind_of(measured_kinds(fitted, timed=True), timed).criteria
    groups = owners(segments, timed)
    information = Information.of(fitted, timed, groups, len(segments), use, seed, measured=measured)
    segments, information = _usable(segments, information, findings)
    if len(segments) < count:
        message = f"there are {count_noun(len(segments), 'segment')}, fewer than the {count} asked for"
        findings.warning(PLACE, message, "Name more recordings with --from.")
    cover, known, wanted = information.coverage, findings.finish(), min(count, len(segments))

    def designed(chosen: Sequence[int]) -> Design:
        own = [*chosen]
        names, gains = ValueNames(fitted), cover.gains(own)
        picked = [segments[number] for number in own]
        cut = [each.cut(timed[each.dataset]) for each in picked]
        data = CandidateData(fitted, cut, measured=measured)
        added = data.curvature(fitted.values)
        scatter = data.scatter(fitted.values, added)
        after = deviations(fitted, (added, scatter))
        least, most = deviation_range(fitted, after, data.curvature, seed)
        design = Design(
            segments=tuple(
                ChosenSegment(each.file, each.begin, each.end, names.strongest(gain))
                for each, gain in zip(picked, gains, strict=True)
            ),
            before=deviations(fitted),
            noise=dict(fitted.trust.noise),
            after=after,
            least=least,
            most=most,
            sentences=tuple(describe_range(fitted, after, least, most)),
            unsettled=tuple(describe_unsettled(fitted, added, scatter, "These segments")),
            findings=(*known, *_beyond_axes(fitted, cut)),
            warmup=lead,
            factor=cover.of(own) / cover.of([]),
            course=tuple(cover.of(own[: number + 1]) / cover.of([]) for number in range(len(own))),
        )
        return stopped_early(design, len(own), wanted, "segment")

    return designed(cover.choose(count, stop=lambda chosen: watch(lambda: designed(chosen))))


def _has_memory(fitted: FittedFunction) -> bool:
    graph = fitted.problem.model.graph
    return bool(graph.states) or any(is_sequential(node) for node in graph.nodes)


def _without_gaps(
    fitted: FittedFunction, segments: list[RecordedSegment], datasets: Sequence[Dataset], findings: Findings
) -> list[RecordedSegment]:
    """Return the segments without samples at which an input is missing, if the function has a memory.

    Its states would start anew there, which would seem to tell of time constants.
    """
    if not _has_memory(fitted):
        return segments
    gaps = [np.ones(data.samples, dtype=bool) for data in datasets]
    for gone, data in zip(gaps, datasets, strict=True):
        gone[fitted.problem.bind(data).kept] = False
    kept = [each for each in segments if not gaps[each.dataset][each.lead : each.last].any()]
    remedy = "max_gap of a dataset, in s, bridges short gaps."
    if not kept:
        raise InputError.of(PLACE, "an input has no value somewhere in each segment", remedy)
    if len(kept) < len(segments):
        message = f"{count_noun(len(segments) - len(kept), 'segment')} left out, as an input has no value somewhere"
        findings.warning(PLACE, message, remedy)
    return kept


def _beyond_axes(fitted: FittedFunction, chosen: Sequence[Dataset]) -> list[Finding]:
    """Return a warning if inputs of chosen segments lie far beyond the axes of a table for a while."""
    if not chosen:
        return []
    channels = fitted.problem.channels
    names = [channels.get(name, name) for name in fitted.problem.model.graph.inputs]
    columns = {name: np.concatenate([data[name].values[data.counting] for data in chosen]) for name in names}
    share = float(beyond_axes(fitted.problem, columns, BEYOND).mean()) if columns else 0.0
    if share < MOST_BEYOND:
        return []
    message = f"{100 * share:.0f} % of the samples of these segments lie beyond the axes of a table"
    return [Finding(PLACE, message, "Lookups clip there.", severity="warning")]


def _usable(
    segments: list[RecordedSegment], information: Information, findings: Findings
) -> tuple[list[RecordedSegment], Information]:
    """Return the segments at which the function has finite values and that say anything."""
    finite, telling = information.usable, information.candidates.any(axis=(0, 2))
    usable = finite & telling
    if usable.all():
        return segments, information
    for left_out, reason, remedy in (
        (~finite, "the function has no finite value there", "Check the inputs there."),
        (finite & ~telling, "no value that may change has an effect there", "Check weights and inputs there."),
    ):
        if left_out.all():
            raise InputError.of(PLACE, f"no segment can be chosen, as {reason}", remedy)
        if left_out.any():
            message = f"{count_noun(int(left_out.sum()), 'segment')} left out, as {reason}"
            findings.warning(PLACE, message, remedy)
    if not usable.any():
        raise InputError.of(PLACE, "no segment says anything", "Check weights and inputs of the candidates.")
    kept = [segment for segment, good in zip(segments, usable, strict=True) if good]
    return kept, Information(information.known, information.candidates[:, usable], information.use, usable[usable])


def describe_unsettled(fitted: FittedFunction, added: Float, scatter: Float, measured: str) -> list[str]:
    """Return a sentence for each undetermined direction of which a design leaves more than 0.9 of its deviation.

    Of what is measured, the Gauss-Newton matrix and the variance of the gradient are needed, Float[free, free] each.
    """
    directions = open_directions(fitted)
    if not directions:
        return []
    functions = reduced_functions(fitted, [amount_of(fitted, direction) for direction in directions])
    factors = factors_with(fitted, functions, *map(fitted.estimate.reduction.matrix, (added, scatter)))
    return [
        f"{direction.sentence} {measured} leave {factor:.2f} of its deviation."
        for direction, factor in zip(directions, factors.tolist(), strict=True)
        if factor > SETTLED
    ]


def reduce_recordings(
    fitted: FittedFunction,
    recordings: Sequence[Dataset],
    use: Sequence[Dataset],
    keep: int | None,
    seed: int = 0,
    watch: Watch = never,
) -> Design:
    """Find the recordings of the training data that add nothing, by coverage weighted by use.

    Args:
        fitted: the fit of all of them.
        recordings: the training data; each file of a dataset is a recording, or each piece.
        use: the operation that matters; training and test data count alike in it, however many samples they have.
        keep: number of recordings to keep; by default as many as raise the mean variance over the use by 5 % at most.
        seed: of the sets of values over which information is averaged.
        watch: is asked after each recording that is dropped; True ends the search with those so far.
    """
    files = cut_files(recordings)
    if len(files) < 2:
        message = f"the training data are {count_noun(len(files), 'recording')}, of which none can be dropped"
        raise InputError.of(PLACE, message, "State each recording as a file of its own.")
    if keep is not None and not 1 <= keep <= len(files):
        message = f"must be 1 to {len(files)}, the number of recordings, got {keep}"
        raise InputError.of(Location("--keep"), message)
    information = Information.of(
        fitted, recordings, owners(files, recordings), len(files), use, seed, alike=True, recorded=True
    )
    # what all recordings tell is replaced by what is known without them
    alone = Information(
        np.repeat(fitted.prior[None], len(information.known), axis=0),
        information.candidates,
        information.use * _shares(fitted, information.use),
        information.usable,
    )
    cover = alone.coverage
    everything = cover.of(list(range(len(files))))
    last = 1 if keep is None else keep

    def designed(dropped: Sequence[tuple[int, float]]) -> Design:
        wanted = len(files) - last
        useless = [each for each in dropped if each[1] <= ADDS_NOTHING * everything]
        if keep is None and len(useless) < len(dropped):
            return _without(fitted, recordings, files, useless, everything)
        reduced = _without(fitted, recordings, files, dropped, everything)
        return stopped_early(reduced, len(dropped), wanted, "recording") if dropped else reduced

    def stop(gone: list[int]) -> bool:
        return watch(lambda: designed([(number, without(gone[: at + 1])) for at, number in enumerate(gone)]))

    def without(gone: Sequence[int]) -> float:
        return cover.of([number for number in range(len(files)) if number not in gone])

    dropped = cover.drop(last, exchange=keep is not None, stop=stop)
    if keep is None and len(dropped) == len(files) - last:
        dropped = _useless(cover, len(files), dropped, ADDS_NOTHING * everything, stop)
        return _without(fitted, recordings, files, dropped, everything)
    return designed(dropped)


def _useless(
    cover: WeightedCoverage, count: int, dropped: Sequence[tuple[int, float]], most: float, stop: Stop
) -> list[tuple[int, float]]:
    """Return as many recordings as can go if the variance may rise to `most`.

    Those that are missed least one by one need not be those that are missed least together: exchanges may let more go.
    """
    useless = [each for each in dropped if each[1] <= most]
    while len(useless) < count - 1:
        more = cover.drop(count - len(useless) - 1, exchange=True, stop=stop)
        if len(more) <= len(useless) or more[-1][1] > most:
            break
        useless = more
    return useless


def _without(
    fitted: FittedFunction,
    recordings: Sequence[Dataset],
    files: Sequence[RecordedSegment],
    dropped: Sequence[tuple[int, float]],
    everything: float,
) -> Design:
    """Return the design without recordings.

    Args:
        fitted: the fit of all of them.
        recordings: the training data.
        files: the recordings in them.
        dropped: their numbers, each with the variance without it and those before it.
        everything: variance with all of them.
    """
    numbers = [number for number, _ in dropped]
    sentences = _predicted_loss(files, dropped, everything)
    after, least, most = _deviations_without(fitted, recordings, [files[number] for number in numbers])
    gone = np.array([segment.last - segment.first for segment in files])[numbers].sum()
    total = sum(segment.last - segment.first for segment in files)
    sentences.append(
        f"They hold {100 * gone / total:.0f} % of the samples." if numbers else "All recordings add something."
    )
    return Design(
        drop=tuple(files[number].file for number in numbers),
        before=deviations(fitted),
        noise=dict(fitted.trust.noise),
        after=after,
        least=least,
        most=most,
        sentences=(*sentences, *describe_range(fitted, after, least, most)),
        factor=(dropped[-1][1] if dropped else everything) / everything,
    )


def _shares(fitted: FittedFunction, use: Float) -> Float:
    """Return the share of each value in the use of its parameter, Float[draws, free].

    Weighted by it, the best subset has information in proportion to the use, sum u^2 / I being least for I = u, and so
    leaves the balance of the errors of a function that is not exact as it was. Coverage alone would
    keep the extremes.
    """
    shares = np.zeros_like(use)
    for first, size in fitted.blocks.values():
        part = use[:, first : first + size]
        total = part.sum(axis=1, keepdims=True)
        shares[:, first : first + size] = np.divide(part, total, out=np.zeros_like(part), where=total > 0)
    return shares


def _predicted_loss(
    files: Sequence[RecordedSegment], dropped: Sequence[tuple[int, float]], everything: float
) -> list[str]:
    if not dropped:
        return []
    percent = 100 * (dropped[-1][1] / everything - 1)
    kept = len(files) - len(dropped)
    return [f"{len(dropped)} of {len(files)} recordings can go; the other {kept} leave {percent:.2g} % more variance."]


def _deviations_without(
    fitted: FittedFunction, recordings: Sequence[Dataset], gone: Sequence[RecordedSegment]
) -> tuple[Mapping[str, Float], Mapping[str, Float], Mapping[str, Float]]:
    """Return the deviations once recordings are gone, by subtracting what they tell, with their least and greatest."""
    if not gone:
        return deviations(fitted), {}, {}
    removed = CandidateData(fitted, [segment.cut(recordings[segment.dataset]) for segment in gone], recorded=True)
    curvature = removed.curvature(fitted.values)
    after = deviations(fitted, (-curvature, -removed.scatter(fitted.values, curvature)))
    return after, *deviation_range(fitted, after, lambda values: -removed.curvature(values))
