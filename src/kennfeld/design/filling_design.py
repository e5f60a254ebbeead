"""Designs that need no fit: points that fill a region, optimal points of black-box models, planned manoeuvres."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import count_noun
from kennfeld.design.design_result import Design
from kennfeld.design.manoeuvres import Manoeuvre, TimeTable, plan_all
from kennfeld.design.optimal_exchange import exchange
from kennfeld.design.region import BenchRegion
from kennfeld.design.regression_models import model_rows
from kennfeld.design.space_filling import factorial, fill
from kennfeld.project.design_table import DesignEntry, ManoeuvreEntry

CANDIDATES = 1000  # points among which an optimal design is chosen
PLACE = Location("design")


def fill_region(
    entry: DesignEntry, region: BenchRegion, count: int, candidates: Mapping[str, Float] | None = None
) -> tuple[Design, dict[str, Float]]:
    """Return points that fill a region or determine a black-box model, by channel, Float[points], and what to say.

    Args:
        entry: method and model.
        region: where points may be.
        count: number of points; a factorial has at most as many.
        candidates: points to choose from; by default any of the region.

    Raises:
        InputError: the limits leave no room, or the points cannot determine the model.
    """
    if entry.method in ("d-optimal", "i-optimal"):
        return _optimal(entry, region, count, candidates)
    if candidates is not None:
        return _nearest(region, count, candidates, entry.seed)
    kind = "sobol" if entry.method == "auto" else entry.method
    points = fill(region, count, kind, entry.seed)  # type: ignore[arg-type]
    size = len(next(iter(points.values())))
    findings = []
    if size < count and kind == "factorial":
        message = f"a full factorial of at most {count} points has {size}"
        findings.append(Finding(PLACE, message, severity="remark"))
    elif size < count:
        message = "all ranges are single numbers, so that there is one point"
        findings.append(Finding(PLACE, message, "Widen a range.", severity="warning"))
    return Design(findings=tuple(findings)), points


def _optimal(
    entry: DesignEntry, region: BenchRegion, count: int, candidates: Mapping[str, Float] | None
) -> tuple[Design, dict[str, Float]]:
    columns = _candidates(region, entry.seed) if candidates is None else _admitted(region, candidates)
    rows = model_rows(columns, entry.model, entry.centres)
    optimal = exchange(rows, count, "D" if entry.method == "d-optimal" else "I", seed=entry.seed)
    chosen = list(optimal.chosen)
    sentence = (
        f"{count_noun(rows.shape[1], 'coefficient')} of the {entry.model} model: log det {optimal.log_det:.6g}, mean "
        f"variance of prediction {optimal.variance:.4g} times that of the noise."
    )
    return Design(sentences=(sentence,)), {name: values[chosen] for name, values in columns.items()}


def _candidates(region: BenchRegion, seed: int) -> dict[str, Float]:
    """Return a grid, as optimal designs lie at corners and middles, and points that fill the rest."""
    grid = factorial(region, CANDIDATES // 2)
    rest = fill(region, CANDIDATES - len(next(iter(grid.values()))), "sobol", seed)
    return {name: np.concatenate([grid[name], rest[name]]) for name in region.ranges}


def _admitted(region: BenchRegion, candidates: Mapping[str, Float]) -> dict[str, Float]:
    region.require_room(candidates, PLACE)
    inside = region.admits(candidates)
    return {name: values[inside] for name, values in candidates.items()}


def _nearest(
    region: BenchRegion, count: int, candidates: Mapping[str, Float], seed: int
) -> tuple[Design, dict[str, Float]]:
    """Choose candidates far from each other, each the one farthest from those before it (maximin)."""
    columns = _admitted(region, candidates)
    stacked = np.unique(np.column_stack([columns[name] for name in region.ranges]), axis=0)
    findings = []
    if len(stacked) < count:
        message = f"there are {count_noun(len(stacked), 'different candidate')}, fewer than the {count} asked for"
        findings.append(Finding(PLACE, message, "Name more candidates.", severity="warning"))
    unit = stacked / np.maximum(np.ptp(stacked, axis=0), 1e-300)
    chosen = [int(np.random.default_rng(seed).integers(len(stacked)))]
    nearest = np.square(unit - unit[chosen[0]]).sum(axis=1)
    # the second point is an end of the region; the first, which is any, gives way to the one farthest from it
    chosen = [int(nearest.argmax())]
    nearest = np.square(unit - unit[chosen[0]]).sum(axis=1)
    while len(chosen) < min(count, len(stacked)):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.square(unit - unit[chosen[-1]]).sum(axis=1))
    return Design(findings=tuple(findings)), {name: stacked[chosen, i] for i, name in enumerate(region.ranges)}


def plan_manoeuvres(entry: DesignEntry, region: BenchRegion) -> Design:
    """Return the manoeuvres of `[design]` as time tables within a region.

    Raises:
        InputError: a manoeuvre does not fit the limits, or two have one name.
    """
    tables = plan_all([_manoeuvre(each) for each in entry.manoeuvres], region, entry.slew, entry.seed)
    names = [each.name or f"{each.kind} {number}" for number, each in enumerate(entry.manoeuvres, 1)]
    for name in {name for name in names if names.count(name) > 1}:
        raise InputError.of(PLACE, f"two manoeuvres are called {name}", "Give each its own name.")
    named = tuple(table.renamed(name) for table, name in zip(tables, names, strict=True))
    sentences = [f"{table.name}: {table.time[-1]:g} s, {table.time.size} samples." for table in named]
    return Design(tables=named, sentences=tuple(sentences), findings=tuple(_resting(entry.manoeuvres, named, region)))


def _resting(entries: Sequence[ManoeuvreEntry], tables: Sequence[TimeTable], region: BenchRegion) -> Iterator[Finding]:
    """Yield a warning for each manoeuvre that ends before it leaves its first level."""
    for entry, table in zip(entries, tables, strict=True):
        wide = [name for name in entry.channels or region.ranges if region.ranges[name][0] < region.ranges[name][1]]
        if wide and not any(np.ptp(table.columns[name]) > 0 for name in wide):
            message = f"nothing moves in {table.name}: it takes {entry.duration:g} s, the first level longer"
            remedy = f"Extend duration, or reduce dwell from {entry.dwell[0]:g} to {entry.dwell[1]:g} s."
            yield Finding(PLACE, message, remedy, severity="warning")


def _manoeuvre(entry: ManoeuvreEntry) -> Manoeuvre:
    return Manoeuvre(entry.kind, entry.duration, entry.dwell, entry.frequency, entry.channels, entry.step)
