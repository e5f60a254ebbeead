import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.constraints import Equality, Pin, Shape, Term

SPEEDS, LOADS = np.linspace(1000, 6000, 6), np.linspace(10, 100, 5)


def bench(count=600, seed=0):
    """Columns of a noisy map that is not square, over axes of unequal lengths."""
    rng = np.random.default_rng(seed)
    speed, load = rng.uniform(900, 6100, count), rng.uniform(5, 105, count)
    torque = 2.2 * load - ((speed - 3500) / 400) ** 2 + rng.normal(0, 0.3, count)
    return {"n": speed, "load": load, "m": torque}


def start(**settings):
    return kf.ParameterSet([kf.Map("M", SPEEDS, LOADS, np.zeros((6, 5)), **settings)])


def calibrate(parameters=None, **settings):
    arguments = {"step": {"M": 5.0}, "rounding": "joint", "test": bench(seed=1)} | settings
    return kf.calibrate("y = M(n, load)", bench(), parameters or start(), "m", **arguments)


def on_grid(values, step=5.0):
    return np.array_equal(np.rint(values / step) * step, values)


def test_all_values_are_multiples_within_the_shift_and_cost_less_than_the_nearest():
    result, fit = calibrate(), calibrate(rounding=None, step=None)
    values, unrounded = result.parameters["M"].values, fit.parameters["M"].values
    assert on_grid(values)
    assert np.abs(values - unrounded).max() <= 10.0
    errors = result.rounding
    assert errors.unrounded["y/training"] == pytest.approx(fit.quality[0].rmse_after)
    assert errors.joint["y/training"] == result.quality[0].rmse_after
    for key in ("y/training", "y/test"):
        loss = errors.joint[key] - errors.unrounded[key]
        assert loss <= 0.9 * (errors.nearest[key] - errors.unrounded[key])


def test_nearest_rounds_each_value_on_its_own_and_tells_what_joint_would_reach():
    result, fit = calibrate(rounding="nearest"), calibrate(rounding=None, step=None)
    np.testing.assert_array_equal(result.parameters["M"].values, np.rint(fit.parameters["M"].values / 5) * 5)
    assert result.quality[0].rmse_after == result.rounding.nearest["y/training"]
    assert result.rounding.joint["y/training"] < result.rounding.nearest["y/training"]
    [label] = result.rounding.labels
    assert (label.moved, label.largest_shift <= 0.5, label.share) == (0, True, pytest.approx(1.0, abs=0.02))


def test_bounds_locks_slopes_and_pins_hold_after_rounding():
    locked = np.zeros((6, 5), dtype=bool)
    locked[2, 1] = True
    values = np.full((6, 5), 100.0)
    values[2, 1] = 73.0  # between two steps
    parameters = start().with_parameters(
        kf.Map("M", SPEEDS, LOADS, values, locked=locked, lower=1.0, upper=[[207.0] * 5] * 6)
    )
    rising = Shape("M", 1, "slope", lower=0.0)
    with pytest.warns(kf.InputWarning, match="1 locked value of M is between two steps of 5, such as 73"):
        result = calibrate(parameters, constraints=[rising], pins=[Pin("M", (1000.0, 10.0), 15.0)])
    fitted = result.parameters["M"].values
    assert fitted[2, 1] == 73.0
    assert on_grid(fitted[~locked])
    assert fitted.min() >= 5.0
    assert fitted.max() <= 205.0
    assert np.diff(fitted, axis=1).min() >= 0.0
    assert fitted[0, 0] == 15.0


def test_a_pin_and_a_sum_between_steps_hold_as_far_as_storage_allows_and_say_so():
    total = Equality([Term("M", (3000.0, 55.0)), Term("M", (4000.0, 55.0))], 233.0)
    with pytest.warns(kf.InputWarning, match="the pin of M at 1000, 10 to 13 lies between two steps of 5"):
        result = calibrate(pins=[Pin("M", (1000.0, 10.0), 13.0)], constraints=[total])
    fitted = result.parameters["M"].values
    assert fitted[0, 0] == 15.0
    assert abs(fitted[2, 2] + fitted[3, 2] - 233.0) <= 2.5
    warnings = " ".join(map(str, result.warnings))
    assert "pin of M at x = 1000, y = 10 is 15 instead of 13, the nearest that storage allows" in warnings
    # other storable values may be closer, which the errors outweigh
    assert "instead of 233, as close as half a step of one of its values" in warnings


