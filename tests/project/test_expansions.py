"""A static surrogate as a parameter of a project that is fitted."""

import json

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import StaticSurrogate, write_surrogate

SIZE = 1 + 2 + 2 * (1 + 2 * 2)  # offset, slopes; weight, centre and width of two bells


@pytest.fixture
def bells(shop):
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


def test_it_is_fitted_like_any_parameter(bells):
    values, result = fitted(bells)
    assert values["kind"] == "rbf"
    assert result["values"] == {"free": SIZE, "fixed": 0}
    (quality,) = result["quality"]
    assert quality["rmse_after"] < 0.5 * quality["rmse_before"]
    assert "surrogates" not in result


def test_what_a_section_may_say_of_it(bells):
    low, high = [-1e9] * SIZE, [1e9] * SIZE
    low[3] = high[3] = 4.0  # the first weight
    bells.add(f"[parameters.Gain]\nunit = 'kNm'\nbounds = [{low}, {high}]")
    values, _ = fitted(bells)
    assert values["unit"] == "kNm"
    assert values["weights"][0] == 4.0
    assert values["weights"][1] != 9.0


def test_a_lock_holds_all_of_it(bells):
    bells.add("[parameters.Gain]\nlock = true")
    values, result = fitted(bells)
    assert values["weights"] == [4.0, 9.0]
    assert result["values"]["free"] == 0


def test_a_step_that_locks_what_has_no_data_leaves_it_free(bells):
    bells.add('[[step]]\nlock = { Gain = "no-data" }')
    (quality,) = fitted(bells)[1]["quality"]
    assert quality["rmse_after"] < quality["rmse_before"]


@pytest.mark.parametrize(
    ("text", "said"),
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
def test_what_means_nothing_for_it_is_reported(bells, text, said):
    bells.add(f"[parameters.Gain]\n{text}")
    assert bells.error().startswith(f"kennfeld.toml [parameters.Gain] {said}")


def test_all_of_it_at_once(bells):
    bells.add("[parameters.Gain]\ninitial = 1\nsmoothness = 1\nlock = 'no-data'\nbounds = [0, 1]")
    assert len(bells.errors()) == 4
