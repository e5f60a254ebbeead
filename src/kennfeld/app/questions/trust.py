"""Values that the data of the last run cannot determine, with remedies that the page applies."""

from collections.abc import Sequence

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.app.wire import ABSENT, Absent, KeyChange
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.optimize.trust.trust import Trust
from kennfeld.project.remedies import KeyChanges, key_changes

MAX_PINNED = 2500  # values whose covariance is computed


@dataclass(frozen=True)
class RemedyRow:
    """A remedy as changes of the project file; `applied` if the file has them already."""

    kind: str
    title: str
    changes: Sequence[KeyChange]
    applied: bool


@dataclass(frozen=True)
class UndeterminedDirection:
    """A direction of the values that the data do not determine."""

    sentence: str
    remedy: str
    remedies: Sequence[RemedyRow]
    exact: bool
    deviation: float | None
    parameters: Sequence[str]


@dataclass(frozen=True)
class NoiseRow:
    """Standard deviation of the errors of a criterion."""

    criterion: str
    value: float | None


@dataclass(frozen=True)
class TrustReply:
    """Values that the data of the last run cannot determine; without a run, only empty lists.

    Attributes:
        coupled: sentences on values that are determined together only.
        sentence: on the values that nothing determines.
        advice: what to do about them.
        dimension: number of directions that nothing determines.
        holdings: limits that hold values.
        freedom: the effective number of values that the data alone determine.
        values: number of free values.
    """

    directions: Sequence[UndeterminedDirection]
    remedies: Sequence[RemedyRow]
    coupled: Sequence[str] | Absent = ABSENT
    sentence: str | Absent = ABSENT
    advice: str | Absent = ABSENT
    dimension: int | Absent = ABSENT
    holdings: Sequence[str] | Absent = ABSENT
    noise: Sequence[NoiseRow] | Absent = ABSENT
    remark: str | Absent = ABSENT
    freedom: float | Absent | None = ABSENT
    values: int | Absent = ABSENT


@dataclass(frozen=True)
class AskedPin:
    """A pin of a parameter at a grid point."""

    parameter: str
    at: Sequence[float]


@dataclass(frozen=True)
class PinnedRow:
    """Median standard deviation of a table, before and after a pin."""

    name: str
    unit: str
    before: float | None
    after: float | None


@dataclass(frozen=True)
class PinnedReply:
    """The effect of a pin by table; empty if nothing determines the value, or there are too many values."""

    rows: Sequence[PinnedRow]


def trust(session: Session) -> TrustReply:
    """Return what the data of the last run of all values cannot determine.

    Remedies are changes of keys of the project file.
    """
    last = session.last_whole_run
    if last is None:
        return TrustReply([], [])
    known = last.result.trust
    return TrustReply(
        directions=[
            UndeterminedDirection(
                sentence=direction.sentence,
                remedy=direction.remedy,
                remedies=_applicable(session, last, direction.remedies),
                exact=direction.exact,
                deviation=finite(direction.deviation),
                parameters=list(direction.parts),
            )
            for direction in known.directions
            if not direction.determined
        ],
        coupled=[direction.sentence for direction in known.directions if direction.determined],
        sentence=known.null_space.sentence,
        advice=known.null_space.advice,
        dimension=known.null_space.dimension,
        remedies=_applicable(session, last, (known.null_space.remedy,)),
        holdings=[str(limit) for limit in known.holdings],
        noise=[NoiseRow(name, finite(value)) for name, value in known.noise.items()],
        remark=known.remark,
        freedom=finite(known.freedom),
        values=last.result.free_values,
    )


def _applicable(session: Session, run: Run, remedies: tuple[Remedy, ...]) -> list[RemedyRow]:
    problem, settings = run.problem or session.require_view().model.problem, session.settings
    changes = (key_changes(each, problem, settings, run.result.smoothness) for each in remedies)
    return [_remedy_row(each) for each in changes if each is not None]


def _remedy_row(own: KeyChanges) -> RemedyRow:
    return RemedyRow(own.kind, own.title, own.changes, own.applied)


def pinned(session: Session, asked: AskedPin) -> PinnedReply:
    """Return the median standard deviation of each table, and what it would be with a grid point pinned."""
    name, at = asked.parameter, asked.at
    last = session.last_whole_run
    trust = Trust() if last is None else last.result.trust
    sizes = {each: np.size(values) for each, values in trust.deviation.items()}
    if name not in sizes or sum(sizes.values()) > MAX_PINNED:
        return PinnedReply([])
    assert last is not None
    own = last.result.parameters
    table = own[name]
    index = tuple(int(np.abs(a.breakpoints - place).argmin()) for a, place in zip(table.index_axes, at, strict=True))
    after = pinned_deviation(trust, name, index)
    rows = [
        PinnedRow(each, own[each].unit, _median(trust.deviation[each]), _median(after[each]))
        for each in after
        if each in own
    ]
    return PinnedReply(rows)


def pinned_deviation(trust: Trust, name: str, index: tuple[int, ...]) -> dict[str, Float]:
    """Return the standard deviation of all values if one of them were known: C - C[:, k] C[k, :] / C[k, k].

    Empty if nothing determines the value.
    """
    covariance = trust.covariance()
    shapes = {each: np.shape(values) for each, values in trust.deviation.items()}
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    first = dict(zip(shapes, ends.tolist(), strict=False))
    k = first[name] + int(np.ravel_multi_index(index, shapes[name])) if shapes[name] else first[name]
    if not (np.isfinite(covariance[k, k]) and covariance[k, k] > 0):
        return {}
    variance = np.diag(covariance) - np.nan_to_num(covariance[:, k]) ** 2 / covariance[k, k]
    deviation = np.sqrt(np.maximum(variance, 0.0))
    return {each: deviation[at : at + int(np.prod(shapes[each]))].reshape(shapes[each]) for each, at in first.items()}


def _median(values: Float) -> float | None:
    known = values[np.isfinite(values) & (values > 0)]
    return float(np.median(known)) if known.size else None
