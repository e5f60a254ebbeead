"""Breakpoints that are fitted: the keys of an axis that say so."""

import json
from dataclasses import replace

import numpy as np
import pytest

from kennfeld.analysis.limit_margins import active_constraints
from kennfeld.calfiles import read as read_parameters
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.project.results import write


def axis(shop, name="Gain"):
    assert shop.errors() == []
    return shop.project.problem().parameters[name].axes[0]


def gain(shop, x, more=""):
    shop.add(f"[parameters.Gain]\nx = {x}\n{more}")
    return shop


@pytest.mark.parametrize(
    ("x", "points"),
    [
        ('{ breakpoints = "free" }', [1000, 2000, 3000]),
        ("{ free = true }", [1000, 2000, 3000]),
        ("{ breakpoints = [1000, 1200, 3000], free = true }", [1000, 1200, 3000]),
        ('{ begin = 1000, end = 3000, count = 5, breakpoints = "free" }', [1000, 1500, 2000, 2500, 3000]),
        ('{ input = "Speed", count = 3, breakpoints = "free" }', [1000, 1750, 3000]),
        ("{ input = 'Speed', count = 3, free = true }", [1000, 1750, 3000]),
    ],
)
def test_a_free_axis_starts_at_its_breakpoints_or_those_of_the_file(shop, x, points):
    free_axis = axis(gain(shop, x))
    assert free_axis.free
    assert free_axis.breakpoints.tolist() == points


def test_an_axis_is_fixed_by_default(shop):
    assert not axis(shop).free
    assert not axis(gain(shop, "{ breakpoints = [1000, 1200, 3000], free = false }")).free


def test_an_axis_has_its_distance_and_range(shop):
    free_axis = axis(gain(shop, '{ breakpoints = "free", min_distance = 100, range = [900, 3100] }'))
    assert (free_axis.min_distance, free_axis.range) == (100.0, (900.0, 3100.0))


def test_a_group_axis_is_freed_in_its_section(shop):
    shop.add('[axes.AxisSpeed]\ninput = "Speed"\nbegin = 1000\nend = 3000\ncount = 4\nbreakpoints = "free"')
    free_axis = axis(gain(shop, '{ axis = "AxisSpeed" }'))
    assert (free_axis.name, free_axis.free, len(free_axis)) == ("AxisSpeed", True, 4)


def test_a_group_axis_of_the_initial_file_can_be_freed(shop):
    speed = Axis([1000, 2000, 3000], name="AxisSpeed")
    shop.values("start.json", Curve("Gain", speed, [1.0, 1.0, 1.0]), Scalar("offset", 0.0))
    shop.add("[axes.AxisSpeed]\nfree = true")
    gain(shop, '{ axis = "AxisSpeed" }')
    free_axis = axis(shop)
    assert (free_axis.free, free_axis.breakpoints.tolist()) == (True, [1000, 2000, 3000])


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        ('{ breakpoints = "fre" }', "[parameters.Gain] x breakpoints: must be a number, got 'fre'"),
        ('{ breakpoints = "free", free = false }', 'breakpoints = "free" contradicts free = false'),
        ("{ breakpoints = [1, 2], range = [0, 3] }", "x range: requires free breakpoints"),
        ("{ breakpoints = [1, 2], min_distance = 1 }", "x min_distance: requires free breakpoints"),
        ('{ breakpoints = "free", range = [3000, 1000] }', "x range: must be the lowest and the highest breakpoint"),
        ('{ breakpoints = "free", range = 3 }', "Write range = [lowest, highest]."),
        ('{ breakpoints = "free", min_distance = 0 }', "x min_distance: must be > 0, got 0"),
        ("{ free = 1 }", "x free: must be true or false, got 1"),
        (
            '{ breakpoints = "free", range = [1100, 3000] }',
            "[parameters.Gain] x: range=(1100, 3000) of axis Speed must contain all its breakpoints, 1000 to 3000",
        ),
        (
            '{ breakpoints = "free", min_distance = 1500 }',
            "min_distance=1500 of axis Speed exceeds the distance of its breakpoints 1000 and 2000",
        ),
        ('{ axis = "A", free = true }', "the keys of a group axis belong in its own section"),
        ('{ breakpoints = "free", begin = 1 }', "the axis has"),
    ],
)
def test_an_invalid_free_axis_is_one_finding(shop, x, expected):
    if '"A"' in x:
        shop.add("[axes.A]\nbreakpoints = [1000, 3000]")
    assert expected in gain(shop, x).error()


def test_a_free_axis_without_a_start_is_a_finding(shop):
    shop.values("start.json", Scalar("offset", 0.0))
    message = gain(shop, '{ breakpoints = "free" }', "initial = 1.0").error()
    assert "[parameters.Gain] x: breakpoints are free, but no initial file has any. Write" in message


def test_a_free_group_axis_without_a_start_is_a_finding(shop):
    shop.add("[axes.AxisSpeed]\nfree = true")
    assert "but the initial files have no group axis AxisSpeed" in gain(shop, '{ axis = "AxisSpeed" }').error()


