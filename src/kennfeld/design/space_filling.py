"""Designs that fill a region evenly, without a fit: Sobol sequence, Latin hypercube, full factorial."""

from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import InputError, Location
from kennfeld.design.region import BenchRegion

Filling = Literal["sobol", "lhs", "factorial"]
FILLINGS: tuple[Filling, ...] = ("sobol", "lhs", "factorial")
LARGEST_POWER = 20  # of two: points tried in a region that is small within its ranges
MOST_LEVELS = 10_000_000  # points of a full factorial
EMPTY = 100_000  # points of which none is in the region: it has no room for a factorial
PLACE = Location("design")


def fill(region: BenchRegion, count: int, kind: Filling = "sobol", seed: int = 0) -> dict[str, Float]:
    """Fill a region with points.

    With limits other than ranges, more points are made than are asked for, and those outside left out: of a Sobol
    sequence the first that are inside, of a Latin hypercube the points of the smallest cube that has enough inside.

    Args:
        region: where points may be.
        count: number of points.
        kind: `sobol`, scrambled; `lhs`, a Latin hypercube; `factorial`, as many levels of every channel as fit.
        seed: of the scrambling.

    Returns:
        By channel, Float[count].

    Raises:
        InputError: the limits leave no room, or not for so many points.
    """
    if kind == "factorial":
        return factorial(region, count)
    sampler = _sobol if kind == "sobol" else _latin_hypercube
    moving = sum(high > low for low, high in region.ranges.values())
    if not moving:
        return {name: np.full(1, low) for name, (low, _) in region.ranges.items()}
    tried: dict[str, Float] = {}
    for power in range(max(int(np.ceil(np.log2(max(count, 1)))), 0), LARGEST_POWER + 1):
        size = count if not region.limits else 2**power
        tried = _scaled(region, sampler(size, moving, seed))
        inside = np.flatnonzero(region.admits(tried))
        if inside.size >= count:
            # of a sequence the first points, of a cube any
            picked = inside[:count] if kind == "sobol" else _thin(inside, count, seed)
            return {name: values[picked] for name, values in tried.items()}
        if inside.size * 2 ** (LARGEST_POWER - power) < count and power >= 16:
            break
    region.require_room(tried, PLACE)
    share = float(region.admits(tried).mean())
    message = f"only a share of {share:.2g} of the ranges satisfies all limits, too little for {count} points"
    raise InputError.of(PLACE, message, "Narrow the ranges.")


def _thin(inside: Int, count: int, seed: int) -> Int:
    return np.sort(np.random.default_rng(seed).choice(inside, count, replace=False))


def _sobol(count: int, channels: int, seed: int) -> Float:
    from scipy.stats import qmc

    power = int(np.ceil(np.log2(max(count, 1))))
    # a whole power of two keeps the balance of the sequence; the first points are used
    return np.asarray(qmc.Sobol(channels, scramble=True, rng=np.random.default_rng(seed)).random_base2(power)[:count])


def _latin_hypercube(count: int, channels: int, seed: int) -> Float:
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(channels, rng=np.random.default_rng(seed)).random(count))


def _scaled(region: BenchRegion, unit: Float) -> dict[str, Float]:
    """Scale points of the unit cube, Float[points, moving channels], to the ranges."""
    columns, at = {}, 0
    for name, (low, high) in region.ranges.items():
        if high > low:
            # rounding must not leave the range
            columns[name] = np.clip(low + (high - low) * unit[:, at], low, high)
            at += 1
        else:
            columns[name] = np.full(len(unit), low)
    return columns


def factorial(region: BenchRegion, count: int) -> dict[str, Float]:
    """Return a full factorial with the most levels of which at most `count` points are in the region.

    All channels have as many levels, but for a last one more in the first of them, as far as the count allows.

    >>> sorted(zip(*(v.tolist() for v in factorial(BenchRegion({"x": (0.0, 1.0), "y": (0.0, 1.0)}), 6).values())))
    [(0.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.5, 1.0), (1.0, 0.0), (1.0, 1.0)]
    """
    names = [name for name, (low, high) in region.ranges.items() if high > low]
    levels = dict.fromkeys(names, 1)
    grown = True
    while grown:
        grown = False
        # the channel with the fewest levels first, so that they stay alike
        for name in sorted(names, key=lambda n: (levels[n], names.index(n))):
            more = levels | {name: levels[name] + 1}
            points = int(np.prod([float(n) for n in more.values()]))
            # so few fit wherever they are
            if points <= min(count, EMPTY) or (points <= MOST_LEVELS and _fits(_grid(region, more), points, count)):
                levels, grown = more, True
                break
    best = _grid(region, levels)
    if not len(next(iter(best.values()))):
        region.require_room(_grid(BenchRegion(region.ranges), dict.fromkeys(names, 9)), PLACE)
    return best


def _fits(grid: dict[str, Float], points: int, count: int) -> bool:
    """Return whether at most `count` points of a grid are in the region, of which one with many points has some."""
    inside = len(next(iter(grid.values())))
    return inside <= count and (inside > 0 or points <= EMPTY)


def _grid(region: BenchRegion, levels: dict[str, int]) -> dict[str, Float]:
    axes = []
    for name, (low, high) in region.ranges.items():
        count = levels.get(name, 1)
        axes.append(np.linspace(low, high, count) if count > 1 else np.array([(low + high) / 2]))
    mesh = np.meshgrid(*axes, indexing="ij")
    columns = {name: grid.ravel() for name, grid in zip(region.ranges, mesh, strict=True)}
    inside = region.admits(columns)
    return {name: values[inside] for name, values in columns.items()}
