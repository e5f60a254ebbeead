"""Recordings that are averaged to steady-state points."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "engine_transient"
LEVELS = (1000.0, 1500.0, 2500.0, 3000.0)


@pytest.fixture
def ridden(shop):
    """A recording at 10 Hz: four levels of speed for 10 s each, with ramps of 2 s between them."""
    levels = [np.full(101, level) for level in LEVELS]
    ramps = [np.linspace(a, b, 21)[1:-1] for a, b in pairwise(LEVELS)]
    n = np.concatenate([part for pair in zip(levels, [*ramps, []], strict=True) for part in pair])
    n[:101] += np.where(np.arange(101) % 2, 4.0, -4.0)

    def write(name="bench.csv", **changes):
        load = 10.0 + n / 1000
        torque = np.interp(n, [1000, 2000, 3000], [1, 2, 3]) * load + 5
        columns = {"time [s]": np.arange(n.size) * 0.1, "n [rpm]": n, "Load": load, "Torque [Nm]": torque}
        shop.csv(name, {key: c for key, c in (columns | changes).items() if c is not None})

    write()
    shop.ride = write
    shop.speed = n
    return steady(shop)


def steady(shop, text='{ channel = "n", window = 5.0, tolerance = 10 }', more=""):
    return shop.change('files = ["bench.csv"]', f'files = ["bench.csv"]\nsteady = {text}\n{more}')


def again(shop, old, new):
    return shop.change(old, new)


def points(shop):
    assert shop.errors() == []
    return shop.project.problem().datasets[0]


def test_each_plateau_becomes_a_point_without_time(ridden):
    data = points(ridden)
    assert data.time is None
    assert data["n"].values == pytest.approx(LEVELS, abs=0.5)
    assert data["n"].values[2] == 2500.0
    assert data["n"].unit == "rpm"


def test_a_run_on_plateaus_finds_the_values(ridden):
    result = ridden.project.calibrate()
    assert result.parameters["offset"].value + result.parameters["Gain"].values[0] * 11 == pytest.approx(16, abs=0.1)


def test_the_number_of_plateaus_is_a_remark(ridden):
    [remark] = [f for f in ridden.findings() if f.severity == "remark"]
    assert str(remark) == "kennfeld.toml [[dataset]] 1 steady: 4 plateaus of 10 s, 87% of the 46 s recorded"


def test_no_plateau_names_the_longest_stretch_and_the_tolerance_that_gives_one(ridden):
    again(ridden, "window = 5.0, tolerance = 10", "window = 11.0, tolerance = 10")
    error = ridden.error()
    assert "no stretch of 11 s has n within +-10; the longest is 10" in error
    least = float(error.split("tolerance = ")[1].split(" ")[0])
    again(ridden, "tolerance = 10", f"tolerance = {least}")
    assert points(ridden).samples >= 1


def test_a_window_longer_than_the_recording_is_an_error(ridden):
    again(ridden, "window = 5.0", "window = 500.0")
    assert "no part of the recording without a gap is 500 s long; the longest is 46 s" in ridden.error()


def test_several_channels_must_be_steady_at_once(ridden):
    load = np.where(np.arange(ridden.speed.size) < 50, 0.0, 20.0)
    ridden.ride(Load=load)
    text = '{ channel = "n", window = 5.0, tolerance = 10 }'
    again(ridden, text, f'[{text}, {{ channel = "Load", window = 2, tolerance = 0 }}]')
    data = points(ridden)
    assert data["Load"].values.tolist() == [20, 20, 20, 20]
    again(ridden, "window = 5.0", "window = 10.9")
    assert "each alone: n " in ridden.error()


def test_samples_that_fail_the_condition_are_excluded_from_the_means(ridden):
    lambda_ = np.ones(ridden.speed.size)
    torque = np.full(ridden.speed.size, 7.0)
    lambda_[30], torque[30] = 2.0, 1e6
    ridden.ride(**{"lambda": lambda_, "Torque [Nm]": torque})
    again(ridden, "steady =", 'where = "lambda < 1.5"\nmax_gap = 0.5\nsteady =')
    data = points(ridden)
    assert data["Torque"].values.tolist() == [7.0] * 4
    assert data.scored is None


def test_a_sample_that_fails_the_condition_ends_a_plateau_without_max_gap(ridden):
    lambda_ = np.ones(ridden.speed.size)
    lambda_[40] = 2.0
    ridden.ride(**{"lambda": lambda_})
    again(ridden, "steady =", 'where = "lambda < 1.5"\nsteady =')
    assert points(ridden)["n"].values == pytest.approx(LEVELS, abs=0.5)
    again(ridden, "window = 5.0", "window = 3.0")
    assert points(ridden).samples == 5


def test_calculated_channels_are_calculated_in_time_and_then_averaged(ridden):
    ridden.ride(Load=None, air=np.arange(ridden.speed.size, dtype=float))
    ridden.add('[calculated]\nLoad = "air * air"')
    first = np.arange(101.0)
    assert points(ridden)["Load"].values[0] == pytest.approx(np.mean(first**2))


def test_the_condition_may_exclude_the_first_seconds(ridden):
    again(ridden, "steady =", 'where = "t > 6"\nsteady =')
    assert points(ridden)["n"].values == pytest.approx(LEVELS[1:])


def test_plateaus_are_found_in_the_unit_of_the_function(ridden):
    ridden.ride(**{"n [rpm]": None, "n [1/s]": None, "n [rad/s]": ridden.speed * np.pi / 30})
    assert points(ridden)["n"].values == pytest.approx(LEVELS, abs=0.5)


def test_a_calculated_channel_can_be_the_steady_one(ridden):
    ridden.add('[calculated]\nkrpm = "n / 1000"')
    again(ridden, 'channel = "n", window = 5.0, tolerance = 10', 'channel = "krpm", window = 5.0, tolerance = 0.01')
    assert points(ridden).samples == 4
    assert not [f for f in ridden.findings() if "nothing uses" in f.message]


def test_plateaus_do_not_cross_files(ridden):
    ridden.ride("bench2.csv")
    assert points(again(ridden, '"bench.csv"', '"bench*.csv"')).samples == 8


def test_a_raster_is_applied_before_averaging(ridden):
    assert points(again(ridden, "steady =", "raster = 0.5\nsteady =")).samples == 4


def test_points_of_plateaus_may_be_held_for_a_function_with_memory(ridden):
    ridden.text += "Late = PT1(Predict, 1)\n"
    again(ridden, 'node = "Predict"', 'node = "Late"')
    assert "write settle = ..." in ridden.error()
    data = points(again(ridden, "steady =", "settle = 5.0\nstep = 0.1\nsteady ="))
    assert data.settling is not None
    assert data.samples == 4


def test_data_without_time_stamps_are_refused(ridden):
    ridden.ride(**{"time [s]": None})
    assert "steady: steady requires time stamps, but the data have none" in ridden.error()


def test_an_unknown_channel_names_the_nearest(ridden):
    error = again(ridden, 'channel = "n"', 'channel = "Loda"').error()
    assert "bench.csv: has no channel Loda, the channel of `steady`. Did you mean Load?" in error


def test_keys_without_a_meaning_are_refused(ridden):
    again(ridden, "steady =", 'warmup = 3.0\nshift = { n = "auto" }\nsteady =')
    errors = " ".join(ridden.errors())
    assert "warmup contradicts steady" in errors
    assert 'Write where = "t > 3"' in errors
    assert 'shift = "auto" contradicts steady: averaged points have no time. Write n = ... in s.' in errors


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("true", "must be a table or a list of tables"),
        ("[]", "must be a table or a list of tables"),
        ('{ channel = "n", window = 0, tolerance = 1 }', "steady window: must be > 0, got 0"),
        ('{ channel = "n", window = 1, tolerance = -1 }', "steady tolerance: must be >= 0, got -1"),
        ('{ channel = "n", window = 1, tolerance = inf }', "steady tolerance: must be a number, got inf"),
        ('{ channel = "n", window = 1 }', "steady tolerance: the key is missing"),
        ('{ channel = "n", window = 1, tolerance = 1, span = 2 }', "steady span: unknown key"),
        (
            '[{ channel = "n", window = 1, tolerance = 1 }, { channel = "n", window = 2, tolerance = 1 }]',
            "duplicate channel n",
        ),
    ],
)
def test_values_without_a_meaning_are_findings(shop, text, message):
    assert message in steady(shop, text).error()


def test_a_channel_without_values_is_a_finding(ridden):
    ridden.ride(Load=np.full(ridden.speed.size, np.nan))
    error = again(ridden, 'channel = "n"', 'channel = "Load"').errors()[0]
    assert "no scored sample has Load" in error


def test_a_shift_is_applied_before_averaging(ridden):
    plain = points(ridden)["Torque"].values
    again(ridden, "steady =", "shift = { Torque = 2.0 }\nsteady =")
    shifted = points(ridden)["Torque"].values
    assert shifted[1] < plain[1]


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason=f"the recordings of the engine are not at {REAL}")
def test_real_drives_have_plateaus_within_their_bands(shop):
    (shop.folder / "m.kf").write_text("y = M(speed, load)\n")
    shop.toml = f"""
[model]
file = "m.kf"
[[dataset]]
files = ["{REAL.as_posix()}/gengine1_m1*.csv.gz"]
where = "fuel_cutoff < 1"
max_gap = 0.3
steady = [{{ channel = "speed", window = 8, tolerance = 0.05 }}, {{ channel = "load", window = 5, tolerance = 0.1 }}]
[[criterion]]
node = "y"
target = "T_exh_manifold"
[parameters.M]
x = {{ input = "speed", count = 5 }}
y = {{ input = "load", count = 4 }}
initial = 0.0
"""
    data = points(shop)
    assert 40 < data.samples < 150
    recorded = [kf.read(path) for path in sorted(REAL.glob("gengine1_m1*.csv.gz"))]
    for name in ("speed", "load"):
        low = min(np.nanmin(recording[name].values) for recording in recorded)
        high = max(np.nanmax(recording[name].values) for recording in recorded)
        assert low <= data[name].values.min() < data[name].values.max() <= high
    remark, *others = [f.message for f in shop.findings() if f.severity == "remark"]
    assert remark.startswith(f"{data.samples} plateaus of ")
    assert all(other.startswith("quantiles of ") for other in others)
