import numpy as np
import pytest

from kennfeld.surrogate.recursion import UNLIMITED
from kennfeld.surrogate.saturation import find_saturation, limits_of

WAVE = np.sin(np.linspace(0, 60, 2000)) + 0.3 * np.sin(np.linspace(0, 170, 2000))
NOISE = 0.003 * np.random.default_rng(0).normal(size=WAVE.size)


@pytest.mark.parametrize(
    ("output", "limits"),
    [
        (np.minimum(WAVE, 0.9), (-np.inf, 0.9)),
        (np.maximum(WAVE, -0.8), (-0.8, np.inf)),
        (np.clip(WAVE, -0.8, 0.9), (-0.8, 0.9)),
        (1e6 + 1e3 * np.clip(WAVE, -0.8, 0.9), (1e6 - 800, 1e6 + 900)),
    ],
)
def test_a_level_that_the_output_does_not_pass_is_a_limit(output, limits):
    np.testing.assert_allclose(limits_of(find_saturation([output[:800], output[800:]])), limits)


def test_noise_of_the_sensor_hides_no_saturation_of_the_system():
    lower, upper = limits_of(find_saturation([np.minimum(WAVE, 0.9) + NOISE]))
    assert lower == -np.inf
    assert upper == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize(
    "output",
    [
        WAVE,
        np.sin(np.linspace(0, 60, 2000)),
        np.repeat(np.arange(6.0), 300)[np.random.default_rng(0).permutation(1800)],
        np.full(50, 3.0),
        np.random.default_rng(0).uniform(size=500),
        np.minimum(np.linspace(0, 2, 500), 1.5),  # arrives once: perhaps the end of a run-up
    ],
    ids=["waves", "sine", "gears", "constant", "noise", "ramp"],
)
def test_an_output_that_only_turns_at_its_extreme_has_no_limit(output):
    assert limits_of(find_saturation([output])) == UNLIMITED
