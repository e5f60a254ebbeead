"""The order in which a bench measures points: short ways, blocks, replicates and repeat points."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass

IMPROVEMENTS = 100  # passes of 2-opt
LARGE = 2000  # points from which a sweep replaces the search for a short way


@dataclass(frozen=True, eq=False)
class BenchRun:
    """Points in the order in which they are measured.

    Attributes:
        columns: by channel, Float[points].
        block: number of the block of each point, from 1, Int[points].
        kind: for each point `point`, `replicate` or `repeat`.
        ramp: time in s that the way to each point takes at the slew rates, Float[points]; 0 for the first.
        wait: time in s that a bench waits at each point, Float[points].
    """

    columns: Mapping[str, Float]
    block: Int
    kind: tuple[str, ...]
    ramp: Float
    wait: Float


def arrange(
    columns: Mapping[str, Float],
    *,
    hard: Sequence[str] = (),
    slew: Mapping[str, float] | None = None,
    blocks: int = 1,
    replicates: int = 0,
    repeat_every: int = 0,
    wait: float = 0.0,
    sort: bool = True,
    seed: int = 0,
) -> BenchRun:
    """Arrange points for the bench.

    Args:
        columns: the points by channel, Float[points].
        hard: channels that are hard to change, such as the temperature of the coolant: their levels are measured one
            after the other, each in one go.
        slew: largest rates by channel, in units per s.
        blocks: number of blocks of about equal size, each spread over the whole region, e.g. one for each day.
        replicates: points that are measured twice, spread over the region.
        repeat_every: the point in the middle of all is measured at the beginning and again after so many points, to see
            a drift of the bench; 0 for never.
        wait: time in s at each point.
        sort: False leaves the points in their order.
        seed: of the choice of replicates.
    """
    slew = slew or {}
    count = len(next(iter(columns.values()))) if columns else 0
    names = list(columns)
    points = np.column_stack([columns[name] for name in names]) if names else np.zeros((0, 0))
    again = _spread(points, min(replicates, count), seed)
    rows = np.concatenate([np.arange(count), again])
    is_again = np.arange(rows.size) >= count
    unit = _distances(points, names, slew)
    pieces: list[tuple[Int, Int]] = []
    for number, own in enumerate(_deal(rows, unit, blocks) if blocks > 1 else [np.arange(rows.size)]):
        ordered = own[_order(points[rows[own]], unit[rows[own]], [names.index(name) for name in hard])] if sort else own
        pieces.append((ordered, np.full(ordered.size, number + 1)))
    order, block = (np.concatenate([np.zeros(0, dtype=np.int64), *part]) for part in zip(*pieces, strict=True))
    kinds = ["replicate" if is_again[i] else "point" for i in order]
    chosen = rows[order]
    if repeat_every and count:
        chosen, block, kinds = _with_repeats(chosen, block, kinds, _middle(unit), repeat_every)
    ramp = _ramps(points[chosen], names, slew)
    return BenchRun(
        {name: points[chosen, i] for i, name in enumerate(names)}, block, tuple(kinds), ramp, np.full(chosen.size, wait)
    )


def _distances(points: Float, names: Sequence[str], slew: Mapping[str, float]) -> Float:
    """Scale channels so that a difference is a time, or, without slew rates, a share of the range."""
    if not points.size:
        return points
    spans = np.ptp(points, axis=0)
    rates = np.array([slew.get(name, np.inf) for name in names])
    if np.isfinite(rates).any():
        return np.asarray(points / np.where(np.isfinite(rates), rates, np.inf))
    return np.asarray(points / np.where(spans > 0, spans, 1.0))


def _ramps(points: Float, names: Sequence[str], slew: Mapping[str, float]) -> Float:
    """Return the time from each point to the next one, in which all channels move at once, Float[points]."""
    ramp = np.zeros(len(points))
    for i, name in enumerate(names):
        if name in slew and len(points) > 1:
            ramp[1:] = np.maximum(ramp[1:], np.abs(np.diff(points[:, i])) / slew[name])
    return ramp


def _way(points: Float) -> Float:
    """Return distances of all pairs: the time of the slowest channel, or the largest share of a range."""
    return np.asarray(np.abs(points[:, None] - points[None]).max(axis=2))


def _order(points: Float, unit: Float, hard: Sequence[int]) -> Int:
    """Return an order of points with short ways, in which hard channels change least."""
    if len(points) < 2:
        return np.arange(len(points))
    if not hard:
        return _short_way(unit)
    levels, level_of = np.unique(points[:, list(hard)], axis=0, return_inverse=True)
    easy = [i for i in range(points.shape[1]) if i not in hard]
    order: list[int] = []
    for level in _short_way(levels / np.maximum(np.ptp(levels, axis=0), 1e-300)).tolist():
        own = np.flatnonzero(level_of.ravel() == level)
        way = own[_short_way(unit[own][:, easy])] if easy and own.size > 1 else own
        # each level is begun at the end that is nearer to the last point of the one before
        if order and easy:
            last = unit[order[-1], easy]
            ends = [float(np.abs(unit[way[k], easy] - last).max()) for k in (0, -1)]
            way = way[::-1] if ends[1] < ends[0] else way
        order += way.tolist()
    return np.array(order)


def _short_way(points: Float) -> Int:
    """Return a short way through points, Int[points]: nearest neighbours, then 2-opt; a sweep through very many."""
    if len(points) > LARGE:
        return _sweep(points)
    apart = _way(points)
    # from a corner, as a way that begins in the middle crosses itself
    order = [int(points.sum(axis=1).argmin())]
    left = np.ones(len(points), dtype=bool)
    left[order[0]] = False
    while left.any():
        order.append(int(np.where(left, apart[order[-1]], np.inf).argmin()))
        left[order[-1]] = False
    return _without_crossings(np.array(order), apart)


def _without_crossings(order: Int, apart: Float) -> Int:
    """Reverse parts of a way as long as that shortens it (2-opt)."""
    count = order.size
    for _ in range(IMPROVEMENTS):
        improved = False
        for i in range(count - 2):
            a, b = order[i], order[i + 1]
            tails = order[i + 1 :]
            following = np.append(tails[1:], -1)
            # the way a-b ... c-d becomes a-c ... b-d; the last point has no d
            old = apart[a, b] + np.where(following >= 0, apart[tails, following], 0.0)
            new = apart[a, tails] + np.where(following >= 0, apart[b, following], 0.0)
            gain = old - new
            best = int(gain.argmax())
            if gain[best] > 1e-12 * max(float(apart[a, b]), 1e-300):
                order[i + 1 : i + 2 + best] = order[i + 1 : i + 2 + best][::-1]
                improved = True
        if not improved:
            break
    return order


def _sweep(points: Float) -> Int:
    """Return a way in strips along the channel that takes longest to change, to and fro along the others."""
    spans = np.ptp(points, axis=0)
    ordered = np.argsort(-spans, kind="stable")
    slow, fast = int(ordered[0]), int(ordered[-1])
    strips = max(int(np.sqrt(len(points))), 1)
    rank = np.argsort(np.argsort(points[:, slow], kind="stable"), kind="stable")
    strip = rank * strips // len(points)
    along = np.where(strip % 2 == 0, points[:, fast], -points[:, fast])
    return np.lexsort((along, strip))


def _deal(rows: Int, unit: Float, blocks: int) -> list[Int]:
    """Deal points into blocks, neighbours on a short way into different ones; returns numbers within `rows`."""
    order = _short_way(unit[rows])
    return [np.sort(order[number::blocks]) for number in range(min(blocks, rows.size))]


def _spread(points: Float, count: int, seed: int) -> Int:
    """Choose points far from each other, Int[count], beginning with the one in the middle."""
    if not count:
        return np.zeros(0, dtype=np.int64)
    unit = points / np.maximum(np.ptp(points, axis=0), 1e-300)
    chosen = [_middle(unit)]
    nearest = np.square(unit - unit[chosen[0]]).sum(axis=1)
    while len(chosen) < count:
        # ties are broken by the seed
        ties = np.flatnonzero(nearest >= nearest.max() * (1 - 1e-12))
        chosen.append(int(np.random.default_rng(seed + len(chosen)).choice(ties)))
        nearest = np.minimum(nearest, np.square(unit - unit[chosen[-1]]).sum(axis=1))
        nearest[chosen] = -1.0
    return np.array(chosen)


def _middle(unit: Float) -> int:
    return int(np.square(unit - (unit.min(axis=0) + unit.max(axis=0)) / 2).sum(axis=1).argmin())


def _with_repeats(chosen: Int, block: Int, kinds: list[str], middle: int, every: int) -> tuple[Int, Int, list[str]]:
    rows, blocks, names = list[int](), list[int](), list[str]()
    for at, (row, own, kind) in enumerate(zip(chosen.tolist(), block.tolist(), kinds, strict=True)):
        if at % every == 0:
            # the middle comes between points, also between blocks
            rows.append(middle)
            blocks.append(own)
            names.append("repeat")
        rows.append(row)
        blocks.append(own)
        names.append(kind)
    return np.array([*rows, middle]), np.array([*blocks, int(block[-1])]), [*names, "repeat"]
