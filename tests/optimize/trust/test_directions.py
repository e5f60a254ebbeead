"""Undetermined directions in words: the ambiguities of the torque model, and others whose answer is known."""

from functools import cache

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Problem, run
from kennfeld.optimize.trust.undetermined import undetermined_lines
from kennfeld.project.demo import torque
from tests.draws import mostly_slow


@cache
def torque_fit(smoothness=1.0, *, pinned=False, bounded=False):
    start = torque.start()
    bounds = torque.BOUNDS if bounded else dict.fromkeys(torque.BOUNDS, (-np.inf, np.inf))
    start = start.with_parameters(*(start[name].with_bounds(*pair) for name, pair in bounds.items()))
    problem = Problem(
        kf.formula(torque.FORMULA, parameters=list(start)),
        (torque.bench(),),
        start,
        (kf.Criterion("TorquePredict", "Torque"),),
        smoothness={name: smoothness * factor for name, factor in torque.SMOOTHNESS.items()},
        pins=(kf.Pin(*torque.PIN),) if pinned else (),
    )
    return run(problem, kf.Options(continuation="off"))


def directions_with(trust, *words):
    """The directions whose sentence has all these words."""
    return [d for d in trust.directions if all(word in d.sentence for word in words)]


SCALE = ("Scaling MapOptTorque by 1.01 and CurveEtaDeltaSpark by 1/1.01",)
SHIFT = ("MapOptIgnition by 0.", "deg and shifting CurveEtaDeltaSpark along deltaSpark by 0.")


@pytest.mark.slow
@pytest.mark.parametrize("smoothness", [0.0, 1.0])
def test_the_scale_of_torque_and_efficiency_is_undetermined(smoothness):
    result = torque_fit(smoothness)
    (direction,) = directions_with(result.trust, *SCALE)
    assert direction.exact
    assert direction.remedy == "Pin a known value of CurveEtaDeltaSpark, e.g. at 0 to 1."
    assert set(direction.parts) == {"MapOptTorque", "CurveEtaDeltaSpark"}
    assert direction.parts["MapOptTorque"] == pytest.approx(0.01 * result.parameters["MapOptTorque"].values)
    if smoothness:
        assert "determined by smoothness alone" in direction.sentence
        assert 1 < direction.deviation < 1000
    else:
        assert "has no effect on the fit." in direction.sentence
        assert direction.deviation == np.inf
        assert np.all(np.isinf(result.trust.deviation["MapOptTorque"]))


@pytest.mark.parametrize("smoothness", mostly_slow([0.0, 1.0], [1.0]))
def test_an_undetermined_direction_does_not_change_outputs(smoothness):
    result = torque_fit(smoothness)
    (direction,) = directions_with(result.trust, *SCALE)
    data = {name: channel.values for name, channel in torque.bench().items()}
    inputs = {name: data[name] for name in ("Speed", "Rel_Airmass", "Ignition")}

    def simulated(amount):
        moved = [
            result.parameters[name].with_values(result.parameters[name].values + amount * part)
            for name, part in direction.parts.items()
        ]
        changed = result.parameters.with_parameters(*moved)
        return kf.simulate(torque.FORMULA, inputs, changed)["TorquePredict"].values

    assert np.abs(simulated(0.1) - simulated(0.0)).max() < 1e-5 * np.abs(simulated(0.0)).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settled", "smoothness"), [(False, 1.0), pytest.param(True, 0.0, marks=pytest.mark.slow), (True, 1.0)]
)
def test_the_shift_of_ignition_and_efficiency_is_nearly_undetermined(smoothness, settled):
    trust = torque_fit(smoothness, pinned=settled, bounded=settled).trust
    (direction,) = directions_with(trust, *SHIFT)
    assert not direction.exact
    assert "Pin a known value of MapOptIgnition" in direction.remedy
    assert 1e-3 < direction.ratio < 0.2
    part = direction.parts["MapOptIgnition"]
    assert part.mean() > 0
    assert np.isfinite(direction.deviation)


def test_a_pin_determines_the_scale_but_not_the_stretch_that_the_drag_compensates():
    """If eta -> 1 + a (eta - 1), torque -> torque / a, drag -> drag + (1/a - 1) torque, all but the grids stay."""
    trust = torque_fit(pinned=True, bounded=True).trust
    assert not directions_with(trust, *SCALE)
    (direction,) = directions_with(
        trust, "Scaling MapOptTorque", "stretching CurveEtaDeltaSpark about 1", "MapDragTorque"
    )
    assert direction is trust.directions[0]
    assert direction.ratio < 1e-4


