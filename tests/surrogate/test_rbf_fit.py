import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.parameters import Curve, Map, Scalar
from kennfeld.surrogate.rbf_fit import compress_map, expand_data


@pytest.mark.parametrize("placing", ["k-means", "greedy"])
def test_few_centres_stand_for_many_points(placing):
    x = np.random.default_rng(0).uniform(-1, 1, (500, 2)) * [3000, 50] + [3500, 50]
    y = 100 * np.exp(-((x[:, 0] - 3500) ** 2) / 4e6) + 0.5 * x[:, 1]
    expansion = expand_data(x, y, 25, placing=placing, seed=1)
    assert expansion.size <= 25
    assert np.sqrt(np.mean((expansion(x) - y) ** 2)) < 0.05 * y.std()


def test_noise_is_smoothed_by_the_ridge():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (60, 1))
    truth = np.sin(3 * x[:, 0])
    expansion = expand_data(x, truth + 0.3 * rng.normal(size=60), 30)
    assert np.sqrt(np.mean((expansion(x) - truth) ** 2)) < 0.2


def test_a_plane_needs_no_bells():
    x = np.random.default_rng(0).normal(size=(40, 2))
    expansion = expand_data(x, 3 + x @ [2.0, -1.0], 5)
    far = np.array([[50.0, -70.0]])
    assert expansion(far)[0] == pytest.approx(3 + 100 + 70, rel=1e-6)


def test_a_large_map_is_compressed():
    speed, air = np.linspace(600, 6600, 41), np.linspace(10, 100, 31)
    torque = 3 * air - 40 * np.cos((speed[:, None] - 2500) / 1500) * np.sqrt(air / 100)
    expansion = compress_map(Map("M", speed, air, torque), 40)
    grid = np.stack(np.meshgrid(speed, air, indexing="ij"), axis=-1)
    assert np.abs(expansion(grid) - torque).max() < 0.02 * np.ptp(torque)
    assert expansion.size == 40


def test_a_curve_takes_no_more_centres_than_it_has_points():
    assert compress_map(Curve("C", [0, 1, 2, 3, 4], [0, 1, 4, 9, 16]), 20).size <= 5


def test_incompressible_tables_are_named():
    with pytest.raises(ArgumentError, match="K is a scalar"):
        compress_map(Scalar("K", 1.0))
    with pytest.raises(ArgumentError, match="centres=9 of an expansion"):
        expand_data(np.arange(8.0)[:, None], np.arange(8.0), 9)
    with pytest.raises(ArgumentError, match="placing='grid'"):
        expand_data(np.arange(8.0)[:, None], np.arange(8.0), 2, placing="grid")
