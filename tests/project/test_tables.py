"""Parameters of a project: initial files, sections that override them, axes, bounds, locks, pins."""

import numpy as np
import pytest

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Curve, Map, Scalar
from kennfeld.domain.rbf import RBF, Expansion
from kennfeld.project import Project


def problem(shop):
    assert shop.errors() == []
    return shop.project.problem()


def gain(shop):
    return problem(shop).parameters["Gain"]


def test_the_initial_file_defines_the_start(shop):
    assert gain(shop) == Curve("Gain", Axis([1000, 2000, 3000], input="Speed"), [1.0, 1.0, 1.0])


def test_values_of_later_files_take_precedence(shop):
    shop.values("late.json", Scalar("offset", 7.0))
    shop.change('initial = "start.json"', 'initial = ["start.json", "late.json"]')
    parameters = problem(shop).parameters
    assert (parameters["offset"].value, parameters["Gain"].size) == (7.0, 3)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (
            Curve("Gain", [1000, 2000], [1, 1]),
            "Gain is a curve of 3 values in start.json and a curve of 2 values in b.js",
        ),
        (Curve("Gain", [1, 2, 3], [1, 1, 1]), "Gain has different breakpoints in start.json and b.json"),
        (Scalar("Gain", 1), "Gain is a curve of 3 values in start.json and a scalar in b.json"),
    ],
)
def test_files_that_define_a_name_differently_are_a_finding(shop, other, expected):
    shop.values("b.json", other)
    shop.change('initial = "start.json"', 'initial = ["start.json", "b.json"]')
    assert expected in shop.error()


def test_a_later_file_has_another_grid_if_the_project_states_the_axes(shop):
    shop.values("b.json", Curve("Gain", [1000, 2000], [5, 6]))
    shop.change('initial = "start.json"', 'initial = ["start.json", "b.json"]')
    shop.add("[parameters.Gain]\nx = { breakpoints = [1000, 1500, 2000, 3000] }")
    assert gain(shop).values.tolist() == [5.0, 5.5, 6.0, 6.0]


def test_fitted_breakpoints_of_a_group_axis_take_the_place_of_those_of_an_earlier_file(shop):
    def shared(points):
        return Axis(points, input="Speed", name="AxisSpeed")

    first = shared([1000, 2000, 3000])
    shop.values("start.json", Curve("Gain", first, [0, 10, 20]), Curve("B", first, [0, 1, 2]), Scalar("offset", 0))
    shop.values("b.json", Curve("Gain", shared([1000, 2500, 3000]), [0, 30, 40]))
    shop.change('initial = "start.json"', 'initial = ["start.json", "b.json"]')
    shop.add("[axes.AxisSpeed]\nfree = true")
    parameters = problem(shop).parameters
    assert {name: parameters[name].values.tolist() for name in ("Gain", "B")} == {
        "Gain": [0.0, 30.0, 40.0],
        "B": [0.0, 1.5, 2.0],
    }
    assert parameters["B"].axes[0] == parameters["Gain"].axes[0]


CENTRES = ([0.0], [2.0, 1.0], [[3.0], [5.0]], [[0.5], [0.5]])


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (Expansion(1.0, *CENTRES, kernel="matern52"), "different kernels"),
        (Expansion(1.0, *CENTRES, hinges=((0, 2.0, 1.0),)), "different hinges"),
        (Expansion(1.0, [0.0, 1.0], [2.0], [[3.0, 1.0]], [[0.5, 0.5]]), "different numbers of inputs"),
    ],
)
def test_expansions_whose_values_mean_different_functions_are_a_finding(shop, other, expected):
    for name, expansion in (("a", Expansion(1.0, *CENTRES)), ("b", other)):
        shop.values(f"{name}.json", RBF("Model", expansion))
    shop.change('initial = "start.json"', 'initial = ["start.json", "a.json", "b.json"]')
    assert f"Model has {expected} in a.json and b.json" in shop.error()


def test_the_later_of_two_expansions_of_the_same_form_takes_precedence(shop):
    for name, offset in (("a", 1.0), ("b", 3.0)):
        shop.values(f"{name}.json", RBF("Model", Expansion(offset, *CENTRES, kernel="matern52")))
    shop.change('initial = "start.json"', 'initial = ["start.json", "a.json", "b.json"]')
    assert problem(shop).parameters["Model"].values[0] == 3.0


