"""Planned manoeuvres as time tables: steps, ramps, chirps, and APRBS, within ranges and slew rates.

An APRBS is a sequence of steps of random amplitude and duration, which excites a dynamic model at all operating points
(O. Nelles: Nonlinear System Identification, 2001). Here every step is a ramp at the slew rate of each channel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.region import BenchRegion
from kennfeld.design.space_filling import fill

Kind = Literal["steps", "ramps", "chirp", "aprbs"]
KINDS: tuple[Kind, ...] = ("steps", "ramps", "chirp", "aprbs")
PLACE = Location("design")
WAY_POINTS = (65, 1025, 8193)  # at which a way is checked against the limits
MARGIN = 1e-12  # relative: rounding must not leave a slew rate


@dataclass(frozen=True)
class Manoeuvre:
    """One manoeuvre.

    Attributes:
        kind: `steps` and `aprbs` go to new levels and stay there, `ramps` turn around at once, and a `chirp` swings
            about the middle with a rising frequency.
        duration: in s.
        dwell: shortest and longest time at a level, in s.
        frequency: first and last frequency of a chirp, in Hz.
        channels: those that move; the others stay in the middle of their range. Empty for all.
        step: time step of the table, in s.
    """

    kind: Kind
    duration: float
    dwell: tuple[float, float] = (2.0, 20.0)
    frequency: tuple[float, float] = (0.01, 0.5)
    channels: tuple[str, ...] = ()
    step: float = 0.1


@dataclass(frozen=True, eq=False)
class TimeTable:
    """Set values over time: `columns` by channel, and `time` in s, each Float[samples]."""

    name: str
    time: Float
    columns: Mapping[str, Float]

    def renamed(self, name: str) -> "TimeTable":
        """Return the same table with another name."""
        return replace(self, name=name)


def plan(manoeuvre: Manoeuvre, region: BenchRegion, slew: Mapping[str, float], seed: int = 0) -> TimeTable:
    """Plan a manoeuvre within a region; consecutive samples keep the slew rates.

    Raises:
        InputError: the duration is too short, a channel is unknown, or the limits leave no room.
    """
    _check(manoeuvre, region)
    # rounded, so that a file has 0.3 and not 0.30000000000000004
    time = np.round(manoeuvre.step * np.arange(round(manoeuvre.duration / manoeuvre.step) + 1), 9)
    columns: dict[str, Float] = {}
    for points in WAY_POINTS:
        if manoeuvre.kind == "chirp":
            columns = _chirp(manoeuvre, region, slew, time)
        else:
            columns = _levels(manoeuvre, region, slew, time, seed, points)
        # between the points of a way, a boundary that is not convex may still be crossed
        if region.admits(columns).all():
            break
    _require_inside(region, columns, manoeuvre)
    return TimeTable(manoeuvre.kind, time, columns)


def _check(manoeuvre: Manoeuvre, region: BenchRegion) -> None:
    findings = [
        Finding(PLACE, f"unknown channel {name} of the manoeuvre", f"The ranges are of {', '.join(region.ranges)}.")
        for name in manoeuvre.channels
        if name not in region.ranges
    ]
    low, high = manoeuvre.dwell
    if not 0 <= low <= high:
        findings.append(Finding(PLACE, f"dwell must rise from >= 0, got {low:g} to {high:g}", "Swap them."))
    if not 0 < manoeuvre.frequency[0] <= manoeuvre.frequency[1]:
        message = f"frequency must rise from > 0, got {manoeuvre.frequency[0]:g} to {manoeuvre.frequency[1]:g}"
        findings.append(Finding(PLACE, message, "Swap them."))
    if manoeuvre.kind == "chirp" and manoeuvre.frequency[1] * manoeuvre.step > 0.25:
        message = f"a step of {manoeuvre.step:g} s has fewer than 4 samples per period at {manoeuvre.frequency[1]:g} Hz"
        findings.append(Finding(PLACE, message, f"Use a step of {0.25 / manoeuvre.frequency[1]:.3g} s."))
    if not manoeuvre.duration > manoeuvre.step > 0:
        message = f"duration = {manoeuvre.duration:g} s must exceed the step of {manoeuvre.step:g} s"
        findings.append(Finding(PLACE, message))
    if findings:
        raise InputError(findings)


def _levels(
    manoeuvre: Manoeuvre, region: BenchRegion, slew: Mapping[str, float], time: Float, seed: int, way_points: int
) -> dict[str, Float]:
    """Return ramps between levels that fill the region, each held for a random time; `ramps` are not held."""
    random = np.random.default_rng(seed)
    moving = manoeuvre.channels or tuple(region.ranges)
    inner = BenchRegion({n: s if n in moving else (sum(s) / 2,) * 2 for n, s in region.ranges.items()}, region.limits)
    low, high = (0.0, 0.0) if manoeuvre.kind == "ramps" else manoeuvre.dwell
    most = int(np.ceil(manoeuvre.duration / max(low, manoeuvre.step))) + 2
    levels = fill(inner, min(most, 4096), "sobol", seed)
    points = np.column_stack(list(levels.values()))
    points = points[random.permutation(len(points))]
    rates = np.array([slew.get(name, np.inf) for name in region.ranges])
    knots, corners, at = [0.0], [points[0]], 0
    while knots[-1] < time[-1]:
        knots.append(knots[-1] + float(random.uniform(low, high)))
        corners.append(corners[-1])
        following = _reachable(region, corners[-1], points, at, way_points)
        at += 1
        # all channels arrive together; one step of the table at least
        ways = np.abs(following - corners[-1]) / rates * (1 + MARGIN)
        # two steps more, as samples cut a corner only if it lies between them
        knots.append(knots[-1] + max(float(ways.max()), manoeuvre.step))
        corners.append(following)
    path = np.array(corners)
    return {name: np.interp(time, knots, path[:, i]) for i, name in enumerate(region.ranges)}


def _reachable(region: BenchRegion, here: Float, points: Float, at: int, way_points: int) -> Float:
    """Return a next level to which the straight way stays within the region."""
    names = list(region.ranges)
    for tried in range(len(points)):
        following = points[(at + 1 + tried) % len(points)]
        way = here + np.linspace(0, 1, way_points)[:, None] * (following - here)
        if np.any(following != here) and region.admits({name: way[:, i] for i, name in enumerate(names)}).all():
            return np.asarray(following)
    return here


def _chirp(manoeuvre: Manoeuvre, region: BenchRegion, slew: Mapping[str, float], time: Float) -> dict[str, Float]:
    """Return sines of rising frequency whose amplitude falls where a slew rate demands it.

    Each channel has a phase of its own, so that they do not move together.
    """
    first, last = manoeuvre.frequency
    ratio = last / first
    # exponential chirp: f(t) = first ratio^(t/T), phase = 2 pi first T (ratio^(t/T) - 1) / log ratio
    share = time / time[-1]
    frequency = first * ratio**share
    growth = np.log(ratio)
    cycles = first * time[-1] * (np.expm1(growth * share) / growth if growth > 0 else share)
    moving = manoeuvre.channels or tuple(n for n, (low, high) in region.ranges.items() if high > low)
    columns = {}
    for number, (name, (low, high)) in enumerate(region.ranges.items()):
        if name not in moving:
            columns[name] = np.full(time.size, (low + high) / 2)
            continue
        phase = 2 * np.pi * (cycles * (1 + 0.1 * number) + number / max(len(moving), 1) / 4)
        rate = slew.get(name, np.inf)
        # the amplitude falls with the frequency, so that no sample is steeper than the rate
        amplitude = np.minimum((high - low) / 2, 0.9 * rate / (2 * np.pi * frequency * (1 + 0.1 * number)))
        columns[name] = _limited((low + high) / 2 + amplitude * np.sin(phase), rate * manoeuvre.step)
    return columns


def _limited(values: Float, most: float) -> Float:
    """Limit the change from sample to sample."""
    if not np.isfinite(most) or not np.any(np.abs(np.diff(values)) > most):
        return values
    limited = values.copy()
    for k in range(1, values.size):
        limited[k] = limited[k - 1] + np.clip(values[k] - limited[k - 1], -most, most)
    return limited


def _require_inside(region: BenchRegion, columns: Mapping[str, Float], manoeuvre: Manoeuvre) -> None:
    outside = ~region.admits(columns)
    if outside.any():
        message = f"the {manoeuvre.kind} leaves the limits at {np.count_nonzero(outside)} of {outside.size} samples"
        raise InputError.of(PLACE, message, "Narrow the ranges, or use aprbs, whose levels are chosen within limits.")


def plan_all(
    manoeuvres: Sequence[Manoeuvre], region: BenchRegion, slew: Mapping[str, float], seed: int = 0
) -> list[TimeTable]:
    """Plan several manoeuvres, each by random numbers of its own."""
    return [plan(manoeuvre, region, slew, seed + number) for number, manoeuvre in enumerate(manoeuvres)]
