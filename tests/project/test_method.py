"""Checks of the method: requirements of a global search, and problems that require one."""

import pytest

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Scalar

RELAY = """
input Speed[rpm]
input Load
on = hysteresis(Gain(Speed) * Load, 20, 15)
Predict[Nm] = 10 * on + offset
"""
BOUNDS = "\n[parameters.Gain]\nbounds = [0, 5]\n[parameters.offset]\nbounds = [-10, 20]\n"
GLOBAL = "\n[optimizer]\nmethod = 'global'\n"


def test_the_search_uses_the_method_of_the_project(shop):
    options = shop.add(GLOBAL + "max_evaluations = 70\nseed = 3").project.options
    assert (options.method, options.max_evaluations, options.seed) == ("global", 70, 3)


def test_a_project_is_searched_without_gradients(shop):
    result = shop.add(BOUNDS + GLOBAL + "seed = 1\nmax_evaluations = 60").project.calibrate()
    assert result.trace[0].stage == "global"
    assert result.quality[0].rmse_after == pytest.approx(0, abs=1e-6)


def test_missing_bounds_are_errors_with_their_location(shop):
    assert shop.add("\n[parameters.Gain]\nbounds = [0, inf]\n" + GLOBAL).errors() == [
        'kennfeld.toml [parameters.offset] bounds: offset has no lower and no upper bound; method = "global" '
        "requires both. Write bounds = [lower, upper], as narrow as you know them.",
        'kennfeld.toml [parameters.Gain] bounds: Gain has no upper bound; method = "global" requires both. '
        "Write bounds = [lower, upper], as narrow as you know them.",
    ]


def test_many_values_are_a_warning(shop):
    shop.values(
        "start.json", Curve("Gain", Axis(range(1000, 3001, 50), input="Speed"), [1.0] * 41), Scalar("offset", 0.0)
    )
    shop.add(BOUNDS + GLOBAL)
    assert shop.warning() == (
        "kennfeld.toml [optimizer] method: 42 values are too many for a search without gradients, "
        "which suits up to 30. "
        "Free fewer, use fewer breakpoints, or raise max_evaluations."
    )
    shop.change("bounds = [0, 5]", "bounds = [0, 5]\nlock = [{ x = [1500, 3000] }]")
    assert shop.warnings() == []


def test_a_budget_of_a_descent_is_refused(shop):
    message = shop.add("\n[optimizer]\nmax_evaluations = 100").error()
    assert message == (
        "kennfeld.toml [optimizer] max_evaluations: max_evaluations requires the method global, got gauss-newton. "
        'Write method = "global", or max_iterations.'
    )


def test_one_warning_recommends_the_search_for_a_model_with_events(shop):
    shop.text = RELAY
    assert shop.warning() == (
        "sensor.kf line 4: on (>=, <=) jumps depending on Gain; derivatives do not account for that. "
        'Write [optimizer] method = "global", and bounds for Gain.'
    )
    shop.add(BOUNDS + GLOBAL)
    assert shop.warnings() == []


def test_events_that_affect_no_free_parameter_or_criterion_are_ignored(shop):
    shop.text = RELAY.replace("10 * on", "10 * Gain(Speed)")
    assert shop.warnings() == []
    shop.text = RELAY.replace("10 * on", "10 * on * Other")
    shop.add("\n[parameters.Other]\ninitial = 1.0\n")
    shop.change("[calibration]", "[calibration]\nfree = ['offset', 'Other']")
    assert shop.warnings() == []


def test_some_of_many_parameters_that_decide_an_event_are_named(shop):
    names = [f"k{number}" for number in range(40)]
    shop.text = "input Speed[rpm]\ninput Load\n" + f"Predict[Nm] = Load * Speed > {' + '.join(names)}\n"
    shop.values("start.json", *(Scalar(name, 1.0) for name in names))
    message = shop.warning()
    assert (
        "Predict (>) jumps depending on k0, k1, k2, k3, k4 and 35 more; derivatives do not account for that" in message
    )
    assert message.endswith('Free up to 30 values, and write [optimizer] method = "global", and bounds for them.')
