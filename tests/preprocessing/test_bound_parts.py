"""Parts of a bound dataset hold whole pieces, and together all of its samples."""

from dataclasses import replace

import numpy as np
import pytest

from kennfeld import Dataset, formula
from kennfeld.domain.dataset import Settling
from kennfeld.preprocessing.binding import bind_inputs
from kennfeld.preprocessing.bound_parts import divide

MODEL = formula("y = PT1(x, 1.0) + 0 * t").graph
RECORDED = {"x": np.arange(3000.0), "m": np.arange(3000.0) % 7}
STARTS = np.array([0, 700, 800, 1500, 2900])


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr("kennfeld.preprocessing.bound_parts.SAMPLES_PER_BLOCK", 500)


def recording(**attributes):
    time = 0.1 * np.arange(3000)
    return Dataset.of("d", RECORDED, time=time, piece_starts=STARTS, scored=np.arange(3000) % 3 > 0, **attributes)


def with_gaps():
    values = RECORDED["x"].copy()
    values[[0, 5, 650, 699, 700, 1499, 2000, 2999]] = np.nan
    values[2100:2800] = np.nan
    return replace(recording(), channels=Dataset.of("d", {**RECORDED, "x": values}).channels)


@pytest.mark.parametrize("data", [recording(), with_gaps(), recording(warmup=3.0)], ids=["whole", "gaps", "warm-up"])
def test_parts_are_the_dataset(data):
    whole = bind_inputs(data, MODEL, {})
    parts = divide(whole, anywhere=False)
    assert len(parts) > 2
    bounds = [part.bound for part in parts]
    np.testing.assert_array_equal(np.concatenate([b.scored for b in bounds]), whole.scored)
    for name, column in whole.columns.items():
        np.testing.assert_array_equal(np.concatenate([bound.columns[name] for bound in bounds]), column)
    np.testing.assert_array_equal(np.concatenate([b.channel("m") for b in bounds]), whole.channel("m"))
    starts = [bound.starts + part.first for part, bound in zip(parts, bounds, strict=True)]
    np.testing.assert_array_equal(np.concatenate(starts), whole.starts)
    numbers = [bound.kept + part.begin for part, bound in zip(parts, bounds, strict=True)]
    np.testing.assert_array_equal(np.concatenate(numbers), whole.kept)
    assert [part.piece for part in parts] == np.searchsorted(whole.starts, [part.first for part in parts]).tolist()


def test_pieces_are_not_cut():
    whole = bind_inputs(recording(), MODEL, {})
    assert [part.first for part in divide(whole, anywhere=False)] == [0, 700, 1500, 2900]


def test_points_without_memory_are_divided_anywhere():
    whole = bind_inputs(Dataset.of("d", RECORDED), formula("y = 2 * x").graph, {})
    parts = divide(whole, anywhere=True)
    assert [part.first for part in parts] == [0, 500, 1000, 1500, 2000, 2500]
    np.testing.assert_array_equal(np.concatenate([part.bound.columns["x"] for part in parts]), RECORDED["x"])


def test_parts_are_views():
    whole = bind_inputs(recording(), MODEL, {})
    part = divide(whole, anywhere=False)[1].bound
    assert np.shares_memory(part.inputs["x"], whole.inputs["x"])
    assert np.shares_memory(part.dataset["m"].values, whole.dataset["m"].values)


def test_points_that_are_held_stay_together():
    data = Dataset.of("d", RECORDED, settling=Settling(1.0, step=0.1))
    whole = bind_inputs(data, MODEL, {}, 0.1)
    (part,) = divide(whole, anywhere=False)
    assert part.bound is whole
