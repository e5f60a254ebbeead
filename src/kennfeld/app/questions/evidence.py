"""Linked evidence between grid points, samples and nodes."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.questions.recordings import used_entries
from kennfeld.app.session.distributions import thin
from kennfeld.app.session.evidence import Informing
from kennfeld.app.session.selection import both, check_clock, condition, outside, stretch_in_other_data
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SampleSelection
from kennfeld.app.session.view import View
from kennfeld.app.wire import ABSENT, Absent
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass

MAX_STRETCHES = 100  # of one dataset, the longest ones
MAX_POINTS = 2500


@dataclass(frozen=True)
class AskedInforming:
    """The value `cell` of a parameter, by its number in C order, and the criterion whose errors are shown."""

    name: str
    cell: int
    criterion: int = 0


@dataclass(frozen=True)
class InformingRow:
    """The samples of a dataset that inform a value, and their mean errors.

    Attributes:
        count: number of stretches.
        stretches: begin and end of the longest ones.
    """

    number: int
    dataset: str
    use: str
    samples: int
    count: int
    stretches: Sequence[tuple[float, float]]
    mean_before: float | None
    mean_now: float | None


@dataclass(frozen=True, eq=False)
class InformingReply:
    """Samples that inform a value.

    Attributes:
        most: number of the dataset with most of them, of training data if these have any; missing without samples, as
            the arrays are.
        x: place of lookups near the grid point along the first axis, in that dataset.
        y: place along the second axis; empty without one.
        weight: weight of the value in each lookup.
    """

    datasets: Sequence[InformingRow]
    most: int | Absent = ABSENT
    x: Float | None = None
    y: Float | None = None
    weight: Float | None = None


@dataclass(frozen=True)
class AskedPassed:
    """The samples of a dataset that `brush` selects, or those from `begin` to `end`."""

    dataset: int
    begin: float = -np.inf
    end: float = np.inf
    brush: SampleSelection | None = None


@dataclass(frozen=True, eq=False)
class PassedReply:
    """Number of samples, and by table the weight of each value in them."""

    samples: int
    weights: Mapping[str, Float]


@dataclass(frozen=True)
class AskedConditions:
    """The samples of a dataset that `brush` selects."""

    dataset: int
    brush: SampleSelection


@dataclass(frozen=True)
class BrushedConditions:
    """Conditions of a project file for brushed samples; one that it cannot express is empty.

    Attributes:
        where: condition that keeps only these samples, in addition to the one that the dataset has.
        outside: condition that leaves them out.
        region: condition for the weights of a criterion.
        reason: why `where` and `outside` are empty.
        region_reason: why `region` is empty.
    """

    where: str
    outside: str
    region: str
    reason: str
    region_reason: str


@dataclass(frozen=True)
class AskedCoverage:
    """A parameter, and the criterion whose errors are shown."""

    name: str
    criterion: int = 0


@dataclass(frozen=True, eq=False)
class CoverageReply:
    """Evidence for all values of a parameter; empty if it looks nothing up.

    Attributes:
        error: mean error over the samples that inform each value.
        x: place of lookups along the first axis.
        y: place along the second axis.
    """

    error: Float | None = None
    x: Float | None = None
    y: Float | None = None


def informing(session: Session, asked: AskedInforming) -> InformingReply:
    """Return what a value rests on: its samples, their errors, and where they are."""
    view, name, cell = session.require_view(), asked.name, asked.cell
    parts = view.evidence.informing(name, cell)
    rows = [_informing(view, part, asked.criterion) for part in parts if part.samples.size]
    if not rows:
        return InformingReply([])
    # the value rests on training data; test data only look it up
    uses = [recording.use for recording in view.model.recordings]
    most = max(parts, key=lambda part: (part.samples.size > 0 and uses[part.dataset] == "training", part.samples.size))
    near = view.evidence.surroundings(view.model.recordings[most.dataset], name, cell)
    drawn = thin(near.samples.size, near.weights, MAX_POINTS)
    coordinates = [*near.coordinates[:2, drawn], *([np.zeros(0)] * 2)][:2]
    return InformingReply(rows, most.dataset, coordinates[0], coordinates[1], near.weights[drawn])


def _informing(view: View, part: Informing, criterion: int) -> InformingRow:
    recording, stretches = view.model.recordings[part.dataset], part.stretches
    position = recording.position
    now, start = (each.errors[part.dataset][criterion][part.samples] for each in (view.now, view.start))
    return InformingRow(
        number=part.dataset,
        dataset=recording.name,
        use=recording.use,
        samples=int(part.samples.size),
        count=len(stretches),
        stretches=[(float(position[first]), float(position[last])) for first, last in stretches[:MAX_STRETCHES]],
        mean_before=finite(_mean(start)),
        mean_now=finite(_mean(now)),
    )


def _mean(values: Float) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def passed(session: Session, asked: AskedPassed) -> PassedReply:
    """Return by table the weight of each value in the samples of a dataset that are brushed, or of a stretch."""
    view = session.require_view()
    recording = view.model.recordings[asked.dataset]
    selection = asked.brush or SampleSelection(begin=asked.begin, end=asked.end)
    chosen = view.signals.selected(recording, selection)
    weights = view.evidence.passed(recording, chosen)
    return PassedReply(int(chosen.sum()), {name: weight.ravel() for name, weight in weights.items()})


def conditions(session: Session, asked: AskedConditions) -> BrushedConditions:
    """Return how the project file would say what is brushed in a dataset."""
    problem = session.require_view().model.problem
    number, selection = asked.dataset, asked.brush
    recording = session.require_view().model.recordings[number]
    try:
        text = condition(selection, recording, problem)
        inside, beyond = (both(_where(session, number), part) for part in (text, outside(text)))
        check_clock(inside, recording)
    except ArgumentError as error:
        return BrushedConditions("", "", "", str(error), str(error))
    reason = stretch_in_other_data(selection, problem)
    region = "" if reason else text
    return BrushedConditions(inside, beyond, region, "", reason)


def _where(session: Session, number: int) -> str:
    """Return the condition of a dataset in the project file."""
    entry = [*used_entries(session).values()][number]
    return str(entry.get("where", ""))


def coverage(session: Session, asked: AskedCoverage) -> CoverageReply:
    """Return the evidence for all values of a parameter at once; only training data count."""
    view, name, criterion = session.require_view(), asked.name, asked.criterion
    if name not in view.evidence.tables:
        return CoverageReply()
    mean = view.evidence.mean_errors(name, [errors[criterion] for errors in view.now.errors])
    places = view.evidence.places(name, MAX_POINTS)
    return CoverageReply(mean.ravel(), *places[:2])
