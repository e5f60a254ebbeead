"""`propose` finds planted terms at their place, and nothing where nothing is missing."""

import json
import re

import numpy as np
import pytest

import kennfeld as kf

TEXT = "trq = M(n, load)\neta = E(dev)\ndrag = D(n)\ny = trq * eta - drag"
START = kf.ParameterSet(
    [
        kf.Map("M", kf.Axis([0, 0.5, 1]), kf.Axis([0, 0.5, 1]), 50 + 30 * np.add.outer(np.arange(3), np.arange(3))),
        kf.Curve("E", [-1, 0, 1], [0.8, 1.0, 0.8]),
        kf.Curve("D", [0, 0.5, 1], [5.0, 8.0, 12.0]),
    ]
)
PINS = [kf.Pin("E", (0.0,), 1.0)]


def bench(planted="", samples=600, seed=0, noise=0.5, size=1.0):
    rng = np.random.default_rng(seed)
    data = {"n": rng.uniform(0, 1, samples), "load": rng.uniform(0, 1, samples), "dev": rng.uniform(-1, 1, samples)}
    data |= {f"c{number}": rng.normal(size=samples) for number in range(6)}
    nodes = {name: kf.simulate(TEXT, data, START)[name].values for name in ("trq", "eta", "drag")}
    nodes[planted] = nodes.get(planted, 0.0) + size * data["c2"]
    return data | {"m": nodes["trq"] * nodes["eta"] - nodes["drag"] + noise * rng.normal(size=samples)}


def proposed(data, **settings):
    return kf.propose(TEXT, data, START, "m", node="y", smoothness=0.01, pins=PINS, **settings)


def test_a_planted_term_is_found_at_its_place():
    proposals = proposed(bench("drag"))
    first = proposals[0]
    assert (proposals.status, first.term.channel) == ("found", "c2")
    assert "drag" in {first.term.node, *(place.node for place in first.equal_places)}
    assert first.rmse.after == pytest.approx(first.predicted, rel=0.03)
    assert first.held_out.after < 0.6 * first.held_out.before
    # adding to y is the same as taking from drag
    assert {"drag", "y"} <= {first.term.node, *first.as_json()["equal_places"]}
    assert "choose by physics" in first.remark


def test_a_term_inside_a_product_differs_from_a_term_behind_it():
    proposals = proposed(bench("eta", size=0.03))
    first = proposals[0]
    assert first.term.channel == "c2"
    assert not {"drag"} & {first.term.node, *(place.node for place in first.equal_places)}


def test_nothing_is_proposed_where_nothing_is_missing():
    proposals = proposed(bench())
    assert (proposals.status, list(proposals.proposals)) == ("none", [])
    assert proposals.message.startswith("Nothing is missing that these channels explain")
    assert 0 < proposals.smallest_effect < 0.25


def test_a_permuted_channel_is_not_proposed():
    data = bench("drag")
    data["c2"] = np.random.default_rng(5).permutation(data["c2"])
    assert not proposed(data).proposals


@pytest.mark.slow
def test_two_runs_give_the_same_text():
    data = bench("drag", samples=200)
    first, second = (json.dumps(proposed(data, kinds=["add"], nodes=["y"]).as_json()) for _ in range(2))
    assert first == second


def test_the_json_has_the_keys_of_its_contract():
    content = proposed(bench("drag", samples=300)).as_json()
    assert {"proposals", "smallest_effect", "status"} <= set(content)
    first = content["proposals"][0]
    keys = {"node", "kind", "channel", "text", "equal_places", "rmse", "held_out", "patch"}
    assert keys <= set(first)
    assert set(first["rmse"]) == set(first["held_out"]) == {"before", "after"}
    json.dumps(content, allow_nan=False)


def test_channels_that_cannot_take_part_are_named_with_the_reason():
    data = bench(samples=300)
    data["constant"] = np.ones(300)
    data["gaps"] = np.where(np.arange(300) % 3, np.nan, 1.0 * np.arange(300))
    data["copy"] = 3 * data["m"] + 1e-3
    proposals = proposed(data, kinds=["add"])
    excluded = proposals.excluded
    assert excluded["constant"] == "it is constant"
    assert excluded["gaps"] == "67% of its samples are missing"
    assert excluded["copy"] == "its correlation with the target m is 1.0000"
    assert excluded["m"] == "it is the target"
    lines = str(proposals).splitlines()
    assert {"Channels that take no part:", "  constant: it is constant"} <= set(lines)


def test_too_few_samples_fail_with_a_sentence():
    proposals = proposed(bench(samples=25))
    assert proposals.status == "failed"
    assert proposals.message == "25 samples are too few for 15 values: no term can be judged."


