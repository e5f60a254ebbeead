"""The trust of a result: its shapes, its order, and fits with little information."""

import json
import pickle

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Stop

X = np.random.default_rng(0).uniform(0, 3, 200)
Z = np.random.default_rng(1).uniform(0, 2, 200)
Y = np.sin(X) * (1 + Z) + np.random.default_rng(2).normal(0, 0.05, 200)
DATA = {"x": X, "z": Z, "y": Y}


def fit(text="m = M(x, z) + k", smoothness=0.0, locked=False, **arguments):
    members = [
        kf.Map("M", np.arange(4.0), np.arange(3.0), np.ones((4, 3)), unit="Nm", locked=locked),
        kf.Scalar("k", 0.0),
    ]
    arguments = {"free": ["M"]} | arguments
    return kf.calibrate(text, DATA, kf.ParameterSet(members), target="y", smoothness={"M": smoothness}, **arguments)


def test_every_array_has_the_shape_of_its_table():
    trust = fit().trust
    mappings = ("informed", "samples", "deviation", "scatter", "by_smoothness", "leverage")
    for name in mappings:
        arrays = getattr(trust, name)
        assert list(arrays) == ["M"]
        assert arrays["M"].shape == (4, 3)
    assert trust.informed["M"].dtype == trust.by_smoothness["M"].dtype == bool
    assert trust.samples["M"].dtype == np.int64


def test_a_trust_is_computed_once_on_demand():
    result = fit()
    assert "trust" not in vars(result)
    assert result.trust is result.trust


def test_samples_are_counted_once_for_several_lookups():
    trust = fit("m = M(x, z) + M(x, z) * 0.5 + M(3 - x, 2 - z) * 0.001 + k").trust
    cells = np.floor(X).astype(int), np.floor(Z).astype(int)
    mirrored = np.floor(3 - X).astype(int), np.floor(2 - Z).astype(int)
    expected = np.zeros((4, 3), dtype=int)
    for i, j in np.ndindex(4, 3):
        near = [(np.abs(a - i + 0.5) < 1) & (np.abs(b - j + 0.5) < 1) for a, b in (cells, mirrored)]
        expected[i, j] = np.count_nonzero(near[0] | near[1])
    assert trust.samples["M"].tolist() == expected.tolist()


def test_samples_without_a_target_do_not_count():
    target = np.where(X < 1, np.nan, Y)
    start = kf.ParameterSet([kf.Curve("C", np.arange(4.0), np.zeros(4))])
    trust = kf.calibrate("m = C(x)", {"x": X, "y": target}, start, target="y").trust
    assert trust.samples["C"][0] == 0
    assert trust.samples["C"][1] == np.count_nonzero((X >= 1) & (X < 2))


def test_covariances_come_parameter_by_parameter():
    start = kf.ParameterSet([kf.Curve("A", np.arange(4.0), np.ones(4)), kf.Scalar("k", 1.0), kf.Scalar("b", 1.0)])
    trust = kf.calibrate("m = A(x) * (b + k * z)", DATA, start, target="y", pins=[kf.Pin("A", (1.0,), 1.0)]).trust
    whole = trust.covariance()
    assert whole.shape == (6, 6)
    assert np.sqrt(np.diag(whole)) == pytest.approx(np.concatenate([np.ravel(d) for d in trust.deviation.values()]))
    order = {name: i for i, name in enumerate(trust.deviation)}
    some = trust.covariance(["k", "A"])
    starts = np.cumsum([0, *(trust.deviation[name].size for name in trust.deviation)])
    columns = [starts[order["k"]], *range(starts[order["A"]], starts[order["A"]] + 4)]
    assert some == pytest.approx(whole[np.ix_(columns, columns)])
    correlation = trust.correlation(["k", "A"])
    assert np.diag(correlation).tolist() == [1.0] * 5
    assert np.isnan(correlation[2, [0, 1, 3, 4]]).all()  # A at 1 is pinned
    free = [0, 1, 3, 4]
    assert np.all(np.abs(correlation[np.ix_(free, free)]) <= 1)
    assert np.allclose(correlation[np.ix_(free, free)], correlation[np.ix_(free, free)].T)


