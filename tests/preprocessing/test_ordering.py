import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.preprocessing import samples
from kennfeld.preprocessing.samples import CellNumbering, scored_in_order

X, Y = np.linspace(0, 10, 6), np.array([0.0, 3.0, 5.0])
TABLES = {"M": kf.Map("M", X, Y, np.zeros((6, 3))), "C": kf.Curve("C", X, np.zeros(6)), "K": kf.Scalar("K", 0.0)}


def cells(text, smooth=()):
    parameters = kf.ParameterSet(TABLES.values())
    return CellNumbering(lower_lookups(kf.formula(text, parameters=list(TABLES)).graph, parameters, smooth))


def columns(samples=1000, seed=0):
    random = np.random.default_rng(seed)
    return {"u": random.uniform(-1, 11, samples), "v": random.uniform(-1, 6, samples)}


def cell(values, points):
    """-1 and the number of breakpoints less one are beyond the ends, where a lookup clips."""
    return np.clip(np.searchsorted(points, values, side="right") - 1, 0, points.size - 1)


def numbers(grid, channels):
    return grid.numbers(channels, 0, channels["u"].size)


def test_samples_have_equal_numbers_just_if_they_are_in_the_same_cell():
    channels = columns()
    numbers_of_cells = numbers(cells("y = M(u, v)"), channels)
    pairs = {(n, *at) for n, *at in zip(numbers_of_cells, cell(channels["u"], X), cell(channels["v"], Y), strict=True)}
    assert len({n for n, *_ in pairs}) == len({tuple(at) for _, *at in pairs}) == len(pairs)


@pytest.mark.parametrize("text", ["y = C(u + K)", "y = C(C(u) * v) - C(C(v))", "y = K * u + v"])
def test_what_a_parameter_moves_has_no_cell(text):
    grid, channels = cells(text), columns()
    alike = {n: cell(channels[n], X) for n in "uv" if f"C({n})" in text}
    assert np.unique(numbers(grid, channels)).size == len(set(zip(*alike.values(), strict=True))) if alike else 1


def test_a_smoothed_lookup_has_no_cell():
    assert np.unique(numbers(cells("y = C(u + K)", smooth=["K"]), columns())).size == 1


def test_a_coordinate_may_be_computed_and_undefined():
    channels = columns()
    numbers_of_cells = numbers(cells("y = C(log(u) * 3)"), channels)
    with np.errstate(invalid="ignore"):
        known = cell(np.log(channels["u"]) * 3, X)[channels["u"] > 0]
    assert np.unique(numbers_of_cells).size == np.unique(known).size


def test_tables_beyond_the_finest_number_of_cells_are_left_out(monkeypatch):
    monkeypatch.setattr(samples, "MAX_CELLS", 10)
    channels = columns()
    assert np.unique(numbers(cells("y = M(u, v)"), channels)).size == np.unique(cell(channels["u"], X)).size


@pytest.mark.parametrize("block", [16, 1024])
def test_samples_with_a_target_come_once_and_by_cell_within_each_block(block, monkeypatch):
    monkeypatch.setattr(samples, "SAMPLES_PER_BLOCK", block)
    monkeypatch.setattr(samples, "SAMPLES_PER_LOOKUP", 8)
    grid, channels = cells("y = M(u, v)"), columns(300)
    targets = [np.full(300, np.nan), np.zeros(300)]
    targets[1][::3] = np.nan
    targets[0][3] = 1.0
    orders = list(scored_in_order(channels, targets, grid))
    assert len(orders) == -(-300 // block)
    for number, order in enumerate(orders):
        first, last = number * block, min((number + 1) * block, 300)
        assert sorted(order) == [k for k in range(first, last) if k % 3 or k == 3]
        at = numbers(grid, channels)[order]
        assert np.all(np.diff(at) >= 0)
        assert np.all(np.diff(order)[np.diff(at) == 0] > 0)
