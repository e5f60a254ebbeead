import numpy as np
import pytest

from kennfeld.design.bench_order import arrange

RANDOM = np.random.default_rng(0)
POINTS = {"speed": RANDOM.uniform(800, 6000, 40), "load": RANDOM.uniform(10, 100, 40)}
SLEW = {"speed": 500.0, "load": 20.0}


def rows(columns):
    return sorted(zip(*(values.tolist() for values in columns.values()), strict=True))


def test_the_order_has_the_same_points_and_shorter_ways():
    as_given, sorted_run = (arrange(POINTS, slew=SLEW, sort=sort) for sort in (False, True))
    assert rows(sorted_run.columns) == rows(POINTS)
    assert sorted_run.ramp.sum() < 0.4 * as_given.ramp.sum()


def test_a_ramp_takes_as_long_as_the_slowest_channel():
    run = arrange({"speed": np.array([0.0, 1000.0]), "load": np.array([0.0, 100.0])}, slew=SLEW)
    assert run.ramp.tolist() == [0.0, 5.0]


def test_levels_that_are_hard_to_change_are_measured_in_one_go():
    columns = {**POINTS, "coolant": np.tile([60.0, 90.0, 75.0, 105.0], 10)}
    run = arrange(columns, hard=["coolant"])
    assert rows(run.columns) == rows(columns)
    assert np.count_nonzero(np.diff(run.columns["coolant"])) == 3


def test_each_block_covers_the_region_with_its_share():
    run = arrange(POINTS, blocks=4)
    assert np.bincount(run.block)[1:].tolist() == [10] * 4
    assert (np.diff(run.block) >= 0).all()
    for block in range(1, 5):
        speeds = run.columns["speed"][run.block == block]
        assert np.ptp(speeds) > 0.6 * np.ptp(POINTS["speed"])


def test_replicates_and_repeat_points_are_marked():
    run = arrange(POINTS, replicates=3, repeat_every=10, wait=30.0)
    kinds = np.array(run.kind)
    assert (kinds == "replicate").sum() == 3
    assert kinds[0] == kinds[-1] == "repeat"
    repeated = {float(speed) for speed in run.columns["speed"][kinds == "repeat"]}
    assert len(repeated) == 1
    assert (np.diff(np.flatnonzero(kinds == "repeat"))[:-1] == 11).all()
    assert run.wait.tolist() == [30.0] * kinds.size


@pytest.mark.parametrize("count", [0, 1, 2, 2500])
def test_few_and_many_points_are_arranged(count):
    columns = {"x": np.random.default_rng(1).random(count), "y": np.random.default_rng(2).random(count)}
    run = arrange(columns)
    assert rows(run.columns) == rows(columns)
    if count > 2000:
        way = np.abs(np.diff(np.column_stack([*run.columns.values()]), axis=0)).max(axis=1).sum()
        assert way < 0.2 * np.abs(np.diff(np.column_stack([*columns.values()]), axis=0)).max(axis=1).sum()