def test_the_worst_directions_come_first():
    for fit in (torque_fit(0.0), torque_fit(1.0)):
        ratios = [max(direction.ratio, 1e-12) for direction in fit.trust.directions]
        assert ratios == sorted(ratios)


def test_values_without_data_are_listed_with_their_coordinates():
    trust = torque_fit(0.0).trust
    direction = trust.directions[0]
    assert direction.sentence == (
        "Not determined by data or smoothness, kept at their start values: "
        "3 of 12 values of CurveEtaDeltaSpark (30, 35, 40)."
    )
    assert np.flatnonzero(direction.parts["CurveEtaDeltaSpark"]).tolist() == [9, 10, 11]
    assert np.all(trust.samples["CurveEtaDeltaSpark"][9:] == 0)


X = np.random.default_rng(0).uniform(0, 3, 300)
Z = np.random.default_rng(1).uniform(0, 3, 300)


def sentences(text, members, target, smoothness=0.0, **arguments):
    start = kf.ParameterSet(members)
    columns = {"x": X, "z": Z, "y": target + np.random.default_rng(2).normal(0, 0.01, 300)}
    return kf.calibrate(text, columns, start, target="y", smoothness=smoothness, **arguments).trust.directions


def curve(name, values=1.0):
    return kf.Curve(name, np.arange(4.0), np.broadcast_to(values, 4))


@pytest.mark.parametrize("smoothness", [0.0, 0.1])
def test_the_offset_between_two_terms_is_undetermined(smoothness):
    (direction,) = sentences("m = A(x) + B(z)", [curve("A"), curve("B")], np.sin(X) + np.cos(Z), smoothness)
    assert direction.exact
    assert direction.deviation == np.inf
    assert direction.sentence in (
        "Raising A by 0.01 and lowering B by 0.01 has no effect on the fit.",
        "Raising A by 0.02 and lowering B by 0.02 has no effect on the fit.",
        "Raising A by 0.005 and lowering B by 0.005 has no effect on the fit.",
    )


def test_a_pin_determines_the_offset():
    pins = [kf.Pin("B", (0.0,), 1.0)]
    assert not sentences("m = A(x) + B(z)", [curve("A"), curve("B")], np.sin(X) + np.cos(Z), pins=pins)


def test_scalars_that_compensate_each_other_are_described():
    (direction,) = sentences("m = a * b * x", [kf.Scalar("a", 2.0), kf.Scalar("b", 3.0)], 5 * X)
    assert direction.sentence == "Scaling a by 1.01 and b by 1/1.01 has no effect on the fit."
    assert direction.remedy == "Fix a, or set bounds for it."


def test_maps_on_one_grid_leave_an_offset_between_efficiency_and_loss():
    """Base * (Effect + c) - (Loss + c * Base) is the same for every c, where Base and Loss share their axes."""
    surface = kf.Map("Base", np.arange(4.0), np.arange(4.0), 2 + np.add.outer(np.arange(4.0), np.arange(4.0)))
    loss = kf.Map("Loss", np.arange(4.0), np.arange(4.0), np.add.outer(np.arange(4.0), -np.arange(4.0)))
    turn = np.random.default_rng(5).uniform(0, 3, 300)
    target = (2 + X + Z) * (1 + 0.1 * turn) - X + Z
    columns = {"x": X, "z": Z, "turn": turn, "y": target + np.random.default_rng(2).normal(0, 0.01, 300)}
    start = kf.ParameterSet([surface, curve("Effect", 1 + 0.1 * np.arange(4.0)), loss])
    trust = kf.calibrate("m = Base(x, z) * Effect(turn) - Loss(x, z)", columns, start, target="y").trust
    assert [direction.exact for direction in trust.directions][:3] == [True, True, False]
    assert directions_with(trust, "Scaling Base by 1.01 and Effect by 1/1.01 has no effect on the fit.")
    (hidden,) = directions_with(trust, "Raising Effect by 0.01 and Loss by 0.01 times Base has no effect on the fit.")
    assert "Pin a known value of Effect" in hidden.remedy


def test_a_product_of_three_has_two_undetermined_scales():
    open_directions = sentences("m = A(x) * B(z) * k", [curve("A"), curve("B"), kf.Scalar("k", 2.0)], (1 + X) * (2 + Z))
    assert len(open_directions) == 2
    assert all(direction.exact and "caling" in direction.sentence for direction in open_directions)