@pytest.mark.slow
def test_a_calibration_that_has_not_ended_is_fitted_first():
    data = bench("drag", samples=300)
    proposals = kf.propose("y = k * n", data, {"k": 0.0}, "m", kinds=["add"])
    assert proposals.remarks[0].startswith("The values were fitted further first: cost ")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kinds": ["curve"]}, "kinds: unknown kind 'curve'. Use add, multiply, map, lag, delay, offset."),
        ({"channels": "n"}, "channels='n' must be a list: channels=['n']"),
        ({"channels": ["c22"]}, "channels: the training data have no channel c22"),
        ({"nodes": ["drg"]}, "nodes: the function has no node drg. Did you mean drag?"),
        ({"least": -1.0}, "least must be >= 0, got -1.0"),
    ],
)
def test_wrong_arguments_are_named(settings, message):
    with pytest.raises(kf.ArgumentError, match=f"^{re.escape(message)}"):
        proposed(bench(samples=100), **settings)


def test_a_missing_lag_is_found_with_its_time_constant():
    rng = np.random.default_rng(1)
    time = 0.1 * np.arange(1500)
    u = np.repeat(rng.uniform(0, 1, 75), 20)
    clean = kf.simulate("y = PT1(3 * u, 1.5)", {"u": u, "time": time}, {})["y"].values
    data = {"u": u, "time": time, "bait": np.cumsum(rng.normal(size=1500)), "m": clean + 0.05 * rng.normal(size=1500)}
    proposals = kf.propose("y = k * u", data, {"k": 2.0}, "m")
    first = proposals[0]
    assert first.term.kind == "lag"
    assert first.term.seconds == pytest.approx(1.5, rel=0.05)
    assert first.change == f"Delay y by a PT1 of about {first.term.seconds:.3g} s"
    assert not any(proposal.term.channel == "bait" for proposal in proposals.proposals)


@pytest.mark.parametrize("steps", [7, 17])
def test_a_missing_delay_is_found_to_the_step(steps):
    rng = np.random.default_rng(1)
    u, v = np.cumsum(rng.normal(size=(2, 1500)), axis=1) / 10
    clean = 3 * np.concatenate([np.full(steps, u[0]), u[:-steps]]) + 2 * v
    data = {"u": u, "v": v, "time": 0.1 * np.arange(1500), "m": clean + 0.05 * rng.normal(size=1500)}
    proposals = kf.propose("heat = k * u\ny = heat + q * v", data, {"k": 2.0, "q": 1.0}, "m", kinds=["delay"])
    first = proposals[0]
    assert (first.term.node, first.term.steps) == ("heat", steps)
    assert first.rmse.after == pytest.approx(0.05, rel=0.1)