def test_files_that_disagree_on_a_group_axis_are_a_finding(shop):
    for name, points in (("A", [0, 1]), ("B", [0, 2])):
        shop.values(f"{name}.json", Curve(name, Axis(points, name="Shared"), [0, 0]))
    shop.change('initial = "start.json"', 'initial = ["start.json", "A.json", "B.json"]')
    assert "group axis Shared has different breakpoints" in shop.error()


def test_a_missing_initial_file_is_the_only_finding(shop):
    shop.change('"start.json"', '"strat.json"')
    assert "[calibration] initial: file strat.json does not exist. Did you mean start.json?" in shop.error()


def test_errors_of_formula_text_are_reported_without_an_initial_file(shop):
    shop.text += "more = 2 *\n"
    assert len(shop.change('"start.json"', '"strat.json"').errors()) == 2


def test_a_truncated_calibration_file_is_a_finding(shop):
    content = (shop.folder / "start.json").read_bytes()
    shop.write("start.json", content[: len(content) // 2])
    assert shop.errors()
    assert all(error.startswith("start.json") for error in shop.errors())


def test_a_section_overrides_the_file(shop):
    shop.add("[parameters.Gain]\nunit = 'Nm'\ndescription = 'd'\ninitial = [1, 2, 3]\nextrapolation = 'linear'")
    table = gain(shop)
    assert (table.unit, table.description, table.extrapolation) == ("Nm", "d", "linear")
    assert table.values.tolist() == [1, 2, 3]
    assert table.axes[0].input == "Speed"


def test_a_single_number_fills_a_table(shop):
    assert gain(shop.add("[parameters.Gain]\ninitial = 2")).values.tolist() == [2, 2, 2]


def test_parameters_can_be_defined_in_the_project_alone(shop):
    shop.change('initial = "start.json"', "")
    shop.add("[parameters.Gain]\nx = { input = 'Speed', begin = 1000, end = 3000, count = 5 }\ninitial = 1")
    shop.add("[parameters.offset]\ninitial = 3\nunit = 'Nm'")
    parameters = problem(shop).parameters
    assert parameters["Gain"].axes[0] == Axis([1000, 1500, 2000, 2500, 3000], input="Speed", unit="rpm")
    assert parameters["offset"] == Scalar("offset", 3.0, unit="Nm")


def test_quantiles_spread_the_breakpoints_over_the_training_data(shop):
    shop.add("[parameters.Gain]\nx = { input = 'Speed', count = 3 }")
    assert gain(shop).axes[0].breakpoints.tolist() == [1000, 1750, 3000]


def test_an_axis_without_input_has_that_of_its_lookup(shop):
    shop.add("[parameters.Gain]\nx = { count = 2 }")
    assert gain(shop).axes[0] == Axis([1000, 3000], input="Speed", unit="rpm")


def test_equal_quantiles_are_merged_with_a_warning(shop):
    shop.bench("bench.csv", [1000] * 6 + [2000])
    shop.add("[parameters.Gain]\nx = { input = 'Speed', count = 5 }")
    assert "[parameters.Gain] x: only 2 of 5 quantiles of Speed differ" in shop.warnings()[0]


UNEVEN = (703.2, 805.9536, 836.145, 1502.7)


def test_quantiles_are_rounded_and_a_remark_lists_them(shop):
    shop.bench("bench.csv", UNEVEN)
    shop.add("[parameters.Gain]\nx = { count = 4 }")
    remark = "quantiles of Speed are rounded to multiples of 1 to 20, the ends outwards: 700, 806, 836, 1520."
    assert [str(finding) for finding in shop.findings()] == [
        f"kennfeld.toml [parameters.Gain] x: {remark} Write round = false to use them as computed."
    ]
    assert gain(shop).axes[0].breakpoints.tolist() == [700, 806, 836, 1520]


def test_rounding_can_be_switched_off(shop):
    shop.bench("bench.csv", UNEVEN)
    shop.add("[parameters.Gain]\nx = { count = 4, round = false }")
    assert shop.findings() == []
    np.testing.assert_allclose(gain(shop).axes[0].breakpoints, UNEVEN)


def test_a_rounded_group_axis_is_reported_once(shop):
    shop.text = "Predict = Gain(Speed) * Load + More(Speed) + offset\n"
    shop.bench("bench.csv", UNEVEN)
    shop.add("[axes.AxisSpeed]\ninput = 'Speed'\ncount = 4")
    for name in ("Gain", "More"):
        shop.add(f"[parameters.{name}]\nx = {{ axis = 'AxisSpeed' }}\ninitial = 1")
    assert len(shop.findings()) == 1
    assert gain(shop).axes[0].breakpoints.tolist() == [700, 806, 836, 1520]


def test_very_close_quantiles_are_merged_with_a_warning(shop):
    shop.bench("bench.csv", [700, 800, 800.0001, 900, 1000, 1100])
    shop.add("[parameters.Gain]\nx = { count = 6 }")
    assert "only 5 of 6 quantiles of Speed differ; very close ones are merged" in shop.warning()
    assert gain(shop).axes[0].breakpoints.tolist() == [700, 800, 900, 1000, 1100]


@pytest.mark.parametrize("limits", ["range = [703, 1503]", "min_distance = 30.15"])
def test_rounding_does_not_violate_the_limits_of_free_breakpoints(shop, limits):
    shop.bench("bench.csv", UNEVEN)
    shop.add(f"[parameters.Gain]\nx = {{ count = 4, free = true, {limits} }}")
    assert shop.errors() == []
    np.testing.assert_allclose(gain(shop).axes[0].breakpoints, UNEVEN)


def test_rounding_of_written_breakpoints_is_an_error(shop):
    shop.add("[parameters.Gain]\nx = { breakpoints = [1000, 2000, 3000], round = true }")
    assert "round: applies to quantiles of the training data only" in shop.error()


def test_quantiles_of_a_node_that_depends_only_on_data_are_computed(shop):
    shop.text = "half = Speed / 2\nbase = Gain(half) * Load\nPredict = base + offset\n"
    shop.add("[parameters.Gain]\nx = { input = 'half', count = 2 }")
    assert gain(shop).axes[0].breakpoints.tolist() == [500, 1500]


@pytest.mark.parametrize(
    ("quantity", "expected"),
    [
        ("base", "the values of base depend on parameters (Gain). Write begin, end and count, or breakpoints"),
        ("Sped", "unknown input, node or channel Sped. Did you mean Speed?"),
    ],
)
def test_quantiles_of_parameters_or_unknown_names_are_a_finding(shop, quantity, expected):
    assert expected in shop.add(f"[parameters.Gain]\nx = {{ input = '{quantity}', count = 3 }}").error()


def test_other_axes_without_values_interpolate_those_of_the_file(shop):
    shop.values("start.json", Curve("Gain", [1000, 2000, 3000], [1.0, 2.0, 4.0]), Scalar("offset", 0))
    shop.add("[parameters.Gain]\nx = { breakpoints = [1000, 2500, 5000] }")
    assert gain(shop).values.tolist() == [1, 3, 4]


def test_maps_are_regridded_along_both_axes(shop):
    shop.text = "Predict = M(Speed, Load) + offset * 0\n"
    old = Map("M", [1000, 3000], [10, 20], [[0.0, 1.0], [2.0, 3.0]])
    shop.values("start.json", old, Scalar("offset", 0))
    shop.add("[parameters.M]\ny = { breakpoints = [10, 15, 20] }")
    assert problem(shop).parameters["M"].values.tolist() == [[0, 0.5, 1], [2, 2.5, 3]]


def test_tables_of_one_group_axis_share_it(shop):
    shop.text = "Predict = Gain(Speed) * Load + More(Speed) + offset\n"
    shop.add("[axes.AxisSpeed]\ninput = 'Speed'\nbreakpoints = [1000, 2000, 3000]")
    for name in ("Gain", "More"):
        shop.add(f"[parameters.{name}]\nx = {{ axis = 'AxisSpeed' }}\ninitial = 1")
    parameters = problem(shop).parameters
    assert parameters["Gain"].axes[0] is parameters["More"].axes[0]
    assert parameters.axes == (Axis([1000, 2000, 3000], "Speed", "rpm", "AxisSpeed"),)


def test_a_group_axis_of_the_initial_file_can_be_named(shop):
    shared = Axis([1000, 2000, 3000], input="Speed", name="AxisSpeed")
    shop.values("start.json", Curve("Other", shared, [0, 0, 0]), Scalar("offset", 0))
    shop.add("[parameters.Gain]\nx = { axis = 'AxisSpeed' }\ninitial = 1")
    assert gain(shop).axes[0] == shared


def test_an_unknown_group_axis_is_a_finding(shop):
    shop.add("[axes.AxisSpeed]\nbreakpoints = [0, 1]\n[parameters.Gain]\nx = { axis = 'AxisSped' }")
    assert "[parameters.Gain] x: unknown group axis AxisSped. Did you mean AxisSpeed?" in shop.error()


def test_a_group_axis_that_the_file_and_the_project_define_differently_is_a_finding(shop):
    shared = Axis([1000, 2000, 3000], name="AxisSpeed")
    shop.values("start.json", Curve("Gain", shared, [0, 0, 0]), Curve("B", shared, [0, 0, 0]), Scalar("offset", 0))
    shop.add("[axes.AxisSpeed]\nbreakpoints = [0, 1]\n[parameters.Gain]\nx = { axis = 'AxisSpeed' }")
    assert "[axes]: group axis AxisSpeed has different breakpoints in" in shop.error()


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        (
            "initial = [1, 2]",
            "[parameters.Gain] initial: has 2 values, but the axes require 3. Write one value per breakpoint.",
        ),
        (
            "y = { breakpoints = [0, 1] }\ninitial = [[1, 2, 3], [1, 2, 3]]",
            "It seems to be transposed: write one row per x",
        ),
        ("y = { breakpoints = [0, 1] }", "the initial file has a curve of 3 values, but the axes require 3 x 2"),
        ("z = { breakpoints = [0, 1] }\ninitial = 0", "[parameters.Gain] y: the axis is missing"),
        ("bounds = [[0, 0], 1]", "[parameters.Gain] bounds: has 2 values, but the axes require 3"),
        (
            "bounds = [2, [1, 3, 3]]",
            "bounds: lower bound 2 exceeds upper bound 1 at value 1. Swap them.",
        ),
        ("smoothness = { y = 1 }", "[parameters.Gain] smoothness: Gain has no axis y. It has x."),
        ("lock = [{ y = [0, 1] }]", "[parameters.Gain] lock 1: Gain has no axis y"),
        ("pin = [{ at = [1, 2], value = 0 }]", "pin 1: [1.0, 2.0] has 2 coordinates, but Gain has 1 axes"),
        ("free = false\npin = [{ at = [1000], value = 0 }]", "[parameters.Gain] pin 1: Gain is not free"),
    ],
)
def test_keys_that_do_not_fit_a_table_are_a_finding(shop, section, expected):
    assert expected in shop.add(f"[parameters.Gain]\n{section}").error()