def test_an_offset_in_front_of_a_curve_and_its_shift_are_nearly_one():
    members = [kf.Scalar("k", 0.1), kf.Curve("C", np.linspace(-1, 4, 21), np.linspace(-1, 4, 21) ** 2)]
    (direction,) = sentences("m = C(x - k)", members, (X - 0.3) ** 2, 1e-3)
    assert "k" in direction.parts
    assert "shifting C along" in direction.sentence


def test_directions_of_no_common_form_are_described_by_grid_points():
    """Both curves are looked up at two places only, so that their grid points stand for each other."""
    x = np.where(X < 1.5, 0.5, 2.5)
    start = kf.ParameterSet([curve("A")])
    trust = kf.calibrate("m = A(x)", {"x": x, "y": x}, start, target="y").trust
    assert len(trust.directions) == 2
    assert sorted(d.sentence for d in trust.directions) == [
        "Raising A at 0 and lowering A at 1 together has no effect on the fit.",
        "Raising A at 2 and lowering A at 3 together has no effect on the fit.",
    ] or all("together has no effect on the fit" in d.sentence for d in trust.directions)
    assert all(np.isinf(trust.deviation["A"]))


def test_a_determined_model_has_no_directions():
    assert sentences("m = A(x) + k * z", [curve("A"), kf.Scalar("k", 1.0)], np.sin(X) + Z) == ()


def test_a_table_without_samples_is_described():
    start = kf.ParameterSet([curve("A"), curve("B")])
    columns = {"x": X, "z": Z, "y": np.sin(X)}
    trust = kf.calibrate("m = if(x < 10, A(x), B(z))", columns, start, target="y").trust
    (direction,) = trust.directions
    assert direction.sentence == "Not determined by data or smoothness, kept at their start values: all values of B."
    assert direction.remedy == "Record samples there or lock them."


def test_a_threshold_of_a_search_without_gradients_is_described():
    u = np.linspace(0.0, 10.0, 100)
    data = {"u": u, "z": 2.0 * (u > 4.0)}
    start = kf.ParameterSet([kf.Scalar("a", 1.0, lower=0.0, upper=10.0), kf.Scalar("T", 5.0, lower=0.0, upper=10.0)])
    options = kf.Options(method="global", max_evaluations=300)
    result = kf.calibrate("y = a * (u > T)", data, start, target="z", options=options)
    assert result.quality[0].rmse_after < 0.1
    (direction,) = directions_with(result.trust, "moved T", "its uncertainty is unknown")
    assert direction.exact
    assert list(direction.parts) == ["T"]
    assert not directions_with(result.trust, "kept at its start value")


def curve_and_slope(**more):
    """Fit y = C(x) + k*x, in which k and a part of C that rises with x are one."""
    x = np.random.default_rng(0).uniform(0, 10, 300)
    data = {"x": x, "m": np.interp(x, [0, 5, 10], [1, 3, 4]) + 2 * x}
    tables = kf.ParameterSet([kf.Curve("C", [0, 5, 10], np.ones(3)), kf.Scalar("k", 0.5)])
    return kf.calibrate("y = C(x) + k * x", data, tables, target="m", **more).trust


def test_an_undetermined_direction_is_named_rather_than_a_simple_one_near_it():
    (direction,) = curve_and_slope().directions
    assert direction.exact
    assert set(direction.parts) == {"C", "k"}
    assert "has no effect on the fit" in direction.sentence
    assert direction.remedy == "Fix k, or record samples that distinguish them."


@pytest.mark.parametrize(
    ("text", "truth", "sentence"),
    [
        ("y = a + b + 0 * x", 5.0, "Raising a by 0.02 and lowering b by 0.02 has no effect on the fit."),
        ("y = a * b * x", 6.0, "Scaling a by 1.01 and b by 1/1.01 has no effect on the fit."),
        ("y = a / b * x", 0.5, "Scaling a by 1.01 and b by 1.01 has no effect on the fit."),
        ("y = (a - b) * x", -1.0, "Raising a by 0.02 and b by 0.02 has no effect on the fit."),
    ],
)
def test_values_are_scaled_only_if_factors_have_no_effect(text, truth, sentence):
    x = np.linspace(1, 2, 50)
    data = {"x": x, "m": truth * (x if "* x" in text and "0 *" not in text else np.ones(50))}
    start = {"a": 2.0, "b": {5.0: 3.0, 6.0: 3.0, 0.5: 4.0, -1.0: 3.0}[truth]}
    (direction,) = kf.calibrate(text, data, start, target="m").trust.directions
    assert direction.sentence == sentence