def days(offsets, *, correlated=False, samples=400, seed=0):
    rng = np.random.default_rng(seed)
    data = []
    for offset in offsets:
        u = np.repeat(rng.uniform(0, 1, samples // 10), 10)
        noise = rng.normal(size=samples)
        for at in range(1, samples if correlated else 0):
            noise[at] = 0.95 * noise[at - 1] + np.sqrt(1 - 0.95**2) * noise[at]
        data.append({"time": 0.1 * np.arange(samples), "u": u, "m": 3 * u + 2 + offset + 0.1 * noise})
    return data


def test_an_offset_of_each_recording_is_found():
    offsets = [0.2, -0.1, 0.0, -0.3]
    proposals = kf.propose("y = a + k * u", days(offsets), {"a": 1.0, "k": 2.0}, "m", kinds=["offset", "lag"])
    first = proposals[0]
    assert (first.change, first.held_name) == ("Add an offset of each recording to y", "blocks")
    np.testing.assert_allclose([*first.offsets.values()], np.array(offsets) - np.mean(offsets), atol=0.02)
    assert first.rmse.after == pytest.approx(0.1, rel=0.05)
    assert first.remark.startswith("Largest: training +0.25")
    json.dumps(proposals.as_json(), allow_nan=False)


def test_errors_that_are_correlated_in_time_give_no_offsets():
    for seed in range(3):
        data = days([0.0] * 4, correlated=True, seed=seed)
        assert not kf.propose("y = a + k * u", data, {"a": 1.0, "k": 2.0}, "m", kinds=["offset"]).proposals


@pytest.mark.slow
def test_an_effect_below_the_least_is_left_out():
    proposals = proposed(bench("drag", samples=300), least=2.0)
    assert not proposals.proposals
    assert "an effect of 2 would have been seen" in proposals.message


def test_a_channel_that_varies_less_than_single_precision_resolves_is_constant():
    data = bench("drag")
    data["stamp"] = 1.7e9 + 0.1 * np.arange(data["m"].size)
    assert proposed(data, channels=["stamp", "c1"], kinds=["add"]).excluded == {"stamp": "it is constant"}


def with_effect(effect, seed=0):
    """Return a bench whose drag has an effect of two further channels."""
    data = bench(seed=seed)
    return data | {"m": data["m"] - effect(data["c2"], data["c3"])}


def test_a_map_is_found_where_no_curve_explains_anything():
    proposals = proposed(with_effect(lambda x, z: x * z), kinds=["add", "map"])
    first = proposals[0]
    assert first.term.channels == ("c2", "c3")
    assert "drag" in {first.term.node, *(place.node for place in first.equal_places)}
    assert first.change == f"Add a map of c2 and c3 to {first.term.node}"
    assert first.parameter.values.shape == (6, 6)
    assert first.rmse.after == pytest.approx(first.predicted, rel=0.03)
    assert first.held_out.after < 0.75 * first.held_out.before
    assert (first.as_json()["channel"], first.as_json()["second_channel"]) == ("c2", "c3")


@pytest.mark.slow
def test_a_map_replaces_curves_of_its_channels_that_explain_less():
    proposals = proposed(with_effect(lambda x, z: 2 * np.tanh((1 + x) * (1 + z))), kinds=["add", "map"], nodes=["drag"])
    assert [proposal.term.channels for proposal in proposals.proposals] == [("c2", "c3")]
    assert "Add a curve of c2 to drag: explains what better proposals explain" in proposals.rejected


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_no_map_is_proposed_where_curves_suffice(seed):
    proposals = proposed(with_effect(lambda x, z: 3 * np.tanh(2 * x) + z**2, seed), kinds=["add", "map"], nodes=["y"])
    assert sorted(proposal.term.channels for proposal in proposals.proposals) == [("c2",), ("c3",)]


def test_a_term_that_moves_the_function_far_is_predicted_as_it_is_fitted():
    rng = np.random.default_rng(3)
    data = {name: rng.uniform(-1, 1, 500) for name in ("n", "c0", "c1", "spark")}
    optimum = 0.3 + 0.5 * data["n"] + 0.8 * data["c0"]
    data["m"] = 10 - 8 * (optimum - data["spark"]) ** 2 + 0.3 * rng.normal(size=500)
    text = "optimum = a + b * n\ny = top - q * (optimum - spark) * (optimum - spark)"
    start = {"a": 0.3, "b": 0.5, "top": 10.0, "q": 8.0}
    first = kf.propose(text, data, start, "m", kinds=["add", "multiply"])[0]
    assert (first.term.node, first.term.channel) == ("optimum", "c0")
    assert first.predicted == pytest.approx(first.rmse.after, rel=0.03)
    assert first.rmse.after < 0.4


def test_samples_that_lack_a_channel_count_neither_before_nor_after():
    rng = np.random.default_rng(0)
    x, z = rng.uniform(0, 1, (2, 600))
    m = 2 * x + 0.2 * z + 0.1 * rng.normal(size=600)
    m[100:124] += 3.0  # large errors where z is not known
    z[100:124] = np.nan
    start = {"k": 1.0, "c": 0.0}
    proposals = kf.propose("y = k * x + c", {"x": x, "z": z, "m": m}, start, "m", kinds=["add"])
    first = proposals[0]
    known = np.isfinite(z)
    fit = kf.calibrate("y = k * x + c", {"x": x[known], "m": m[known]}, start, "m")
    assert first.rmse.before == pytest.approx(fit.quality[0].rmse_after, rel=1e-6)
    assert first.held_out.before == pytest.approx(first.rmse.before, rel=0.02)
    assert proposals.remarks[-1] == "z is missing in 4.0% of the samples; all errors with it are those of the others."


def test_a_channel_that_a_recording_lacks_altogether_is_scored_without_it():
    rng = np.random.default_rng(0)
    data = [{name: rng.uniform(0, 1, 40 if part else 400) for name in "xz"} for part in range(2)]
    for own in data:
        own["m"] = 2 * own["x"] + np.sin(3 * own["z"]) + 0.1 * rng.normal(size=own["x"].size)
    data[1]["z"][:20] = np.nan
    data[1] = {name: values[:20] for name, values in data[1].items()}
    proposals = kf.propose("y = k * x + c", data, {"k": 1.0, "c": 0.0}, "m", kinds=["add"])
    assert proposals[0].term.channel == "z"
    assert proposals[0].rmse.after < 0.11