def test_values_of_a_scalar_without_an_axis_are_a_finding(shop):
    error = shop.add("[parameters.offset]\ninitial = [1, 2]").error()
    assert "[parameters.offset] initial: must be one value for a scalar, got 2. Give it an axis" in error


def test_bounds_are_numbers_or_tables_and_may_be_infinite(shop):
    shop.add("[parameters.Gain]\nbounds = [[0, '-inf', 0], inf]")
    table = gain(shop)
    assert table.lower.tolist() == [0, -np.inf, 0]
    assert table.upper.tolist() == [np.inf] * 3


def test_a_start_outside_its_bounds_is_a_warning(shop):
    warning = shop.add("[parameters.Gain]\nbounds = [2, 3]").warning()
    assert "bounds: 3 of 3 initial values are outside, such as 1. They will be clipped to the bounds." in warning


def test_a_start_that_is_not_finite_is_a_finding(shop):
    shop.values("start.json", Curve("Gain", [1000, 2000, 3000], [1, np.nan, np.nan]), Scalar("offset", 0))
    assert "initial: 2 of 3 initial values of Gain are not finite, the first at 2" in shop.error()


def test_values_that_the_function_does_not_use_may_be_missing(shop):
    curve = Curve("Gain", [1000, 2000, 3000], [1, 1, 1])
    shop.values("start.json", curve, Scalar("offset", 0), Scalar("unused", np.nan))
    assert shop.findings() == []


