"""A static surrogate as a parameter of a project that is fitted."""

import json

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import StaticSurrogate, write_surrogate

SIZE = 1 + 2 + 2 * (1 + 2 * 2)  # offset, slopes; weight, centre and width of two bells


@pytest.fixture
def expansion_project(shop):
    """A project whose only parameter comes from the file of a static surrogate."""
    expansion = Expansion(5.0, [0.0, 1.0], [4.0, 9.0], [[1300.0, 11.0], [2600.0, 12.0]], [[500.0, 2.0], [700.0, 3.0]])
    surrogate = StaticSurrogate("Gain", ("Speed", "Load"), "Torque", ("rpm", "", "Nm"), expansion)
    write_surrogate(surrogate, shop.folder / "gain.json")
    shop.bench("bench.csv", speed=np.linspace(1000, 3000, 60))
    shop.text = "input Speed[rpm]\ninput Load\nPredict[Nm] = Gain(Speed, Load)\n"
    return shop.change('"start.json"', '"gain.json"').add("[optimizer]\nmax_iterations = 20")


def fitted(shop):
    assert cli.run(["calibrate", str(shop.path)]) in (0, 1)
    folder = shop.folder / "results"
    values = json.loads((folder / "parameters.json").read_text(encoding="utf-8"))["Gain"]
    return values, json.loads((folder / "result.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_an_expansion_is_fitted_like_any_parameter(expansion_project):
    values, result = fitted(expansion_project)
    assert values["kind"] == "rbf"
    assert result["values"] == {"free": SIZE, "fixed": 0}
    (quality,) = result["quality"]
    assert quality["rmse_after"] < 0.5 * quality["rmse_before"]
    assert "surrogates" not in result


def test_a_section_may_set_unit_and_bounds_of_an_expansion(expansion_project):
    low, high = [-1e9] * SIZE, [1e9] * SIZE
    low[3] = high[3] = 4.0  # the first weight
    expansion_project.add(f"[parameters.Gain]\nunit = 'kNm'\nbounds = [{low}, {high}]")
    values, _ = fitted(expansion_project)
    assert values["unit"] == "kNm"
    assert values["weights"][0] == 4.0
    assert values["weights"][1] != 9.0


def test_a_lock_fixes_all_values_of_an_expansion(expansion_project):
    expansion_project.add("[parameters.Gain]\nlock = true")
    values, result = fitted(expansion_project)
    assert values["weights"] == [4.0, 9.0]
    assert result["values"]["free"] == 0


def test_a_step_that_locks_values_without_data_leaves_an_expansion_free(expansion_project):
    expansion_project.add('[[step]]\nlock = { Gain = "no-data" }')
    (quality,) = fitted(expansion_project)[1]["quality"]
    assert quality["rmse_after"] < quality["rmse_before"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bounds = [0, 10]", f"bounds: the bounds of Gain must have {SIZE} values"),
        ("smoothness = 1", "smoothness: not supported for Gain, an RBF expansion"),
        ("gradient = { x = [0, inf] }", "gradient: not supported for Gain"),
        ("curvature = { x = [0, inf] }", "curvature: not supported for Gain"),
        ("pin = [{ at = [1000, 12], value = 1 }]", "pin: not supported for Gain"),
        ('extrapolation = "linear"', "extrapolation: not supported for Gain"),
        ("initial = 1", "initial: not supported for Gain"),
        ('lock = "no-data"', "lock: a part of Gain cannot be locked"),
        ("lock = [{ x = [0, 2000] }]", "lock: a part of Gain cannot be locked"),
    ],
)
def test_keys_without_meaning_for_an_expansion_are_errors(expansion_project, text, message):
    expansion_project.add(f"[parameters.Gain]\n{text}")
    assert expansion_project.error().startswith(f"kennfeld.toml [parameters.Gain] {message}")


def test_all_invalid_keys_of_an_expansion_are_reported_at_once(expansion_project):
    expansion_project.add("[parameters.Gain]\ninitial = 1\nsmoothness = 1\nlock = 'no-data'\nbounds = [0, 1]")
    assert len(expansion_project.errors()) == 4
