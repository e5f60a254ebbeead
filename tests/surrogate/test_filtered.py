import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import FilteredSurrogate, filtered_training, read_surrogate, write_surrogate
from kennfeld.surrogate.input_filters import filtered_points
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate


def model(delay=1, **changes):
    rng = np.random.default_rng(0)
    expansion = Expansion(0.1, rng.normal(size=6), [1.0, 0.5], rng.normal(size=(2, 6)), np.ones((2, 6)))
    attributes = {"limits": (-2.0, 1.5), "start_inputs": (0.1, 0.2), "remarks": ("y stays at its maximum",)}
    return FilteredSurrogate("slow", ("u", "v"), "y", 0.1, (1.0, 0.3), expansion, delay, **(attributes | changes))


def recording(samples=200, seed=1):
    u = np.random.default_rng(seed).normal(size=(samples, 2))
    return u, Dataset.of("d", {"u": u[:, 0], "v": u[:, 1]}, time=0.1 * np.arange(samples))


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_filters_are_the_exact_response_to_held_inputs(delay):
    u, _ = recording(50)
    points = filtered_points(u, delay, 0.1, (0.7,))
    late = np.concatenate([np.repeat(u[:1], delay, axis=0), u])[:50]
    x = late[0]
    for k in range(50):
        x = late[k] + np.exp(-0.1 / 0.7) * (x - late[k])
        np.testing.assert_allclose(points[k], [*late[k], *x], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("limits", [(-2.0, 1.5), (-np.inf, np.inf)])
def test_formula_text_runs_it_as_its_own_simulation(delay, limits):
    slow, (u, data) = model(delay, limits=limits), recording()
    got = kf.simulate(kf.formula("y = slow(u, v)", surrogates=[slow]), data, {})["y"].values
    np.testing.assert_allclose(got, slow.simulate(u), rtol=0, atol=1e-13)


def test_with_a_delay_a_surrogate_can_be_part_of_a_closed_loop():
    slow, (u, data) = model(), recording()
    text = "y = slow(u, w)\nw = 0.5 * y"
    y = kf.simulate(kf.formula(text, surrogates=[slow]), data, {})["y"].values
    fed = np.column_stack([u[:, 0], np.concatenate([[0.2], 0.5 * y[:-1]])])  # as the delayed inputs come
    first = np.column_stack([np.concatenate([u[:1, 0], u[:-1, 0]]), fed[:, 1]])
    np.testing.assert_allclose(y, model(0).simulate(first), rtol=0, atol=1e-13)


def test_a_stored_one_is_restored_bit_for_bit(tmp_path):
    slow = model()
    write_surrogate(slow, tmp_path / "slow.json")
    again = read_surrogate(tmp_path / "slow.json")
    assert again.expansion == slow.expansion
    for name in ("name", "inputs", "output", "step", "time_constants", "delay", "limits", "start_inputs", "remarks"):
        assert getattr(again, name) == getattr(slow, name)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"delay": -1}, "delay=-1 of surrogate slow"),
        ({"limits": (1.0, 1.0)}, "limits=.* must increase"),
        ({"start_inputs": (1.0,)}, "must be one per input"),
    ],
)
def test_contradictory_attributes_are_named(changes, message):
    with pytest.raises(ArgumentError, match=message):
        model(**changes)


def wall(name, seed, use="training", samples=600):
    """The temperature of a wall, which the square of u heats with two time constants."""
    u = np.repeat(np.random.default_rng(seed).uniform(-1, 1, samples // 15), 15)
    slow, fast = (filtered_points(u[:, None] ** 2, 0, 1.0, (T,))[:, 1] for T in (40.0, 4.0))
    y = slow + 0.5 * fast + 0.002 * np.random.default_rng(seed + 9).normal(size=samples)
    return Dataset.of(name, {"u": u**2, "y": y}, time=np.arange(float(samples)), use=use)


def settings(**changes):
    return SurrogateSettings("wall", ("u",), "y", kind="dynamic", centres=20, starts=1, **changes)


@pytest.mark.parametrize(("samples", "most"), [(300, 2), pytest.param(600, 4, marks=pytest.mark.slow)])
def test_time_constants_are_identified(samples, most, monkeypatch):
    monkeypatch.setattr(filtered_training, "MOST_FILTERS", most)
    data = [wall("a", 0, samples=samples), wall("b", 1, "test", samples)]
    wall_model = train_surrogate(data, settings(structure="filtered"))
    assert isinstance(wall_model, FilteredSurrogate)
    np.testing.assert_allclose(wall_model.time_constants, [4.0, 40.0], rtol=0.2)
    errors = {(q.dataset, q.mode): q.rmse for q in wall_model.quality}
    assert errors["b", "free run"] < 0.01
    assert errors["b", "free run"] < 0.2 * errors["b", "plane"]
    assert "does not feed back" in wall_model.stability


def test_recordings_that_are_too_short_are_refused():
    with pytest.raises(InputError, match="too short for a filtered model"):
        train_surrogate([wall("a", 0, samples=30)], settings(structure="filtered"))


@pytest.mark.slow
def test_the_structure_with_the_smaller_error_on_held_out_blocks_is_taken():
    progress = []
    chosen = train_surrogate(
        [wall("a", 0, samples=300), wall("b", 1, "test", 300)], settings(longest_lag=2), progress.append
    )
    assert isinstance(chosen, FilteredSurrogate)
    assert any(line.startswith("linear ARX model") for line in progress)
