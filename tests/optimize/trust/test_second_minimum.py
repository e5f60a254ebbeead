"""Minima of equal cost in which two factors of a product change places."""

import numpy as np
import pytest

import kennfeld as kf

SPEED, LOAD = np.linspace(1000, 6000, 4), np.array([0.0, 100.0])
PIN = kf.Pin("C", (0.0,), 1.0)


def map_times_curve(start, *, rise=0.348, noise=0.1, seed=0):
    """Fit a map that rises with load by a factor of 1 + rise, times a curve over the same load that rises by 1.2.

    The rise may differ between speeds; then the factors cannot change places.
    """
    rng = np.random.default_rng(seed)
    n, load = rng.uniform(1000, 6000, 800), rng.uniform(0, 100, 800)
    values = (50 + 0.01 * SPEED)[:, None] * (1 + np.multiply.outer(np.broadcast_to(rise, 4), LOAD / 100))
    truth = kf.ParameterSet([kf.Map("M", SPEED, LOAD, values), kf.Curve("C", LOAD, [1.0, 1.2])])
    data = {"n": n, "L": load}
    clean = kf.simulate("y = M(n, L) * C(L)", data, truth)["y"].values
    tables = [kf.Map("M", SPEED, LOAD, np.full((4, 2), 80.0)), kf.Curve("C", LOAD, [1.0, start])]
    data["m"] = clean + noise * rng.standard_normal(n.size)
    return kf.calibrate("y = M(n, L) * C(L)", data, kf.ParameterSet(tables), "m", pins=[PIN])


@pytest.mark.parametrize(
    ("start", "rise"),
    [
        (1.0, 0.348),
        (0.2, -0.6),
        pytest.param(2.0, 0.348, marks=pytest.mark.slow),
        pytest.param(1.0, -0.6, marks=pytest.mark.slow),
    ],
)
def test_a_second_minimum_of_equal_cost_is_reported_and_counts_as_error(start, rise):
    result = map_times_curve(start, rise=rise)
    fitted, deviation = float(result.parameters["C"].values[1]), float(result.trust.deviation["C"][1])
    opposite = max((1.2, 1 + rise), key=lambda value: abs(value - fitted))
    assert abs(fitted - opposite) == pytest.approx(abs(rise - 0.2), abs=0.03)
    assert abs(1.2 - fitted) < 2 * deviation
    first = result.trust.directions[0]
    assert first.sentence.startswith("Other values fit equally well (cost ")
    assert fitted + first.parts["C"][1] == pytest.approx(opposite, abs=0.03)
    assert first.remedy.startswith("Pin a known value of C")
    assert not any("determined" in str(direction) for direction in result.trust.directions)


@pytest.mark.slow
def test_the_minima_of_several_pairs_of_factors_are_reported():
    """Each of two cells has two solutions, and the factor at the second breakpoint is the same in two of the four."""
    rng = np.random.default_rng(0)
    n, load = rng.uniform(1000, 6000, 1500), rng.uniform(0, 100, 1500)
    loads = np.array([0.0, 50.0, 100.0])
    rise, factor = np.interp(load, loads, [1.0, 1.3, 1.35]), np.interp(load, loads, [1.0, 1.1, 1.25])
    data = {"n": n, "L": load, "m": (50 + 0.01 * n) * rise * factor + 0.1 * rng.standard_normal(n.size)}
    tables = [kf.Map("M", SPEED, loads, np.full((4, 3), 80.0)), kf.Curve("C", loads, [1.0, 1.4, 1.4])]
    result = kf.calibrate("y = M(n, L) * C(L)", data, kf.ParameterSet(tables), "m", pins=[PIN])
    fitted = result.parameters["C"].values
    minima = [fitted, *(fitted + direction.parts["C"] for direction in result.trust.directions)]
    assert sorted(float(values[1]) for values in minima) == pytest.approx([1.1, 1.1, 1.3, 1.3], abs=0.03)
    assert all(direction.sentence.startswith("Other values fit") for direction in result.trust.directions)
    assert np.all(np.abs([1.1, 1.25] - fitted[1:]) < 2 * result.trust.deviation["C"][1:])


def test_a_product_without_a_second_minimum_is_coupled_but_determined():
    result = map_times_curve(1.0, rise=[0.0, 0.2, 0.5, -0.3], noise=0.01)
    (direction,) = result.trust.directions
    assert direction.determined
    assert "coupled, but determined" in direction.sentence
    assert result.trust.deviation["C"][1] < 0.01
    assert abs(result.parameters["C"].values[1] - 1.2) < 0.01


@pytest.mark.slow
def test_two_deviations_contain_the_truth_in_both_minima():
    inside = []
    for seed in range(20):
        result = map_times_curve(1.0 + seed % 2, seed=seed)
        inside.append(abs(1.2 - result.parameters["C"].values[1]) < 2 * result.trust.deviation["C"][1])
    assert np.mean(inside) > 0.9