@pytest.mark.parametrize(
    ("lock", "expected"),
    [
        ("true", [True, True, True]),
        ("false", [False, False, False]),
        ("[{ x = [1000, 2000] }]", [True, True, False]),
        ("[{ x = [0, 1500] }, { x = [3000, inf] }]", [True, False, True]),
    ],
)
def test_locks_hold_values_by_their_axis_ends_included(shop, lock, expected):
    assert gain(shop.add(f"[parameters.Gain]\nlock = {lock}")).locked.tolist() == expected


def test_a_lock_without_grid_points_is_a_warning(shop):
    assert "lock 1: no grid point is in this range" in shop.add("[parameters.Gain]\nlock = [{x = [1, 2]}]").warning()


def test_values_without_data_can_be_locked(shop):
    shop.bench("bench.csv", [1000, 1500, 2000, 1200])
    shop.add("[parameters.Gain]\nx = { breakpoints = [500, 1000, 2000, 3000, 4000] }\nlock = 'no-data'")
    assert gain(shop).locked.tolist() == [True, False, False, True, True]


def test_values_are_locked_if_only_excluded_samples_reach_them(shop):
    shop.change('"bench.csv"]', '"bench.csv"]\nwhere = "n < 1800"')
    shop.add("[parameters.Gain]\nlock = 'no-data'")
    assert gain(shop).locked.tolist() == [False, False, True]