def test_limits_that_no_storable_values_keep_leave_the_values_of_their_group_as_fitted():
    tight = Shape("M", 1, "slope", lower=0.09, upper=0.12)  # 2.0 to 2.7 per cell, less than a step of 5
    result = calibrate(constraints=[tight])
    assert not on_grid(result.parameters["M"].values)
    assert "30 of 30 values of M not rounded: no storable values near the fit keep the limits" in str(result)


def test_free_breakpoints_are_rounded_with_the_values_and_stay_in_order(tmp_path):
    a2l = tmp_path / "ecu.a2l"
    a2l.write_bytes(curve_file())
    x = np.linspace(0, 10, 400)
    data = {"x": x, "m": np.minimum(4 * x, 20 + 0.3 * x)}
    curve = kf.Curve("L", kf.Axis([0.0, 3.1, 7.1, 10.0], free=True), np.zeros(4))
    result = kf.calibrate("y = L(x)", data, {"L": curve}, "m", rounding="joint", storage=a2l)
    fitted = result.parameters["L"]
    points = fitted.axes[0].breakpoints
    assert on_grid(points, 0.25)
    assert on_grid(fitted.values, 0.5)
    assert np.diff(points).min() > 0
    assert {label.name: (label.step, label.bits) for label in result.rounding.labels} == {
        "L": (0.5, 8),
        "L.x": (0.25, 8),
    }


def curve_file():
    from tests.calfiles.a2l_files import axis, label, layout, method, module

    table = layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT")
    points = axis("STD_AXIS", 4, conversion="CX")
    conversions = (
        method("CX", "LINEAR", "COEFFS_LINEAR 0.25 0"),
        method("CV", "RAT_FUNC", "COEFFS 0 2 0 0 0 1"),
    )
    return module(table, *conversions, label("CURVE", points, conversion="CV"))


def test_fixed_breakpoints_are_rounded_before_the_fit(tmp_path):
    a2l = tmp_path / "ecu.a2l"
    a2l.write_bytes(curve_file())
    x = np.linspace(0, 10, 50)
    curve = kf.Curve("L", [0.0, 3.1, 7.1, 10.0], np.zeros(4))
    result = kf.calibrate("y = L(x)", {"x": x, "m": 2 * x}, {"L": curve}, "m", rounding="joint", storage=a2l)
    np.testing.assert_array_equal(result.parameters["L"].axes[0].breakpoints, [0.0, 3.0, 7.0, 10.0])
    close = kf.Curve("L", [0.0, 3.1, 3.12, 10.0], np.zeros(4))
    with pytest.warns(kf.InputWarning, match=r"3.1 and 3.12 of L.x would be stored as one .* moved to 3 and 3.25"):
        result = kf.calibrate("y = L(x)", {"x": x, "m": 2 * x}, {"L": close}, "m", rounding="joint", storage=a2l)
    np.testing.assert_array_equal(result.parameters["L"].axes[0].breakpoints, [0.0, 3.0, 3.25, 10.0])
    crowd = kf.Curve("L", [3.01, 3.02, 3.03, 3.04, 3.05, 3.06, 3.07, 3.08], np.zeros(8))
    with pytest.raises(kf.InputError, match=r"breakpoints 3.01 and 3.02 of L.x are stored as one: its step is 0.25"):
        kf.calibrate("y = L(x)", {"x": x, "m": 2 * x}, {"L": crowd}, "m", rounding="joint", storage=a2l)


