"""The model of a project and its criteria."""

import numpy as np
import pytest

from kennfeld.domain.parameters import Curve, Scalar


def test_formula_text_with_wrong_lines_gives_every_finding(shop):
    shop.text += "a = 1 +\nb = = 2\n"
    assert [error.split(",")[0] for error in shop.errors()] == ["sensor.kf line 5", "sensor.kf line 6"]


def test_an_algebraic_loop_is_named(shop):
    shop.text += "a = b\nb = a + 1\n"
    assert "a" in shop.error()
    assert "loop" in shop.error()


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        ("sensr.kf", "[model] file: file sensr.kf does not exist. Did you mean sensor.kf?"),
        ("sensor.slx", "file sensor.slx does not exist. Did you mean sensor.kf?"),
        ("sensor.onnx", "file sensor.onnx does not exist. Did you mean sensor.kf?"),
        ("sensor.py:f", "file sensor.py:f does not exist. Did you mean sensor.kf?"),
        ("bench.csv", "unknown model format .csv. Use formula text (.kf)"),
        ("lost/sensor.kf", "file lost/sensor.kf does not exist. Check the path."),
    ],
)
def test_a_model_file_that_cannot_be_read_is_a_finding(shop, file, expected):
    assert shop.path
    assert expected in shop.change("sensor.kf", file).error()


def test_parameters_distinguish_an_undeclared_scalar_from_an_input(shop):
    shop.text = "Predict = Gain(Speed) * Load + offset\n"
    assert shop.findings() == []
    assert shop.project.problem().model.graph.inputs == ("Speed", "Load")


def test_a_name_that_is_a_node_and_a_parameter_is_a_finding(shop):
    shop.values("more.json", Scalar("base", 1.0))
    shop.change('initial = "start.json"', 'initial = ["start.json", "more.json"]')
    assert "base is both a node and a parameter" in shop.error()


def test_a_channel_for_an_unknown_input_is_a_finding(shop):
    shop.change('Speed = "n"', 'Speed = "n"\nLoda = "Load"')
    assert "[channels] Loda: unknown input Loda. Did you mean Load?" in shop.error()


def test_a_criterion_may_be_an_expression(shop):
    shop.add('[[criterion]]\nnode = "abs(base - 3) / 2"\ntarget = 0\nweight = 0.1')
    assert shop.findings() == []
    names = shop.project.problem().model.graph.names
    assert "abs(base - 3) / 2" in names


def test_a_criterion_may_use_channels_that_the_function_does_not_read(shop):
    shop.bench("bench.csv", set=np.arange(6))
    shop.add('[[criterion]]\nnode = "base - set"\ntarget = 0')
    assert shop.findings() == []
    assert shop.project.problem().model.graph.inputs == ("Speed", "Load", "set")


def test_a_target_may_be_a_node_a_number_or_a_channel(shop):
    shop.add('[[criterion]]\nnode = "base"\ntarget = { node = "Predict" }')
    shop.add('[[criterion]]\nnode = "base"\ntarget = 5.0')
    shop.add('[[criterion]]\nnode = "base"\ntarget = { channel = "Torque" }\nloss = "huber"\ndelta = 2\nscale = 3')
    shop.add('[[criterion]]\nnode = "Predict"\ntarget = "base"')
    assert shop.findings() == []
    criteria = shop.project.problem().criteria
    assert [c.target.kind for c in criteria] == ["channel", "node", "number", "channel", "node"]
    assert (criteria[3].loss, criteria[3].delta, criteria[3].scale) == ("huber", 2.0, 3.0)


@pytest.mark.parametrize(
    ("criterion", "expected"),
    [
        (
            'node = "Predct"\ntarget = 1',
            "unknown node Predct. Did you mean Predict?",
        ),
        ('node = "base *"\ntarget = 1', "[[criterion]] 2 node, column 7: incomplete expression"),
        ('node = "base"\ntarget = { node = "Predct" }', "[[criterion]] 2 target: unknown node Predct"),
        ('node = "base"\ntarget = { channel = "Toque" }', "unknown channel Toque. Did you mean Torque?"),
        ('node = "base"\ntarget = "Toque"', "unknown channel or node Toque. Did you mean Torque?"),
        ('node = "base - sett"\ntarget = 0', "has no channel sett, the input sett of the function"),
        (
            'node = "Predict"\ntarget = { channel = "Torque" }',
            "duplicate criterion: Predict and Torque are already compared in kennfeld.toml line 13 [[",
        ),
    ],
)
def test_a_wrong_criterion_is_a_finding(shop, criterion, expected):
    assert expected in shop.add(f"[[criterion]]\n{criterion}").error()


def test_criteria_whose_weights_are_all_zero_are_a_finding(shop):
    assert "[[criterion]]: all weights are 0" in shop.change('node = "Predict"', 'node = "Predict"\nweight = 0').error()


def test_a_criterion_that_no_sample_reaches_is_a_finding(shop):
    shop.bench("bench.csv", **{"Torque [Nm]": [np.nan] * 6})
    assert "[[criterion]] 1: no training sample has a target for Predict" in shop.error()


def test_a_target_that_is_a_channel_and_a_node_is_a_warning(shop):
    shop.bench("bench.csv", base=np.arange(6))
    shop.add('[[criterion]]\nnode = "Predict"\ntarget = "base"')
    assert "base is both a channel and a node; the channel is used" in shop.warning()
    assert shop.project.problem().criteria[1].target.kind == "channel"


def test_a_name_that_is_an_initial_value_and_a_channel_is_refused(shop):
    shop.text = shop.text.replace("input Speed[rpm]\ninput Load\n", "").replace("Gain(Speed)", "Gain(n)")
    shop.change('[channels]\nSpeed = "n"\n', "")
    shop.values("start.json", Curve("Gain", [1000, 2000, 3000], [1.0] * 3), Scalar("offset", 0), Scalar("Load", 7.0))
    message = "Load is both a parameter of the initial values and a channel of dataset bench"
    assert message in shop.error()
    shop.add("[parameters.Load]")  # says that it is a parameter
    assert shop.errors() == []


def test_a_declared_input_is_not_hidden_by_a_parameter_of_the_initial_values(shop):
    gain = Curve("Gain", [1000, 2000, 3000], [1.0] * 3)
    shop.values("start.json", gain, Scalar("offset", 0), Scalar("Load", 7.0))
    assert shop.errors() == []
    assert shop.project.problem().model.graph.inputs == ("Speed", "Load")
