"""Segments that cannot be driven or say nothing, and criteria that are not measured in a drive."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.design import design
from kennfeld.domain.dataset import Channel
from tests.design.fits import LAG, drive, lag_fit, map_fit

NARROW, WIDE = (0.0, 0.25, 0.5), (0.0, 0.25, 0.5, 0.75, 1.0)


def with_inputs(data, u, unit=""):
    return replace(data, channels=(Channel("u", np.asarray(u, dtype=float), unit),))


def test_segments_in_which_an_input_is_missing_are_left_out():
    # the states would start anew behind the gap, which would seem to tell of the time constant
    data = drive(60, WIDE, 2)
    u = data["u"].values.copy()
    u[300:303] = np.nan
    with pytest.warns(kf.InputWarning, match="2 segments left out, as an input has no value somewhere"):
        proposal = design(lag_fit(drive(60, NARROW)), segments=3, candidates=with_inputs(data, u), length=10.0)
    assert sorted(segment.begin for segment in proposal.segments) == pytest.approx([3.0, 13.0, 43.0], abs=0.2)
    with pytest.raises(kf.InputError, match="an input has no value somewhere in each segment"):
        design(lag_fit(drive(60, NARROW)), segments=3, candidates=with_inputs(data, np.nan * u), length=10.0)


def test_segments_far_beyond_the_axes_are_a_warning():
    data = drive(60, WIDE, 2)
    with pytest.warns(kf.InputWarning, match="100 % of the samples of these segments lie beyond the axes"):
        design(lag_fit(drive(60, NARROW)), segments=1, candidates=with_inputs(data, 3 + data["u"].values), length=10.0)


def test_candidates_without_time_stamps_have_no_segments():
    with pytest.raises(kf.InputError, match="list has no time stamps, so that there are no segments"):
        design(map_fit(), segments=1, candidates=kf.Dataset.of("list", {"n": [0.1, 0.2], "l": [0.1, 0.2]}))


def test_if_nothing_may_change_there_is_nothing_to_measure():
    values = [0.0, 1.0, 3.0, 4.0, 4.5]
    start = kf.ParameterSet(
        [
            kf.Curve("C", np.linspace(0, 1, 5), values, locked=np.ones(5, dtype=bool)),
            kf.Scalar("T", 2.0, lower=2.0, upper=5.0),
        ]
    )
    # the true time constant of 1 is below the bound
    result = kf.calibrate(LAG, drive(60, NARROW), start, "m")
    with pytest.raises(kf.InputError, match="no value that may change has an effect in the operation that matters"):
        design(result, segments=1, candidates=drive(60, WIDE, 2), length=10.0)


def test_a_value_at_its_bound_counts_as_known_with_a_remark():
    start = [kf.Curve("C", np.linspace(0, 1, 5), np.full(5, 2.0)), kf.Scalar("T", 2.0, lower=1.5)]
    # the true time constant is 1
    result = kf.calibrate(LAG, drive(60, NARROW), kf.ParameterSet(start), "m", smoothness={"C": 1e-3})
    proposal = design(result, segments=1, candidates=drive(60, WIDE, 2), length=10.0)
    assert proposal.before["T"] == proposal.after["T"] == proposal.most["T"] == 0.0
    assert any("bounds hold 1 value of T, which predictions take for known" in str(each) for each in proposal.findings)


def two_criteria(points):
    """Drives in which the lagged output is measured, and points at which its steady value is."""
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 5), np.full(5, 2.0)), kf.Scalar("T", 1.5, lower=0.01)])
    criteria = [kf.Criterion("y", "m"), kf.Criterion("s", "steady")]
    text = "input u\ns = C(u)\ny = PT1(s, T)"
    return kf.calibrate(text, [drive(60, NARROW), points], start, criteria=criteria, smoothness={"C": 1e-3})


def test_a_segment_tells_only_of_what_drives_measure():
    u = np.linspace(0, 1, 30)
    steady = np.interp(u, np.linspace(0, 1, 5), [0.0, 1.0, 3.0, 4.0, 4.5])
    steady += np.random.default_rng(4).normal(0, 0.02, 30)
    settling = kf.Settling(10.0, step=0.1)
    result = two_criteria(kf.Dataset.of("bench", {"u": u, "steady": steady}, settling=settling))
    new = drive(43, WIDE, 2, name="new")
    proposal = design(result, segments=4, candidates=new, length=10.0, warmup=3.0)
    assert len(proposal.segments) == 4
    # the new drive with what the fitted function says: its values stay, and only the noise differs
    clean = kf.simulate(result.inspection.problem.model, with_inputs(new, new["u"].values), result.parameters)
    own = replace(with_inputs(new, new["u"].values), scored=np.arange(430) >= 30)
    own = replace(own, channels=(*own.channels, Channel("m", clean["y"].values)))
    problem = result.inspection.problem
    refit = kf.calibrate(
        problem.model,
        [*problem.datasets, own],
        result.parameters,
        criteria=[kf.Criterion("y", "m"), kf.Criterion("s", "steady")],
        smoothness={"C": 1e-3},
    )
    ratio = refit.trust.deviation["C"] / proposal.after["C"]
    noise = refit.trust.noise["y"] / result.trust.noise["y"]
    assert np.all((ratio > noise - 0.02) & (ratio < 1.02))


def test_candidates_of_python_are_read_in_the_unit_of_the_training_data():
    random = np.random.default_rng(0)
    n, l = random.uniform(0, 0.6, 60), random.uniform(0, 1, 60)  # noqa: E741
    data = kf.Dataset.of("bench", {"n": n, "l": l, "m": n + l + random.normal(0, 0.05, 60)}, units={"n": "s"})
    axis = np.linspace(0, 1, 4)
    result = kf.calibrate(
        "input n[s]\ninput l\ny = M(n, l)", data, kf.ParameterSet([kf.Map("M", axis, axis, np.ones((4, 4)))]), "m"
    )
    points = {"n": np.array([0.1, 0.9, 0.5]), "l": np.array([0.5, 0.9, 0.1])}
    listed = [
        design(result, n=2, candidates=kf.Dataset.of("list", points | {"n": factor * points["n"]}, units={"n": unit}))
        for factor, unit in ((1.0, "s"), (1000.0, "ms"))
    ]
    assert listed[0].points[0] == pytest.approx(listed[1].points[0])
    np.testing.assert_allclose(listed[0].after["M"], listed[1].after["M"])


def test_without_degrees_of_freedom_the_noise_is_unknown_with_an_error():
    result = kf.calibrate("input n\ny = a * n", {"n": [1.0], "m": [2.0]}, {"a": 1.0}, "m")
    with pytest.raises(kf.InputError, match="the noise of the data is unknown"):
        design(result, n=3, ranges={"n": (0, 1)})
    assert map_fit().trust.estimate is not None