def test_a_group_axis_under_another_name_is_rounded_as_the_axis_of_its_table(tmp_path):
    a2l = tmp_path / "ecu.a2l"
    a2l.write_bytes(curve_file())
    x = np.linspace(0, 10, 50)
    curve = kf.Curve("L", kf.Axis([0.0, 3.1, 7.1, 10.0], name="AxisOfMine"), np.zeros(4))
    result = kf.calibrate("y = L(x)", {"x": x, "m": 2 * x}, {"L": curve}, "m", rounding="joint", storage=a2l)
    np.testing.assert_array_equal(result.parameters["L"].axes[0].breakpoints, [0.0, 3.0, 7.0, 10.0])


def test_breakpoints_are_rounded_to_a_step_of_their_own():
    x = np.linspace(0, 10, 50)
    data, curve = {"x": x, "m": 2 * x}, kf.Curve("L", [0.0, 3.1, 7.1, 10.0], np.zeros(4))
    settings = {"rounding": "joint", "step": {"L.x": 0.5, "L": 0.25}}
    result = kf.calibrate("y = L(x)", data, {"L": curve}, "m", **settings)
    np.testing.assert_array_equal(result.parameters["L"].axes[0].breakpoints, [0.0, 3.0, 7.0, 10.0])
    assert on_grid(result.parameters["L"].values, 0.25)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rounding": None}, "step requires rounding"),
        ({"rounding": "up"}, 'rounding must be "joint" or "nearest", got \'up\''),
        ({"step": {"N": 1.0}}, "step: unknown parameter or axis N"),
        ({"step": {"M": 0.0}}, "step=0 of M must be a finite number > 0"),
        ({"max_shift": 0.5}, "max_shift=0.5 of the rounding"),
    ],
)
def test_settings_that_cannot_be_used_are_named(settings, message):
    with pytest.raises(kf.ArgumentError, match=message):
        calibrate(**settings)


def test_bounds_without_a_storable_value_are_refused_before_the_fit():
    with pytest.raises(
        kf.InputError,
        match="the bounds such as 1 to 4 of 30 values of M contain no value that can be stored: its step is 5",
    ):
        calibrate(start(lower=1.0, upper=4.0))


def test_the_result_tells_the_errors_and_the_labels_as_json():
    rounding = calibrate().as_json()["rounding"]
    assert list(rounding) == ["method", "max_shift", "unrounded", "nearest", "joint", "labels", "finer"]
    assert set(rounding["joint"]) == {"y/training", "y/test"}
    assert rounding["labels"]["M"]["step"] == 5.0
    assert rounding["finer"] == "M"
    assert "rounding" not in calibrate(rounding=None, step=None).as_json()


def test_a_criterion_of_few_samples_is_not_given_up_for_another():
    data, few = bench(), bench(12, seed=3)
    few["k"] = few.pop("m") * 0.1 + 3.0
    criteria = [kf.Criterion("y", "m"), kf.Criterion("z", "k")]
    parameters = kf.ParameterSet([start()["M"], kf.Scalar("a", 0.0), kf.Scalar("b", 0.0)])
    result = kf.calibrate(
        "y = M(n, load)\nz = a * y + b",
        [data, few],
        parameters,
        criteria=criteria,
        rounding="joint",
        step={"M": 5.0, "a": 1 / 256, "b": 0.5},
    )
    rounding = result.rounding
    loss, nearest = (
        {key: errors[key] / rounding.unrounded[key] - 1 for key in ("y/training", "z/training1")}
        for errors in (rounding.joint, rounding.nearest)
    )
    assert max(loss.values()) < max(nearest.values())


def test_a_limit_of_an_output_that_rounding_exceeds_is_reported():
    limits = [kf.Limit("y", upper=2.0)]
    data = {"x": np.linspace(0, 1, 9), "m": 4 * np.linspace(0, 1, 9)}
    result = kf.calibrate("y = k * x", data, {"k": 1.0}, "m", limits=limits, rounding="nearest", step={"k": 1.3})
    assert "rounding to storage exceeds limits of outputs that the fit keeps" in str(result)