def test_an_undetermined_value_has_an_infinite_variance_and_no_covariances():
    start = kf.ParameterSet([kf.Curve("C", np.arange(6.0), np.zeros(6))])
    trust = kf.calibrate("m = C(x)", DATA, start, target="y").trust
    assert np.isinf(trust.deviation["C"]).tolist() == [False] * 4 + [True] * 2
    covariance = trust.covariance()
    assert np.isinf(np.diag(covariance)).tolist() == [False] * 4 + [True] * 2
    assert np.isnan(covariance[5, :5]).all()
    assert np.isfinite(covariance[:4, :4]).all()


def test_an_unknown_name_comes_with_the_nearest_one():
    with pytest.raises(kf.KennfeldError, match="N is not a free parameter of this result"):
        fit().trust.covariance(["N"])


def test_corners_without_data_are_determined_by_smoothness_and_less_certain():
    inside = (X < 2) | (Z < 1)
    columns = {name: values[inside] for name, values in DATA.items()}
    start = kf.ParameterSet([kf.Map("M", np.arange(5.0), np.arange(4.0), np.ones((5, 4)))])
    trust = kf.calibrate("m = M(x, z)", columns, start, target="y", smoothness=0.1).trust
    assert trust.by_smoothness["M"].tolist() == (trust.samples["M"] == 0).tolist()
    assert trust.by_smoothness["M"][4, 3]
    assert trust.informed["M"].all()
    assert np.all(np.isfinite(trust.deviation["M"]))
    assert trust.deviation["M"][4, 3] == trust.deviation["M"].max()
    assert trust.deviation["M"][4, 3] > 3 * trust.deviation["M"][1, 1]
    assert np.all(trust.leverage["M"][trust.by_smoothness["M"]] == 0)


def test_corners_without_data_are_undetermined_without_smoothness():
    inside = (X < 2) | (Z < 1)
    columns = {name: values[inside] for name, values in DATA.items()}
    start = kf.ParameterSet([kf.Map("M", np.arange(5.0), np.arange(4.0), np.ones((5, 4)))])
    trust = kf.calibrate("m = M(x, z)", columns, start, target="y").trust
    unseen = trust.samples["M"] == 0
    assert np.all(np.isinf(trust.deviation["M"][unseen]))
    assert np.all(np.isfinite(trust.deviation["M"][~unseen]))
    assert not trust.by_smoothness["M"].any()
    assert "Record samples there, set a smoothness for M or lock them" in trust.directions[0].remedy


def test_locked_and_pinned_values_have_no_deviation():
    locked = np.zeros((4, 3), dtype=bool)
    locked[0] = True
    trust = fit(locked=locked, pins=[kf.Pin("M", (3.0, 1.0), 0.2)]).trust
    assert np.argwhere(trust.deviation["M"] == 0).tolist() == [[0, 0], [0, 1], [0, 2], [3, 1]]


@pytest.mark.parametrize("count", [4, 90], ids=["rows", "normal equations"])
def test_a_fit_with_all_values_locked_has_no_deviations(count):
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 3, count), np.ones(count), locked=True)])
    trust = kf.calibrate("m = C(x)", DATA, start, target="y").trust
    assert trust.samples["C"].sum() > 0
    assert not trust.deviation["C"].any()
    assert not trust.leverage["C"].any()
    assert trust.freedom == 0
    assert trust.directions == ()
    assert not trust.covariance().any()


