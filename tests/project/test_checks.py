"""Warnings about problems that can be solved."""

import numpy as np
import pytest

from kennfeld.domain.parameters import Curve, Scalar


def test_a_channel_of_another_quantity_than_its_input_is_a_warning(shop):
    shop.bench("bench.csv", **{"n [rpm]": None, "n [Hz]": [1000.0, 1500, 2000, 2500, 3000, 1200]})
    warning = shop.warning()
    assert "channel n is in Hz, but the input Speed of the function is in rpm, a different quantity. " in warning
    assert 'Name another channel, or state its unit: [units] n = "rpm".' in warning
    assert "[[dataset]] 1 (bench)" in warning


def test_a_channel_in_an_unknown_unit_is_a_warning(shop):
    shop.bench("bench.csv", **{"n [rpm]": None, "n [ticks]": [1000.0, 1500, 2000, 2500, 3000, 1200]})
    warning = shop.warning()
    assert "channel n is in ticks, but the input Speed of the function is in rpm. Convert it" in warning


def test_differently_spelled_units_are_equal(shop):
    shop.bench("bench.csv", **{"n [rpm]": None, "n [1/min]": [1000.0, 1500, 2000, 2500, 3000, 1200]})
    assert shop.findings() == []


def test_a_target_in_another_unit_than_its_node_is_a_warning(shop):
    shop.bench("bench.csv", **{"Torque [Nm]": None, "Torque [bar]": np.arange(6)})
    assert "channel Torque is in bar, but the node Predict of the function is in Nm" in shop.warning()


def test_a_channel_with_many_gaps_is_a_warning(shop):
    shop.bench("bench.csv", **{"Torque [Nm]": [1.0, np.nan, 3, np.nan, 5, 6]})
    assert "channel Torque is missing in 33% of the samples" in shop.warning()


def test_a_file_without_any_value_of_the_target_is_a_warning(shop):
    shop.bench("bench_2.csv", **{"Torque [Nm]": [np.nan] * 6})
    shop.bench("bench_3.csv", **{"Torque [Nm]": None})
    shop.change('files = ["bench.csv"]', 'files = ["bench*.csv"]')
    warnings = [str(finding) for finding in shop.findings()]
    assert any("no value of Torque, so that no sample is scored, in bench_2.csv, bench_3.csv" in w for w in warnings)


def test_a_channel_that_never_changes_is_a_warning(shop):
    shop.bench("bench.csv", **{"Load": [10.0] * 6})
    assert "channel Load is constant (10) in the training data. Is it the right channel?" in shop.warning()


def test_data_beyond_the_axis_are_a_warning(shop):
    shop.values("start.json", Curve("Gain", [1000, 1100], [1, 1]), Scalar("offset", 0))
    warning = shop.warning()
    assert "[parameters.Gain] x: 83% of the training samples are outside the axis, 1000 to 1100" in warning
    assert "83% of the training samples are outside the axis, 1000 to 1100; the data range from 1000 to 3000" in warning


def test_coordinates_that_depend_on_parameters_are_not_compared_with_axes(shop):
    shop.text = "Predict = Gain(Speed * offset) * Load\n"
    assert shop.findings() == []


def test_exchanged_axes_are_a_warning(shop):
    shop.text = "Predict = M(Speed, Load) + offset + 0 * Gain(Speed)\n"
    shop.add(
        "[parameters.M]\ninitial = 0\nx = { input = 'Load', begin = 1000, end = 3000, count = 3 }\n"
        "y = { input = 'Speed', begin = 10, end = 13, count = 3 }"
    )
    messages = shop.warnings()
    assert any(
        "[parameters.M] x: the input of the axis is Load, but the function looks M up with Speed" in w for w in messages
    )


def test_a_project_in_which_all_values_are_locked_is_a_warning(shop):
    shop.add("[parameters.Gain]\nlock = true\n[parameters.offset]\nlock = true")
    assert any("no value can be fitted: Gain, offset are locked. Remove lock." in text for text in shop.warnings())
    shop.change("[parameters.offset]\nlock = true", "")
    assert not any("no value can be fitted" in text for text in shop.warnings())


def test_a_criterion_that_no_free_parameter_changes_is_a_warning(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\nfree = "offset"')
    shop.add('[[criterion]]\nnode = "base"\ntarget = 3')
    assert "[[criterion]] 2: no free parameter affects base" in shop.warning()


def test_a_free_parameter_that_reaches_no_criterion_is_a_warning(shop):
    shop.text = shop.text + "aside = Speed * K\n"
    shop.values("more.json", Scalar("K", 1.0))
    shop.change('initial = "start.json"', 'initial = ["start.json", "more.json"]')
    sentence = "[calibration] free: K affects no criterion with a weight"
    assert f"{sentence} and keeps its initial value" in shop.warning()
    # a limit may move it, and so may smoothness
    shop.add("[parameters.K]\nbounds = [2, 3]")
    _, warning = shop.warnings()
    assert warning.endswith(sentence)


def test_a_free_parameter_of_a_criterion_without_weight_keeps_its_value(shop):
    shop.text = shop.text + "aside = Speed * K\n"
    shop.values("more.json", Scalar("K", 1.0))
    shop.change('initial = "start.json"', 'initial = ["start.json", "more.json"]')
    shop.add('[[criterion]]\nnode = "aside"\ntarget = "Torque"\nweight = 0.0')
    assert "K affects no criterion with a weight and keeps its initial value" in shop.warning()


@pytest.mark.parametrize("states", [False, True])
def test_the_data_beyond_an_axis_are_counted_with_and_without_memory(shop, states):
    shop.values("start.json", Curve("Gain", [1000, 1100], [1, 1]), Scalar("offset", 0))
    if states:
        shop.text = shop.text.replace("Gain(Speed)", "Gain(prev(Speed, Speed))")
    assert "83% of" in shop.warning() if not states else "are outside the axis" in shop.warning()


def test_an_unused_group_axis_is_a_warning(shop):
    shop.add("[axes.AxisSpeed]\ninput = 'Speed'\ncount = 3\n")
    assert shop.warning() == (
        "kennfeld.toml [axes.AxisSpeed]: no table of this file uses the axis. "
        'Write x = { axis = "AxisSpeed" } under [parameters.NAME] of each table on it.'
    )
    shop.add("[parameters.Gain]\nx = { axis = 'AxisSpeed' }\n")
    assert shop.warnings() == []


def test_a_delay_that_exceeds_the_memory_is_an_error(shop):
    shop.text = shop.text.replace("base + offset", "base + offset + delay(Load, 1000000000, 0)")
    (error,) = shop.errors()
    assert error.startswith("sensor.kf line 4: a delay of 1000000000 steps needs 48 GB of memory. Use a shorter delay")
