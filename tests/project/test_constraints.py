"""Shapes, equalities and limits of outputs in a project file."""

import numpy as np
import pytest


def test_a_slope_stays_within_its_limits(shop):
    result = shop.add("[parameters.Gain]\ngradient = { x = [-inf, 0.0005] }").project.calibrate()
    assert np.diff(result.parameters["Gain"].values).max() <= 0.5 * (1 + 1e-9)


def test_a_curvature_stays_within_its_limits(shop):
    result = shop.add('[parameters.Gain]\ncurvature = { x = [2e-7, "inf"] }').project.calibrate()
    assert np.diff(result.parameters["Gain"].values, 2)[0] >= 0.2 * (1 - 1e-9)


def test_a_slope_is_limited_in_a_part_of_a_table(shop):
    limit = "[{ x = [-inf, 0.0005], where = { x = [2000, inf] } }]"
    values = shop.add(f"[parameters.Gain]\ngradient = {limit}").project.calibrate().parameters["Gain"].values
    assert values[2] - values[1] <= 0.5 * (1 + 1e-9)
    assert values[1] - values[0] > 0.6


def test_a_part_without_neighbouring_breakpoints_is_reported(shop):
    shop.add("[parameters.Gain]\ngradient = [{ x = [0, inf], where = { x = [1500, 2500] } }]")
    assert "no 2 neighbouring breakpoints are within its where" in str(shop.project.check())


def test_bounds_are_relative_to_the_start(shop):
    shop.add("[parameters.Gain]\ninitial = [0.5, 0, -2]\nbounds = { relative = 0.1, absolute = 0.1 }")
    gain = shop.project.problem().parameters["Gain"]
    assert gain.lower == pytest.approx([0.4, -0.1, -2.2])
    assert gain.upper == pytest.approx([0.6, 0.1, -1.8])


def test_a_value_of_0_that_a_share_keeps_is_reported(shop):
    shop.add("[parameters.Gain]\ninitial = [0.5, 0, -2]\nbounds = { relative = 0.1 }")
    assert "1 of 3 initial values are 0 and cannot move" in str(shop.project.check())


def test_values_are_made_equal(shop):
    terms = "terms = [{ parameter = 'Gain', at = [1000] }, { parameter = 'Gain', at = 3000, factor = -1 }]"
    result = shop.add(f"[[equality]]\n{terms}").project.calibrate()
    values = result.parameters["Gain"].values
    assert values[0] == pytest.approx(values[2], rel=1e-9)


def test_a_sum_keeps_its_value(shop):
    result = shop.add("[[equality]]\nterms = [{ parameter = 'Gain' }]\nvalue = 5").project.calibrate()
    assert result.parameters["Gain"].values.sum() == pytest.approx(5, rel=1e-9)


def test_an_output_is_limited_if_a_condition_holds(shop):
    result = shop.add("[[limit]]\nnode = 'Predict * 1'\nmax = 25\nwhere = 'n > 2200'").project.calibrate()
    simulated = {data.name: data for data in shop.project.simulate(result.parameters)}["bench"]
    predicted = simulated["Predict"].values
    speed = np.array([1000, 1500, 2000, 2500, 3000, 1200])
    assert predicted[speed > 2200].max() == pytest.approx(25, abs=1e-4)
    assert predicted[speed <= 2200].max() > 25.5


def test_a_limit_may_use_channels_without_another_use(shop):
    shop.bench("bench.csv", Ceiling=np.full(6, 21.0))
    result = shop.add("[[limit]]\nnode = 'base - Ceiling'\nmax = 0").project.calibrate()
    simulated = shop.project.simulate(result.parameters)[0]
    assert simulated["base"].values.max() <= 21 + 1e-4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[limit]]\nnode = 'base'", "min and max are missing"),
        ("[[limit]]\nmax = 3", "[[limit]] 1 node: the key is missing"),
        ("[[limit]]\nnode = 'base'\nmin = 3\nmax = 1", "min = 3 exceeds max = 1"),
        ("[[limit]]\nnode = 'bas'\nmax = 1", "unknown node or channel bas"),
        ("[[limit]]\nnode = 'base'\nmax = 1\nwhere = 'Predict > 3'", "depends on a free parameter"),
        ("[[limit]]\nnode = 'base +'\nmax = 1", "limit"),
        ("[parameters.Gain]\ngradient = { x = [1, 0] }", "lower limit 1 exceeds upper limit 0"),
        ("[parameters.Gain]\ngradient = { x = 3 }", "must be a range of two numbers, got 3"),
        ("[parameters.Gain]\ngradient = { y = [0, 1] }", "Gain has no axis y"),
        ("[parameters.Gain]\ngradient = 3", "must be a table by axis or a list of them, got 3"),
        ("[parameters.Gain]\ngradient = [{ where = { x = [0, 1] } }]", "gradient 1: has no limit"),
        ("[parameters.Gain]\ngradient = [{ x = [0, 1], where = { y = [0, 1] } }]", "Gain has no axis y"),
        ("[parameters.Gain]\ngradient = [{ x = [0, 1], where = { x = [3, 1] } }]", "first and the last axis value"),
        ("[parameters.Gain]\nbounds = {}", "must have a distance from the initial value"),
        ("[parameters.Gain]\nbounds = { relative = -1 }", "must be > 0, got -1"),
        ("[[equality]]\nvalue = 3", "terms: the key is missing"),
        ("[[equality]]\nterms = [{ parameter = 'Gian' }]", "Did you mean Gain?"),
        ("[[equality]]\nterms = [{ parameter = 'Gain', at = [1, 2] }]", "2.0] has 2 coordinates, but Gain has 1 axes"),
        (
            "[parameters.Gain]\nbounds = [0, 1]\npin = [{ at = [1000], value = 0.2 }, { at = [3000], value = 0.1 }]\n"
            "gradient = { x = [0, inf] }",
            "pin of Gain at x = 3000 must be 0.1, but that contradicts slope of Gain along x between 2000 and 3000 "
            "(must be >= 0)",
        ),
        (
            "[parameters.Gain]\nbounds = [0, 1]\npin = [{ at = [1000], value = 2 }]",
            "pin of Gain at x = 1000 must be 2, but bounds and locks keep it between 0 and 1.",
        ),
        (
            "[parameters.Gain]\nlock = true\ngradient = { x = [0.1, inf] }",
            "slope of Gain along x between 1000 and 2000 must be >= 0.1, but bounds and locks fix it at 0; slope of",
        ),
    ],
)
def test_invalid_constraints_are_errors_of_the_check(shop, text, message):
    assert message in shop.add(text).error()


def test_a_limit_looks_up_a_table_elsewhere_than_the_function(shop):
    values = shop.project.calibrate().parameters["Gain"].values
    assert values[2] - values[0] > 1
    result = shop.add("[[limit]]\nnode = 'Gain(3000) - Gain(1000)'\nmax = 0.2").project.calibrate()
    limited = result.parameters["Gain"].values
    assert result.converged
    assert limited[2] - limited[0] == pytest.approx(0.2, abs=1e-6)