def test_a_failed_estimate_does_not_affect_the_rest_of_the_result(monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr("kennfeld.optimize.trust.assessment.estimate", fails)
    trust = fit().trust
    assert list(trust.informed) == ["M"]
    assert trust.deviation == {}


def test_a_fit_that_failed_has_no_trust():
    result = kf.calibrate("m = log(a) * x", {"x": [1.0, 2.0], "y": [1.0, 2.0]}, {"a": -1.0}, target="y")
    assert result.status == "failed"
    trust = result.trust
    assert trust.remark == "The search ended with status failed: the uncertainty of its values is unknown."
    assert (dict(trust.deviation), dict(trust.leverage), trust.directions) == ({}, {}, ())
    assert trust.covariance().shape == (0, 0)
    assert json.dumps(trust.as_json(), allow_nan=False)


def test_a_fit_with_a_derivative_that_is_not_finite_has_a_trust():
    result = kf.calibrate("m = sqrt(a) * x", {"x": [1.0, 2.0], "y": [-1.0, -2.0]}, {"a": 0.0}, target="y")
    trust = result.trust
    assert set(trust.informed) == {"a"}
    assert not trust.deviation or np.isfinite(trust.deviation["a"])


def test_the_text_has_the_noise_and_a_line_for_each_direction():
    trust = kf.calibrate("m = a * b * x", {"x": X, "y": X + Z}, {"a": 1.0, "b": 1.0}, target="y").trust
    noise, decided, whole, direction = str(trust).splitlines()
    assert whole == str(trust.null_space)
    assert noise.startswith("The noise of m is ")
    assert decided == "The data determine 1.0 of 2 values."
    assert direction == str(trust.directions[0])


def test_a_fit_that_was_stopped_has_its_trust():
    def stop(line):
        raise Stop

    result = fit("m = M(x, z)^3", progress=stop)
    assert result.status == "stopped"
    assert np.all(result.trust.deviation["M"] > 0)
    assert result.trust.remark.startswith(
        "The search ended with status stopped. The gradient suggests that values would still "
    )
    assert f"{result.trust.estimate.distance:.2g} standard deviations" in result.trust.remark
    assert result.trust.estimate.distance > 1
    assert result.trust.as_json()["remark"] == result.trust.remark
    assert str(result.trust).startswith(result.trust.remark)


def test_a_search_cut_off_close_to_its_end_says_how_close():
    result = fit(options=kf.Options(max_iterations=1, continuation="off"))
    assert result.status == "max_iterations"
    assert "would still move by a negligible amount" in result.trust.remark
    assert fit().trust.remark == ""


def test_a_start_that_contradicts_the_limits_has_no_trust():
    pins = [kf.Pin("M", (1.0, 1.0), 1.0), kf.Pin("M", (1.0, 1.0), 2.0)]
    result = fit(pins=pins)
    assert result.status == "infeasible"
    trust = result.trust
    assert (dict(trust.deviation), trust.directions, trust.holdings) == ({}, (), ())
    assert trust.remark == "The search ended with status infeasible: the uncertainty of its values is unknown."
    entries = trust.as_json()
    assert (entries["freedom"], entries["undetermined"], entries["by_smoothness"]) == (None, None, None)


def test_a_trust_can_be_sent_to_another_process():
    result = fit(smoothness=0.1)
    sent = pickle.loads(pickle.dumps(result)).trust
    assert sent.deviation["M"] == pytest.approx(result.trust.deviation["M"])
    assert sent.directions == () == result.trust.directions
    again = pickle.loads(pickle.dumps(result.trust))
    assert again.leverage["M"] == pytest.approx(result.trust.leverage["M"])


def test_a_table_before_a_state_counts_samples_by_its_input():
    time = np.arange(400) * 0.1
    u = np.repeat([0.5, 1.5, 0.5, 1.5], 100)
    data = kf.Dataset.of("d", {"u": u, "y": np.sin(time) + u}, time=time)
    start = kf.ParameterSet([kf.Curve("G", np.arange(5.0), np.ones(5)), kf.Curve("T", np.arange(5.0), np.ones(5))])
    trust = kf.calibrate("m = PT1(G(u), T(u))", data, start, target="y").trust
    assert trust.samples["G"].tolist() == [200, 400, 200, 0, 0]
    assert np.isinf(trust.deviation["T"]).tolist() == [False] * 0 + [True] * 5
    assert any("3, 4" in direction.sentence for direction in trust.directions)


def test_many_values_give_the_same_deviations_as_few():
    x = np.random.default_rng(3).uniform(0, 1, 2000)
    y = np.sin(9 * x) + np.random.default_rng(4).normal(0, 0.1, 2000)
    trust = [
        kf.calibrate(
            "m = C(x)",
            {"x": x, "y": y},
            kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, n), np.zeros(n))]),
            target="y",
        ).trust
        for n in (64, 65)
    ]
    assert trust[0].deviation["C"] == pytest.approx(
        np.interp(np.linspace(0, 1, 64), np.linspace(0, 1, 65), trust[1].deviation["C"]), rel=0.35
    )
    assert trust[0].freedom == pytest.approx(64)
    assert trust[1].freedom == pytest.approx(65)