def test_values_of_a_map_without_data_can_be_locked(shop):
    shop.text = "Predict = M(Speed, Load) + offset\n"
    shop.values("start.json", Map("M", [0, 1000, 2000, 3000], [10, 20, 30], np.ones((4, 3))), Scalar("offset", 0))
    shop.bench("bench.csv", [1000, 1500], **{"Load": [10.0, 15.0]})
    locked = problem(shop.add("[parameters.M]\nlock = 'no-data'")).parameters["M"].locked
    assert (~locked).nonzero()[0].tolist() == [1, 1, 2, 2]
    assert (~locked).nonzero()[1].tolist() == [0, 1, 0, 1]


def test_the_problem_has_the_pins_and_the_smoothness(shop):
    shop.add("[parameters.Gain]\npin = [{ at = 2000, value = 2 }]\nsmoothness = { x = 0.5 }")
    posed = problem(shop)
    assert [(pin.parameter, pin.at, pin.value) for pin in posed.pins] == [("Gain", (2000.0,), 2.0)]
    assert posed.factors("Gain") == (0.5,)


def test_a_pin_beyond_the_axis_is_a_warning(shop):
    shop.add("[parameters.Gain]\npin = [{ at = [9000], value = 2 }]")
    assert "pin 1: 9000 is outside the axis, 1000 to 3000" in shop.warning()


def test_patterns_and_sections_select_the_free_parameters(shop):
    assert problem(shop).free_names == ("Gain", "offset")
    shop.change('initial = "start.json"', 'initial = "start.json"\nfree = ["off*"]')
    assert problem(shop).free_names == ("offset",)
    shop.add("[parameters.Gain]\nfree = true\n[parameters.offset]\nfree = false")
    assert problem(shop).free_names == ("Gain",)


def test_names_with_brackets_are_not_patterns(shop):
    shop.text = "Predict = Load * %rad[3]% + offset\n"
    shop.values("start.json", Scalar("rad[3]", 1.0), Scalar("rad3", 1.0), Scalar("offset", 0.0))
    shop.change('[channels]\nSpeed = "n"\n', "")
    assert problem(shop).free_names == ("rad[3]", "offset")


