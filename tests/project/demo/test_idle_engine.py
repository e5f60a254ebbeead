from pathlib import Path

import numpy as np

import kennfeld as kf
from kennfeld.project.demo.petrol_engine import random_steps, simulate_engine

FORMULA = Path(__file__).resolve().parents[3] / "examples" / "idle-speed" / "idle.kf"


def test_the_engine_turns_as_the_formula_of_the_example_does():
    text = FORMULA.read_text("utf-8")
    engine = text[text.index("# throttle and manifold") : text.index("# governor")]
    model = kf.formula(f"input throttle[deg]\ninput load[Nm]\noutput rpm\nstep 0.0005\n{engine}")
    rng = np.random.default_rng(0)
    throttle, load = random_steps(rng, 100, (6.0, 12.0), 5, 40), random_steps(rng, 100, (15.0, 30.0), 5, 40)
    speed = simulate_engine(throttle, load, 0.02, fine=5e-4)
    time = 0.0005 * np.arange(4000)
    data = kf.Dataset.of("steps", {"throttle": np.repeat(throttle, 40), "load": np.repeat(load, 40)}, time=time)
    expected = kf.simulate(model, data, kf.ParameterSet())["rpm"].values[::40]
    assert np.ptp(expected) > 300
    assert np.abs(speed - expected).max() < 2


def test_more_throttle_makes_the_engine_faster_and_more_load_slower():
    def settled(throttle, load):
        return simulate_engine(np.full(500, throttle), np.full(500, load), 0.02)[-1]

    assert settled(10.0, 25.0) > settled(9.0, 25.0) > settled(9.0, 30.0) > 500


def test_a_stalled_engine_stays_finite():
    assert np.isfinite(simulate_engine(np.full(300, 1.0), np.full(300, 200.0), 0.02)).all()


def test_random_steps_stay_in_their_range_for_their_time():
    signal = random_steps(np.random.default_rng(1), 500, (2.0, 3.0), 10, 20)
    assert signal.shape == (500,)
    assert 2 <= signal.min() < signal.max() <= 3
    changes = np.flatnonzero(np.diff(signal))
    assert np.diff(changes).min() >= 10
    assert np.diff(changes).max() <= 20
