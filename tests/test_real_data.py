"""Real engines: the errors on points and recordings held out that others reach, or better."""

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf

FILE = Path(__file__).resolve().parents[2] / "shared" / "data" / "engine_steady" / "engine1_normalized.xlsx"
TEMPERATURE, AXES = "temperature_exhaust_manifold", ("engine_speed", "engine_load")
SMOOTHNESS = (0.3, 1.0, 3.0, 10.0)

pytestmark = pytest.mark.skipif(not FILE.is_file(), reason=f"the measurement of the engine is not at {FILE}")


@cache
def engine():
    return kf.read(f"{FILE}#data")


def split(seed):
    """The samples to fit and the fifth that is held out."""
    order = np.random.default_rng(seed).permutation(engine().samples)
    return np.split(order, [int(0.8 * order.size)])


def flat(name, samples, count, value):
    """A map of one value over the range of the samples."""
    axes = [np.linspace(engine()[a].values[samples].min(), engine()[a].values[samples].max(), count) for a in AXES]
    return kf.Map(name, *axes, np.full((count, count), value))


def held_out(text, target, start, fitted, test_points, smoothness, **options):
    """The result, and the RMSE at the held-out samples."""
    result = kf.calibrate(
        text,
        engine().select(fitted),
        start,
        target=target,
        test=engine().select(test_points),
        smoothness=smoothness,
        options=kf.Options(**options),
    )
    return result, result.quality[1].rmse_after


def error_of_a_map(target, fitted, test_points, smoothness, count=12):
    start = kf.ParameterSet([flat("M", fitted, count, engine()[target].values[fitted].mean())])
    return held_out("y = M(engine_speed, engine_load)", target, start, fitted, test_points, smoothness)[1]


def chosen_smoothness(fitted_samples):
    """The factor of the least error in a threefold cross-validation within the samples to fit, over all of them."""
    errors = dict.fromkeys(SMOOTHNESS, 0.0)
    for fitted in fitted_samples:
        for fold in np.array_split(fitted, 3):
            rest = np.setdiff1d(fitted, fold)
            for smoothness in SMOOTHNESS:
                errors[smoothness] += error_of_a_map(TEMPERATURE, rest, fold, smoothness) ** 2
    return min(errors, key=errors.get)


@pytest.mark.slow
def test_the_exhaust_temperature_of_held_out_points_is_met_by_a_map():
    splits = [split(seed) for seed in range(20)]
    smoothness = chosen_smoothness([fitted for fitted, _ in splits[:2]])
    errors = [error_of_a_map(TEMPERATURE, fitted, test_points, smoothness) for fitted, test_points in splits]
    assert np.mean(errors) <= 0.098


@pytest.mark.slow
def test_automatic_smoothness_meets_held_out_points_as_the_best_fixed_factor():
    splits = [split(seed) for seed in range(20)]
    means = {
        smoothness: np.mean([error_of_a_map(TEMPERATURE, *parts, smoothness) for parts in splits])
        for smoothness in (*SMOOTHNESS, "auto")
    }
    assert means.pop("auto") <= 1.02 * min(means.values())


@pytest.mark.slow
def test_automatic_smoothness_of_a_chain_of_tables_keeps_them_near_their_start():
    """The scale of Base and Effect is known to no data; it went to thousands."""
    target, (fitted, test_points) = "NOx", split(0)
    result, error = held_out(CHAIN, target, chain(fitted, target), fitted, test_points, "auto")
    assert error < 1.05 * min(
        held_out(CHAIN, target, chain(fitted, target), fitted, test_points, f)[1] for f in (1.0, 10.0, 100.0)
    )
    for table in result.parameters.parameters:
        assert np.abs(table.values).max() < 50


CHAIN = """
base = Base(engine_speed, engine_load)
delta = intake_valve_opening - Best(engine_speed, engine_load)
effect = Effect(delta)
y = base * effect - Loss(engine_speed, engine_load)
"""


def chain(fitted, target):
    delta = np.linspace(-4, 4, 9)
    mean = engine()[target].values[fitted].mean()
    return kf.ParameterSet(
        [
            flat("Base", fitted, 8, 1.0),
            flat("Best", fitted, 8, 0.0),
            kf.Curve("Effect", delta, 1 - 0.05 * delta**2),
            flat("Loss", fitted, 8, 1.0 - mean),
        ]
    )


@pytest.mark.slow
def test_a_structure_like_that_of_torque_meets_held_out_nitrogen_oxides_better_than_a_map():
    errors = []
    for fitted, test_points in map(split, range(3)):
        result, error = held_out(CHAIN, "NOx", chain(fitted, "NOx"), fitted, test_points, 0.3)
        assert result.status == "converged"
        errors.append(
            (error, min(error_of_a_map("NOx", fitted, test_points, smoothness, 8) for smoothness in SMOOTHNESS))
        )
    mean, mean_of_the_best_maps = np.mean(errors, axis=0)
    assert mean < 0.9 * mean_of_the_best_maps


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds", [pytest.param([1], id="one split"), pytest.param([0, 1, 2], id="three splits", marks=pytest.mark.slow)]
)
def test_the_continuation_ends_below_the_plain_descent(seeds):
    ratios = []
    for fitted, test_points in map(split, seeds):
        problem = (CHAIN, "NOx", chain(fitted, "NOx"), fitted, test_points, 0.3)
        smoothed, plain = (held_out(*problem, continuation=choice)[0] for choice in ("auto", "off"))
        ratios.append(smoothed.cost_after / plain.cost_after)
    assert np.mean(ratios) < 0.95


def consumption(fitted, test_points, **freedom):
    """The held-out error of a map of 8 x 8 breakpoints of the fuel consumption."""
    name = "specific_fuel_consumption"
    even = flat("M", fitted, 8, engine()[name].values[fitted].mean())
    start = kf.ParameterSet([even.changed(axes=tuple(axis.changed(**freedom) for axis in even.axes))])
    return held_out("y = M(engine_speed, engine_load)", name, start, fitted, test_points, 0.1)


@pytest.mark.slow
def test_free_breakpoints_meet_held_out_fuel_consumption_better_than_even_ones():
    errors = []
    for fitted, test_points in map(split, range(3)):
        (even, even_error), (free, free_error) = (consumption(fitted, test_points, free=free) for free in (False, True))
        assert free.status == "converged"
        assert free.cost_after < 0.95 * even.cost_after
        errors.append((free_error, even_error))
    mean_free, mean_even = np.mean(errors, axis=0)
    assert mean_free < 0.98 * mean_even


RECORDINGS = FILE.parents[1] / "engine_transient"
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "engine-transient"


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason=f"the recordings of the engine are not at {RECORDINGS}")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "errors"), [("paper", {"manifold": 0.183, "catalyst": 0.186}), ("manifold", {"manifold": 0.062})]
)
def test_the_example_meets_the_recording_that_it_never_saw_as_its_readme_says(name, errors, tmp_path):
    folder = Path(shutil.copytree(EXAMPLE, tmp_path / "example", ignore=shutil.ignore_patterns("data", "results")))
    (folder / "data").symlink_to(RECORDINGS)
    project = kf.Project.read(folder / f"{name}.toml")
    assert all(finding.message.startswith("quantiles of ") for finding in project.check())
    result = project.calibrate()
    assert result.converged
    readme = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    for row in result.quality:
        if row.use == "test":
            assert row.rmse_after == pytest.approx(errors[row.criterion], rel=0.02)
            assert f"{errors[row.criterion]:.3f}" in readme