def test_a_pattern_without_a_match_is_a_finding(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\nfree = ["Gain", "ofset"]')
    assert "[calibration] free: ofset matches no parameter. Did you mean offset?" in shop.error()


def test_freeing_an_unused_parameter_is_a_warning(shop):
    shop.values("more.json", Scalar("unused", 1.0))
    shop.change('initial = "start.json"', 'initial = ["start.json", "more.json"]\nfree = ["Gain", "unused"]')
    assert "unused matches only parameters that the function does not use: unused" in shop.warning()


def test_a_project_without_free_parameters_is_a_finding(shop):
    shop.add("[parameters.Gain]\nfree = false\n[parameters.offset]\nfree = false")
    assert 'no parameter of the function is free. Write free = ["*"] in [calibration].' in shop.error()


def test_a_project_without_parameters_has_no_finding_on_free_ones(shop):
    shop.change('initial = "start.json"', "")
    undefined_gain, undefined_offset = shop.errors()
    assert "undefined name Gain" in undefined_gain
    assert "undefined name offset" in undefined_offset


def test_a_map_with_a_lookup_of_a_curve_is_a_finding_by_its_axes(shop):
    """Not by what would lie on the axis that the function does not feed, such as the quantiles of a missing channel."""
    shop.add('[parameters.Gain]\nx = { count = 3 }\ny = { input = "Lod", count = 3 }\ninitial = 0.0')
    assert shop.errors() == [
        "sensor.kf line 3, column 12: Gain is looked up with 1 coordinate, but it is a map with 2 axes. "
        "Correct one of them."
    ]


def test_a_misspelt_function_suggests_the_nearest_name_first(shop):
    shop.text = shop.text.replace("Gain(Speed)", "Sinus(Speed) * sine(Speed)")
    shop.add("[parameters.Sinus]\nx = { breakpoints = [0, 1] }\ninitial = 0.0")
    assert "Did you mean sin? Or define it: [parameters.sine]" in shop.error()


def test_a_section_of_a_parameter_that_the_function_does_not_use_is_a_warning(shop):
    shop.add("[parameters.other]\ninitial = 3")
    assert "[parameters.other]: the function does not use other" in shop.warning()


@pytest.mark.parametrize("name", ["single", "round"])
def test_a_table_with_the_name_of_a_function_that_is_not_used_is_called_in_quotes(shop, name):
    shop.text = shop.text.replace("Gain(Speed)", f"{name}(Gain(Speed))")
    shop.add(f"[parameters.{name}]\nx = {{ breakpoints = [0, 1] }}\ninitial = 0.0")
    assert f"{name}(...) is the built-in function. Write %{name}%(...) for the table." in "".join(shop.warnings())
    shop.text = shop.text.replace(f"{name}(", f"%{name}%(")
    assert not any("does not use" in message for message in shop.warnings())


def test_an_undefined_parameter_shows_a_section_to_copy(shop):
    shop.text = "input Speed\ninput Load\nPredict = Gain(Speed) * Load + offset + Extra(Speed, offset)\n"
    (finding,) = shop.findings()
    assert str(finding.location) == "sensor.kf line 3, column 41"
    assert finding.excerpt.splitlines() == [
        "[parameters.Extra]",
        'x = { input = "Speed", count = 8 }',
        "y = { begin = 0.0, end = 1.0, count = 8 }",
        "initial = 0.0",
    ]
    shop.add(finding.excerpt)
    assert [f for f in Project.read(shop.path).check() if f.severity != "remark"] == []


def test_an_undefined_scalar_shows_a_section_to_copy(shop):
    shop.text += "more = Predict + ofset\n"
    (finding,) = shop.findings()
    assert str(finding) == (
        "sensor.kf line 5, column 18: undefined name ofset: not a node, an input, or a parameter of any file or "
        "section. "
        "Did you mean offset? Or define it: [parameters.ofset] initial = 0.0."
    )


def test_a_table_with_another_number_of_axes_is_a_finding(shop):
    shop.values("start.json", Scalar("Gain", 1), Scalar("offset", 0))
    assert (
        "sensor.kf line 3, column 12: Gain is looked up with 1 coordinate, but it is a scalar with 0 axes"
        in shop.error()
    )


def test_value_blocks_stay_value_blocks(shop):
    shop.values("start.json", Block("Gain", [1.0, 2.0, 3.0]), Scalar("offset", 0))
    shop.add("[parameters.Gain]\ninitial = [4, 5, 6]")
    shop.text = "Predict = Gain(Load - 10) + offset\n"
    shop.change('[channels]\nSpeed = "n"\n', "")
    table = gain(shop)
    assert (table.kind, table.values.tolist()) == ("block", [4, 5, 6])


def test_an_undeclared_input_must_be_declared_if_it_is_a_channel(shop):
    """A scalar of this name would hide the channel."""
    shop.text = "input Speed\nPredict = Gain(Speed) * Load + offset\n"
    (finding,) = shop.findings()
    assert str(finding).startswith("sensor.kf line 2, column 25: undefined name Load: ")
    assert finding.remedy.startswith("The data have a channel of this name; declare it: input Load. ")
    assert finding.excerpt == "input Load"
    shop.text = f"{finding.excerpt}\n{shop.text}"
    assert shop.errors() == []
