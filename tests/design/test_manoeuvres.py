from itertools import pairwise

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.design import design
from kennfeld.design.manoeuvres import KINDS, Manoeuvre, plan
from kennfeld.design.region import BenchRegion, BoundaryCurve

RANGES = {"speed": (800.0, 6000.0), "load": (10.0, 100.0)}
FULL_LOAD = BoundaryCurve("load", "speed", np.array([800.0, 3000.0, 6000.0]), np.array([60.0, 100.0, 70.0]))
SLEW = {"speed": 300.0, "load": 40.0}


@pytest.mark.parametrize("kind", KINDS)
def test_of_many_samples_none_leaves_the_limits_or_the_slew_rates(kind):
    region = BenchRegion(RANGES, () if kind == "chirp" else (FULL_LOAD,))
    table = plan(Manoeuvre(kind, 10_000.0), region, SLEW)
    assert table.time.size == 100_001
    assert region.admits(table.columns).all()
    for name, rate in SLEW.items():
        assert np.abs(np.diff(table.columns[name])).max() <= 0.1 * rate * (1 + 1e-9)
        assert np.ptp(table.columns[name]) > 0.5 * np.ptp(RANGES[name])


def test_levels_are_held_for_the_dwell_times():
    table = plan(Manoeuvre("aprbs", 2000.0, dwell=(4.0, 9.0)), BenchRegion(RANGES), SLEW)
    moving = (np.diff(table.columns["speed"]) != 0) | (np.diff(table.columns["load"]) != 0)
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    holds = [0.1 * (b - a) for a, b in pairwise(edges) if not moving[a + 1]]
    assert len(holds) > 50
    assert min(holds) > 4.0 - 0.21
    assert max(holds) < 9.0 + 0.01


def test_channels_that_are_not_named_stay_in_the_middle():
    table = plan(Manoeuvre("steps", 60.0, channels=("load",)), BenchRegion(RANGES), SLEW)
    assert {*table.columns["speed"]} == {3400.0}
    assert np.ptp(table.columns["load"]) > 0


def test_the_frequency_of_a_chirp_rises():
    table = plan(Manoeuvre("chirp", 1000.0, frequency=(0.01, 0.2)), BenchRegion(RANGES), {})
    swing = table.columns["load"] - 55.0
    crossings = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    half = crossings.searchsorted(swing.size // 2)
    assert crossings.size - half > 3 * half


@pytest.mark.parametrize(
    ("manoeuvre", "messages"),
    [
        (
            Manoeuvre("aprbs", 60.0, dwell=(9.0, 4.0), channels=("torque",)),
            ["unknown channel torque", "dwell must rise"],
        ),
        (Manoeuvre("chirp", 60.0, frequency=(0.1, 5.0)), ["fewer than 4 samples per period at 5 Hz"]),
        (Manoeuvre("ramps", 0.05), ["must exceed the step"]),
    ],
)
def test_all_problems_of_a_manoeuvre_are_reported(manoeuvre, messages):
    with pytest.raises(kf.InputError) as error:
        plan(manoeuvre, BenchRegion(RANGES), SLEW)
    assert len(error.value.findings) == len(messages)
    for message in messages:
        assert message in str(error.value)


def test_a_chirp_that_crosses_a_limit_is_an_error():
    with pytest.raises(kf.InputError, match="the chirp leaves the limits at"):
        plan(Manoeuvre("chirp", 200.0), BenchRegion(RANGES, (FULL_LOAD,)), SLEW)


def test_a_manoeuvre_that_ends_on_its_first_level_is_a_warning():
    slow = {"kind": "steps", "duration": 5.0, "dwell": (6.0, 8.0), "name": "levels"}
    with pytest.warns(kf.InputWarning, match="nothing moves in levels: it takes 5 s, the first level longer"):
        design(ranges={"speed": (800, 6000)}, manoeuvres=[slow])
    assert not design(ranges={"speed": (800, 6000)}, manoeuvres=[slow | {"duration": 60.0}]).findings
