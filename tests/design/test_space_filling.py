import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import Location
from kennfeld.design import space_filling
from kennfeld.design.region import BenchRegion, DataEnvelope, RegionCondition
from kennfeld.design.space_filling import FILLINGS, factorial, fill
from kennfeld.models.formula import expression

RANGES = {"n": (800.0, 6000.0), "l": (10.0, 100.0)}


def condition(text, **options):
    return RegionCondition(text, expression(text, Location("where")), **options)


TRIANGLE = BenchRegion(RANGES, [condition("l < n / 60"), condition("n > 5000 and l > 80", forbidden=True)])


@pytest.mark.parametrize("kind", FILLINGS)
def test_of_many_points_none_is_outside_the_limits(kind):
    points = fill(TRIANGLE, 20_000, kind)
    count = points["n"].size
    assert count == 20_000 or (kind == "factorial" and 18_000 < count <= 20_000)
    assert (points["l"] < points["n"] / 60).all()
    assert not ((points["n"] > 5000) & (points["l"] > 80)).any()
    for name, (low, high) in RANGES.items():
        assert low <= points[name].min()
        assert points[name].max() <= high


@pytest.mark.parametrize("kind", ["sobol", "lhs"])
def test_points_fill_a_region_more_evenly_than_chance(kind):
    from scipy.stats import qmc  # loaded when the test runs: it takes a second

    points = fill(BenchRegion({"x": (0.0, 1.0), "y": (0.0, 1.0)}), 64, kind)
    chance = np.random.default_rng(0).random((20, 64, 2))
    usual = np.mean([qmc.discrepancy(sample) for sample in chance])
    assert qmc.discrepancy(np.column_stack([*points.values()])) < usual / 2


def test_the_same_seed_gives_the_same_points():
    first, again, other = (fill(TRIANGLE, 20, "sobol", seed)["n"] for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_factorial_has_as_many_points_as_fit():
    points = factorial(BenchRegion({"x": (0.0, 1.0), "y": (0.0, 1.0), "z": (5.0, 5.0)}), 13)
    assert len(points["x"]) == 12
    assert {*points["z"]} == {5.0}


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ([condition("l > 200")], "no point within the ranges satisfies l > 200"),
        ([condition("l > 50"), condition("l < 40")], "no point satisfies all limits"),
    ],
)
@pytest.mark.parametrize("kind", FILLINGS)
def test_contradictory_limits_are_an_error(limits, message, kind, monkeypatch):
    monkeypatch.setattr(space_filling, "EMPTY", 10_000)
    with pytest.raises(kf.InputError, match=message):
        fill(BenchRegion(RANGES, limits), 5, kind)


def test_an_envelope_has_the_data_and_what_lies_between():
    random = np.random.default_rng(0)
    data = {name: random.normal(size=200) for name in ("a", "b", "c")} | {"d": np.full(200, 2.0)}
    envelope = DataEnvelope(data)
    assert envelope.admits(data).all()
    middle = {name: np.array([values.mean(), 9.0]) for name, values in data.items()}
    assert envelope.admits(middle).tolist() == [True, False]
    assert not envelope.admits({name: values[:1] + (name == "d") for name, values in data.items()}).any()


def test_an_envelope_of_points_on_a_line_has_no_volume_but_holds_them():
    x = np.linspace(0, 1, 11)
    envelope = DataEnvelope({"x": x, "y": 2 * x})
    assert envelope.admits({"x": np.array([0.5, 0.5]), "y": np.array([1.0, 1.5])}).tolist() == [True, False]


def test_the_envelope_of_many_channels_is_that_of_their_pairs():
    random = np.random.default_rng(1)
    a = random.uniform(0, 1, 300)
    data = {"a": a, "b": a + random.uniform(0, 0.1, 300)} | {name: random.uniform(0, 1, 300) for name in "cdef"}
    off = {name: np.array([0.5]) for name in "cdef"}
    envelope = DataEnvelope(data)
    assert envelope.admits({"a": np.array([0.5]), "b": np.array([0.55]), **off}).all()
    assert not envelope.admits({"a": np.array([0.5]), "b": np.array([0.9]), **off}).any()