def test_a_table_on_a_free_axis_that_is_not_fitted_is_a_finding(shop):
    speed = Axis([1000, 2000, 3000], name="AxisSpeed")
    shop.values("start.json", Curve("Gain", speed, [1.0] * 3), Curve("Drag", speed, [1.0] * 3), Scalar("offset", 0.0))
    shop.add("[axes.AxisSpeed]\nfree = true")
    message = gain(shop, '{ axis = "AxisSpeed" }').error()
    assert "[axes.AxisSpeed]: its breakpoints are free, but Drag on it is not fitted" in message


def test_free_breakpoints_of_a_table_that_is_not_fitted_are_a_warning(shop):
    message = gain(shop, '{ breakpoints = "free" }', "free = false").warning()
    assert "[parameters.Gain] x: the breakpoints of Gain.x are free, but no table with this axis is fitted" in message


def test_breakpoints_that_cannot_move_are_a_warning(shop):
    message = gain(shop, "{ breakpoints = [1000, 3000], free = true }").warning()
    assert "no breakpoint of Gain.x can move" in message


def test_a_project_fits_breakpoints_and_writes_them(shop, tmp_path):
    speed = np.linspace(1000, 3000, 201)
    load = 10.0 + np.arange(speed.size) % 4
    torque = np.interp(speed, [1000, 1370, 3000], [1, 2, 3]) * load + 5
    shop.bench("bench.csv", speed, **{"Load": load, "Torque [Nm]": torque})
    gain(shop, '{ breakpoints = "free" }')
    project = shop.project
    result = project.calibrate()
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["Gain"].axes[0].breakpoints, [1000, 1370, 3000], atol=1e-3)
    write(result, project, tmp_path / "results")
    written = json.loads((tmp_path / "results" / "parameters.json").read_text())
    assert written["Gain"]["x"][1] == pytest.approx(1370, abs=1e-3)
    moved = json.loads((tmp_path / "results" / "result.json").read_text())["breakpoints"]["Gain.x"]
    assert (moved["before"][1], moved["after"][1]) == (2000.0, written["Gain"]["x"][1])
    assert result.quality[0].rmse_after < 1e-4


def test_pins_and_gradients_hold_with_free_breakpoints(shop):
    speed = np.linspace(1000, 3000, 201)
    load = 10.0 + np.arange(speed.size) % 4
    torque = np.interp(speed, [1000, 1370, 2600, 3000], [1, 2, 2.5, 4]) * load + 5
    shop.bench("bench.csv", speed, **{"Load": load, "Torque [Nm]": torque})
    more = "initial = 1.0\npin = [{ at = [1000], value = 1.0 }]\ngradient = { x = [0, 0.0025] }"
    gain(shop, "{ begin = 1000, end = 3000, count = 5, free = true }", more)
    result = shop.project.calibrate()
    table = result.parameters["Gain"]
    slopes = np.diff(table.values) / np.diff(table.axes[0].breakpoints)
    assert slopes.min() >= -1e-12
    assert slopes.max() <= 0.0025 * (1 + 1e-8)
    assert table.values[0] == pytest.approx(1.0, abs=1e-9)
    assert "Gain.x" in result.moved
    (pressed,) = active_constraints(shop.project.problem(), result.parameters)
    assert len(pressed.active) == np.count_nonzero(np.abs(slopes - 0.0025) < 1e-9) > 0


def test_the_result_of_parameters_from_a_file_lists_moved_breakpoints(shop):
    shop.values(
        "start.json", Curve("Gain", Axis([1000, 2000, 3000], name="AxisSpeed"), [1.0] * 3), Scalar("offset", 0.0)
    )
    result = gain(shop, '{ breakpoints = "free" }').project.calibrate()
    result.parameters.save(shop.folder / "end.json")
    again = replace(result, parameters=read_parameters(shop.folder / "end.json"))
    assert again.moved.keys() == result.moved.keys()
    np.testing.assert_array_equal(again.moved["AxisSpeed"][1], result.moved["AxisSpeed"][1])


def test_a_saved_search_resumes_with_its_breakpoints(shop):
    speed = np.linspace(1000, 3000, 201)
    load = 10.0 + np.arange(speed.size) % 4
    torque = np.interp(speed, [1000, 1370, 3000], [1, 2, 3]) * load + 5
    shop.bench("bench.csv", speed, **{"Load": load, "Torque [Nm]": torque})
    gain(shop, '{ breakpoints = "free" }').add("[optimizer]\nsave_every = 1")
    first = shop.project.calibrate()
    again = shop.project.calibrate(resume=True)
    np.testing.assert_allclose(again.parameters["Gain"].axes[0].breakpoints, [1000, 1370, 3000], atol=1e-3)
    assert again.cost_after <= first.cost_after * (1 + 1e-6) + 1e-12
    assert len(again.trace) < len(first.trace)