@pytest.mark.slow
def test_rounding_does_not_decide_if_the_values_of_a_quotient_are_scaled():
    """Factors and differences have no effect, either of them."""
    x = np.linspace(0, 10, 200)
    for seed in range(4):
        data = {"x": x, "m": 3 * x + 0.1 * np.random.default_rng(seed).standard_normal(x.size)}
        (direction,) = kf.calibrate("y = a / b * x", data, {"a": 1.0, "b": 1.5}, target="m").trust.directions
        assert direction.sentence == "Scaling a by 1.01 and b by 1.01 has no effect on the fit."


def test_a_pin_is_suggested_at_the_fitted_value_if_the_start_violates_bounds():
    """The scale is open: a curve between 0 and 1 whose start is far outside."""
    rng = np.random.default_rng(0)
    x, z = rng.uniform(0, 10, (2, 400))
    tables = kf.ParameterSet(
        [
            kf.Curve("A", [0, 5, 10], [50.0, 60.0, 70.0]),
            kf.Curve("B", [0, 10], [-59.6, 0.5], lower=0.0, upper=1.0),
        ]
    )
    data = {"x": x, "z": z, "m": np.interp(x, [0, 5, 10], [100, 130, 120]) * np.interp(z, [0, 10], [0.5, 0.8])}
    result = kf.calibrate("y = A(x) * B(z)", data, tables, target="m")
    for direction in result.trust.directions:
        for remedy in direction.remedies:
            for pin in remedy.pins:
                assert 0 <= pin.value <= 1
                assert pin.value == pytest.approx(np.interp(pin.at[0], [0, 10], result.parameters["B"].values))


def test_a_direction_known_to_one_percent_is_coupled_but_determined():
    x = np.random.default_rng(0).uniform(10, 11, 2000)
    data = {"x": x, "m": 2 + 40 * x + 0.001 * np.random.default_rng(1).standard_normal(x.size)}
    trust = kf.calibrate("y = a + b * x", data, {"a": 1.0, "b": 1.0}, target="m").trust
    (direction,) = trust.directions
    assert trust.deviation["b"] < 0.01
    assert direction.determined
    assert direction.sentence.endswith("coupled, but determined (standard deviation 0.041 %).")
    assert undetermined_lines(trust, "") == ["Coupled, but determined:", f"  {direction.sentence}"]
    assert trust.as_json()["directions"][0]["determined"]


@pytest.mark.parametrize(
    ("formula", "target", "bounds", "sentence"),
    [
        ("y = a + b", 50.0, {"a": (0, 10), "b": (0, 60)}, "Lowering a by 0.1 and raising b by 0.1"),
        ("y = a*b*x", 50.0, {"a": (0.9, 1.1), "b": (0, 100)}, "Scaling a by 1/1.01 and b by 1.01"),
    ],
    ids=["a sum", "a product"],
)
def test_a_direction_leads_away_from_the_bound_that_a_value_has_reached(formula, target, bounds, sentence):
    x = np.linspace(0.9, 1.1, 60)
    data = {"x": x, "q": target + 0.1 * np.random.default_rng(0).normal(size=60)}
    result = kf.calibrate(formula, data, {"a": 1.0, "b": 1.0}, target="q", bounds=bounds)
    assert result.parameters["a"].value == bounds["a"][1]
    assert directions_with(result.trust, sentence)


def test_a_direction_leads_away_from_a_curve_that_would_fall():
    x = np.linspace(0, 10, 60)
    data = {"x": x, "q": np.interp(x, [0, 5, 10], [1, 3, 4])}
    start = kf.ParameterSet([kf.Curve("C", [0.0, 5.0, 10.0], [1.0, 1.0, 1.0]), kf.Scalar("k", 1.0)])
    rising = [kf.Shape("C", 0, "slope", lower=0.0)]
    result = kf.calibrate("y = C(x) + k*x", data, start, target="q", constraints=rising)
    assert result.parameters["k"].value == pytest.approx(0.2)
    assert directions_with(result.trust, "Lowering k and raising C at 10 and 5")


def test_a_direction_determined_by_data_without_noise_is_not_listed():
    x = np.linspace(0, 10, 100)
    start = {"a": 1.0, "b": 0.4}
    result = kf.calibrate("y = a*exp(b*x)", {"x": x, "m": 2 * np.exp(0.3 * x)}, start, target="m")
    assert not result.trust.directions
    noisy = 2 * np.exp(0.3 * x) + 0.1 * np.random.default_rng(0).standard_normal(x.size)
    (direction,) = kf.calibrate("y = a*exp(b*x)", {"x": x, "m": noisy}, start, target="m").trust.directions
    assert direction.determined
