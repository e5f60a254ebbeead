import json
from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.design import Design, design
from kennfeld.design.information import Information
from kennfeld.design.measured_kinds import measured_kinds
from kennfeld.design.open_directions import amount_of, reduced_functions, regular_curvature
from kennfeld.design.point_design import design_points
from kennfeld.design.segment_design import design_segments, reduce_recordings
from kennfeld.design.segments import RecordedSegment, cut_files, cut_segments
from tests.design.fits import MAP, drive, fitted, lag_fit, map_fit, product_fit, surface

NARROW, WIDE = (0.0, 0.25, 0.5), (0.0, 0.25, 0.5, 0.75, 1.0)


def test_segments_go_where_the_use_is_and_the_data_are_not():
    result = lag_fit(drive(60, NARROW))
    candidates = [drive(60, NARROW, 1, name="known"), drive(60, WIDE, 2, name="new")]
    proposal = design(result, segments=2, candidates=candidates, use=drive(60, WIDE, 3), length=10.0)
    assert {segment.file for segment in proposal.segments} == {"new"}
    assert all("C at" in segment.settles for segment in proposal.segments)
    assert proposal.warmup == pytest.approx(3.0, abs=0.3)
    assert all(segment.begin >= proposal.warmup - 0.1 for segment in proposal.segments)
    assert np.all(proposal.after["C"] <= proposal.before["C"] * (1 + 1e-9))
    assert proposal.after["C"][-1] < 0.1 * proposal.before["C"][-1]
    assert proposal.factor < 0.1


def test_the_use_decides_which_segments_are_worth_driving():
    result = lag_fit(drive(60, (0.25, 0.5)))
    candidates = [drive(40, (0.0, 0.1), 1, name="low"), drive(40, (0.9, 1.0), 2, name="high")]
    for use, expected in (((0.0, 0.2), "low"), ((0.8, 1.0), "high")):
        proposal = design(result, segments=1, candidates=candidates, use=drive(40, use, 3), length=10.0)
        assert proposal.segments[0].file == expected


def test_what_is_planned_needs_no_targets():
    planned = kf.Dataset.of("planned", {"u": np.linspace(0, 1, 600)}, time=0.1 * np.arange(600))
    proposal = design(lag_fit(drive(60, NARROW)), segments=1, candidates=planned, length=10.0)
    assert proposal.segments[0].file == "planned"


def test_the_information_of_a_segment_is_that_of_the_segment_driven_alone():
    from kennfeld.design.candidate_data import CandidateData
    from kennfeld.design.segments import owners

    fit, data = fitted(lag_fit(drive(60, WIDE))), drive(60, WIDE, 5)
    segments = cut_segments([data], 10.0, 5.0)
    together = CandidateData(fit, [data]).squares(fit.values, owners(segments, [data]), len(segments))
    for number, segment in enumerate(segments):
        alone = np.diagonal(CandidateData(fit, [segment.cut(data)]).curvature(fit.values))
        # what remains of a start 5 s before, with a lag of 1 s
        np.testing.assert_allclose(together[number], alone, rtol=0.05, atol=0.02 * alone.max())


def test_of_equal_recordings_all_but_one_can_go():
    drives = [drive(30, WIDE, 7, name=f"same {number}") for number in range(3)]
    proposal = design(lag_fit([*drives, drive(30, NARROW, 8, name="other")]), reduce=True, keep=2)
    assert len(proposal.drop) == 2
    assert sum(name.startswith("same") for name in proposal.drop) >= 1
    assert not {"same 0", "same 1", "same 2"} <= {*proposal.drop}


def test_recordings_that_all_differ_are_kept():
    drives = [drive(30, (level,), number, name=str(number)) for number, level in enumerate((0.05, 0.35, 0.65, 0.95))]
    assert design(lag_fit(drives), reduce=True).drop == ()


def test_points_go_to_grid_points_without_data():
    result = map_fit(upper=0.6)
    proposal = design(result, n=8, names=["M"], ranges={"n": (0, 1), "l": (0, 1)})
    assert sum(point["n"] > 0.66 for point in proposal.points) >= 4
    far = (slice(-1, None), slice(None))
    assert np.all(proposal.after["M"][far] < 0.5 * proposal.before["M"][far])


def test_the_predicted_deviation_is_that_of_the_fit_with_the_points():
    result = map_fit(count=60, upper=0.7)
    proposal = design(result, n=20, names=["M"], ranges={"n": (0, 1), "l": (0, 1)})
    random = np.random.default_rng(9)
    n, l = (np.array([point[name] for point in proposal.points]) for name in ("n", "l"))  # noqa: E741
    measured = {"n": n, "l": l, "m": surface(n, l) + random.normal(0, 0.05, n.size)}
    before = result.inspection.problem
    again = kf.calibrate(
        before.model, [*before.datasets, kf.Dataset.of("measured", measured)], before.parameters, "m", smoothness=0.01
    )
    # the noise is estimated anew
    noise = again.trust.noise["y"] / result.trust.noise["y"]
    np.testing.assert_allclose(again.trust.deviation["M"] / noise, proposal.after["M"], rtol=0.1)


def refitted_factor(result, proposal, direction):
    """The deviation along a direction after the points are measured and fitted, relative to that before."""
    fit = fitted(result)
    function = reduced_functions(fit, [amount_of(fit, result.trust.directions[direction - 1])])
    random = np.random.default_rng(3)
    n, g = (np.array([point[name] for point in proposal.points]) for name in ("n", "g"))
    m = (50 + 20 * n) * (1 - 0.4 * abs(g - 0.5)) - 10 * n - 5 + random.normal(0, 0.1, n.size)
    problem = result.inspection.problem
    again = kf.calibrate(
        problem.model,
        [*problem.datasets, kf.Dataset.of("measured", {"n": n, "g": g, "m": m})],
        result.parameters,
        "m",
        free=problem.free,
    )
    after = fitted(again)

    def deviation(own):
        variance = function[0] @ np.linalg.solve(regular_curvature(own), function[0])
        return float(np.sqrt(variance))

    return deviation(after) / deviation(fit)


@pytest.mark.parametrize("ranges", [{"n": (0, 1), "g": (0, 1)}, {"n": (0, 1), "g": (0.4, 0.6)}])
def test_the_predicted_factor_of_a_direction_is_that_of_the_refitted_one(ranges):
    result = product_fit(free=("C", "D"))
    proposal = design(result, n=20, direction=1, ranges=ranges)
    predicted = float(proposal.sentences[0].split(" leave ")[1].split()[0])
    assert predicted == pytest.approx(refitted_factor(result, proposal, 1), rel=0.05)
    assert (predicted < 0.5) == (ranges["g"] == (0, 1))


def test_a_direction_that_no_point_settles_names_what_does():
    result = product_fit()
    proposal = design(result, n=20, direction=1, ranges={"n": (0, 1), "g": (0.49, 0.51)})
    assert len(proposal.unsettled) == 1
    assert (
        "No fired point settles that: 100 points leave 0.9" in proposal.unsettled[0]
        or "leave 1.00" in proposal.unsettled[0]
    )
    assert "Measuring ideal at 20 points as well" in proposal.unsettled[0]
    assert result.trust.directions[0].remedy in proposal.unsettled[0]


def test_points_of_another_kind_are_offered():
    random = np.random.default_rng(0)
    fired = {"n": random.uniform(0, 1, 200), "m": np.zeros(200)}
    fired["m"] = 50 + 20 * fired["n"] - (10 * fired["n"] + 5) + random.normal(0, 0.1, 200)
    motored = {"n": random.uniform(0, 1, 5)}
    motored["d"] = 10 * motored["n"] + 5 + random.normal(0, 0.1, 5)
    start = kf.ParameterSet([kf.Curve(name, np.linspace(0, 1, 3), np.ones(3)) for name in ("C", "D")])
    criteria = [kf.Criterion("y", kf.Target("channel", "m")), kf.Criterion("drag", kf.Target("channel", "d"))]
    data = [kf.Dataset.of("fired", fired), kf.Dataset.of("motored", motored)]
    result = kf.calibrate("input n\ndrag = D(n)\ny = C(n) - drag", data, start, criteria=criteria)
    assert [kind.name for kind in measured_kinds(fitted(result))] == ["fired", "motored"]
    proposal = design(result, n=20, names=["D"])
    assert "20 points as in motored would leave 0." in " ".join([*proposal.sentences, *proposal.unsettled])


def test_candidates_are_checked():
    result = map_fit()
    point = {"n": [0.2, 0.2, 1.5, np.nan], "l": [0.3, 0.3, 0.5, 0.5]}
    with pytest.warns(kf.InputWarning) as warned:
        proposal = design(result, n=5, candidates=kf.Dataset.of("list", point))
    texts = [str(each.message) for each in warned] + [str(finding) for finding in proposal.findings]
    for expected in (
        "1 candidate left out, as values are missing",
        "1 duplicate",
        "beyond the axes",
        "fewer than the 5",
    ):
        assert any(expected in text for text in texts), expected
    assert len(proposal.points) == 2
    with pytest.raises(kf.InputError, match="has no channel l"):
        design(result, n=5, candidates=kf.Dataset.of("list", {"n": [0.1]}))


def test_segments_that_cannot_be_cut_are_an_error_or_a_warning():
    result = lag_fit(drive(60, NARROW))
    with pytest.raises(kf.InputError, match="no recording is as long as a segment of 600 s"):
        design(result, segments=2, candidates=drive(60, WIDE), length=600.0)
    with pytest.raises(kf.InputError, match="segments of 1e-09 s are shorter than the step of"):
        design(result, segments=2, candidates=drive(60, WIDE), length=1e-9)
    with pytest.raises(kf.InputError, match="there is nothing to choose segments from"):
        design(result, segments=2)
    with pytest.warns(kf.InputWarning, match="shorter than their warm-up"):
        design(result, segments=1, candidates=drive(60, WIDE), length=1.0)
    with pytest.warns(kf.InputWarning, match="fewer than the 30 asked for"):
        proposal = design(result, segments=30, candidates=drive(60, WIDE), length=20.0)
    assert len(proposal.segments) == 2


def test_a_function_that_misses_a_term_is_a_warning_that_names_propose():
    random = np.random.default_rng(0)
    data = {"n": random.uniform(0, 1, 400), "throttle": random.uniform(0, 1, 400)}
    data["m"] = 2 * data["n"] + data["throttle"] ** 2 + random.normal(0, 0.05, 400)
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 4), np.zeros(4))])
    with pytest.warns(kf.InputWarning, match=r"% of the variance of the errors of y follow throttle.*kennfeld propose"):
        design(kf.calibrate("input n\ny = C(n)", kf.Dataset.of("bench", data), start, "m"), n=3)


def test_a_fit_that_did_not_converge_is_a_warning():
    random = np.random.default_rng(0)
    data = {"n": random.uniform(0, 1, 50), "l": random.uniform(0, 1, 50)}
    data["m"] = surface(data["n"], data["l"]) + random.normal(0, 0.05, 50)
    axis = np.linspace(0, 1, 4)
    start = kf.ParameterSet([kf.Map("M", axis, axis, np.zeros((4, 4)))])
    result = kf.calibrate(
        "input n\ninput l\ny = M(n, l) * M(l, n)", data, start, "m", options=kf.Options(max_iterations=1)
    )
    assert not result.converged
    with pytest.warns(kf.InputWarning, match="the fit did not converge"):
        design(result, n=3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"n": 3, "segments": 2}, "exclude each other"),
        ({"keep": 2}, "keep requires reduce"),
        ({"n": 0}, "must be an integer >= 1, got 0"),
        ({"n": 3, "names": ["M"], "direction": 1}, "for named parameters or for a direction"),
        ({"segments": 3}, "requires a fit"),
        ({"n": 3}, "no channel has a range"),
        ({"n": 2.5}, "n: must be an integer >= 1, got 2.5"),
        ({"n": 3, "ranges": {"x": (0, 1)}, "method": "latin"}, "method: unknown value 'latin'"),
        ({"ranges": {"x": (0, 1)}, "manoeuvres": [{"kind": "zap", "duration": 5}]}, "kind: unknown value 'zap'"),
        ({"n": 3, "ranges": {"x": (0, 1)}, "slew": {"x": 0}}, "x: must be > 0, got 0"),
        (
            {
                "n": 3,
                "ranges": {"x": (0, 1), "z": (0, 1)},
                "curves": [{"channel": "z", "over": "x", "at": [1, 0], "limits": [0, 1]}],
            },
            "the values of x must rise",
        ),
    ],
)
def test_requests_that_make_no_sense_are_errors(words, message):
    with pytest.raises(kf.InputError, match=message):
        design(**words)


def test_unknown_names_are_errors_with_the_nearest():
    with pytest.raises(kf.ArgumentError, match=r"unknown setting rangs.*Did you mean ranges"):
        design(n=3, rangs={})
    with pytest.raises(kf.InputError, match="no free value of a parameter named N"):
        design(map_fit(), n=3, names=["N"])
    with pytest.raises(kf.InputError, match="there is no direction 99"):
        design(map_fit(), n=3, direction=99)
    with pytest.raises(kf.InputError, match="unknown channel load"):
        design(n=3, ranges={"speed": (0, 1)}, where=["load < 2"], slew={"load": 1.0})


def test_a_design_is_the_same_for_any_number_of_threads(monkeypatch):
    result = lag_fit(drive(60, NARROW))
    proposal = []
    for cores in (1, 4):
        monkeypatch.setattr("kennfeld.native.accumulator.available_cores", lambda cores=cores: cores)
        proposal.append(design(result, segments=3, candidates=drive(120, WIDE, 2), length=10.0))
    assert proposal[0].segments == proposal[1].segments
    assert proposal[0].factor == proposal[1].factor


@pytest.mark.parametrize("ending", [".csv", ".xlsx", ".parquet", ".mf4"])
def test_written_manoeuvres_are_read_as_they_were_planned(ending, tmp_path):
    plans = [{"kind": "aprbs", "duration": 30.0}]
    proposal = design(ranges={"speed": (800, 6000), "load": (10, 100)}, slew={"speed": 500.0}, manoeuvres=plans)
    path = proposal.save(tmp_path / f"plan{ending}")
    data = kf.read(path, channels=["speed", "load"])
    np.testing.assert_allclose(data.time, proposal.tables[0].time, rtol=0, atol=1e-9)
    for name in ("speed", "load"):
        np.testing.assert_allclose(data[name].values, proposal.tables[0].columns[name], rtol=1e-12)


def test_a_written_list_has_points_blocks_and_times(tmp_path):
    proposal = design(n=6, ranges={"speed": (800, 6000)}, slew={"speed": 100.0}, wait=20.0, repeat=3, blocks=2)
    lines = proposal.save(tmp_path / "points.csv").read_text("utf-8").splitlines()
    assert lines[0].replace('"', "") == "number,block,kind,ramp,wait,speed"
    assert len(lines) == 1 + len(proposal.points) == 1 + 6 + 3
    content = json.loads(proposal.save(tmp_path / "points.json").read_text("utf-8"))
    assert content["points"] == [dict(point) for point in proposal.points]
    assert {"points", "segments", "drop", "deviation", "unsettled"} <= content.keys()


def test_a_file_that_cannot_hold_a_design_is_an_error(tmp_path):
    proposal = design(lag_fit(drive(60, NARROW)), segments=1, candidates=drive(60, WIDE), length=10.0)
    with pytest.raises(kf.InputError, match=r"no time, which \.mf4 requires"):
        proposal.save(tmp_path / "list.mf4")
    with pytest.raises(kf.InputError, match=r"must have the extension .*, got \.txt"):
        proposal.save(tmp_path / "list.txt")


def measured(points, noise=0.05):
    n, l = (np.array([point[name] for point in points]) for name in ("n", "l"))  # noqa: E741
    values = surface(n, l) + np.random.default_rng(9).normal(0, noise, n.size)
    return kf.Dataset.of("measured", {"n": n, "l": l, "m": values})


def test_after_measuring_the_deviations_are_compared_with_those_predicted(tmp_path):
    result = map_fit(count=60, upper=0.7)
    proposal = design(result, n=20, names=["M"], ranges={"n": (0, 1), "l": (0, 1)})
    saved = Design.read(proposal.save(tmp_path / "next.json"))
    for name in ("before", "after"):
        np.testing.assert_array_equal(getattr(saved, name)["M"], getattr(proposal, name)["M"])
    assert (saved.points, saved.noise) == (tuple(map(dict, proposal.points)), dict(result.trust.noise))
    problem = result.inspection.problem
    rest = {"start": problem.parameters, "target": "m", "smoothness": 0.01}
    again = kf.calibrate(MAP, [*problem.datasets, measured(proposal.points)], **rest)
    reached = saved.compare(again)
    (row,) = reached.rows
    assert (row.parameter, row.values) == ("M", 16)
    assert row.before > 1.5 * row.predicted
    assert row.reached == pytest.approx(row.predicted, rel=0.2)
    np.testing.assert_array_equal(reached.reached["M"], again.trust.deviation["M"])
    assert not reached.findings
    assert " 16 values are determined as well as predicted, to 10 %." in str(reached)
    # the same place again and again, with four times the noise, is not what the design asked for
    elsewhere = kf.calibrate(MAP, [*problem.datasets, measured([{"n": 0.1, "l": 0.1}] * 20, 0.2)], **rest)
    missed = saved.compare(elsewhere)
    assert missed.rows[0].missed > 8
    assert missed.missed[0].startswith("M at (n 1, l ")
    assert missed.noise["y"] > 1.5
    assert f"The noise of y is {missed.noise['y']:.2f} times that of the prediction" in str(missed)
    assert json.dumps(missed.as_json(), allow_nan=False)


def test_what_cannot_be_compared_is_an_error_and_a_fit_without_the_new_data_a_warning(tmp_path):
    result = map_fit()
    saved = design(result, n=5, names=["M"], ranges={"n": (0, 1), "l": (0, 1)})
    (warning,) = saved.compare(result).findings
    assert "the deviations are those before the design. Add the measured data to the training data." in str(warning)
    smaller = replace(saved, after={"M": saved.after["M"][:3]})
    with pytest.raises(InputError, match=r"M: has the shape \[4, 4\], but \[3, 4\] in the design"):
        smaller.compare(result)
    with pytest.raises(InputError, match="the design predicts no deviation"):
        design(n=4, ranges={"n": (0, 1)}).compare(result)
    for text in ("{", "[]", '{"points": 3}', '{"points": [], "segments": [{"a": 1}]}'):
        (tmp_path / "other.json").write_text(text, "utf-8")
        with pytest.raises(InputError, match=r"other\.json: is not a design"):
            Design.read(tmp_path / "other.json")
    with pytest.raises(InputError, match="cannot be read"):
        Design.read(tmp_path / "missing.json")


def test_a_sample_of_the_use_counts_by_its_weight_as_if_it_occurred_so_often():
    fit = fitted(map_fit(count=60, upper=0.7))
    n, l, times = np.array([0.1, 0.5, 0.9]), np.array([0.2, 0.4, 0.6]), np.array([3, 0, 1])  # noqa: E741
    weighted = kf.Dataset.of("w", {"n": n, "l": l, "hours": times}, weight_channel="hours")
    repeated = kf.Dataset.of("r", {"n": n.repeat(times), "l": l.repeat(times)})
    candidates = [kf.Dataset.of("c", {"n": [0.3, 0.8], "l": [0.3, 0.8]})]
    one, other = (Information.of(fit, candidates, [np.arange(2)], 2, [use]) for use in (weighted, repeated))
    np.testing.assert_allclose(one.use, other.use, rtol=1e-12)
    np.testing.assert_array_equal(one.candidates, other.candidates)


def test_a_map_of_weights_is_the_use():
    result = map_fit(count=60, upper=0.7, smoothness=1e-4)
    axes = kf.Axis([0.0, 0.5, 1.0], input="n"), kf.Axis([0.0, 1.0], input="l")
    where = {}
    for corner in ([[0, 0], [0, 0], [5, 0]], [[0, 0], [0, 0], [0, 5]]):
        proposal = design(result, n=4, use=kf.Map("hours", *axes, corner), ranges={"n": (0, 1), "l": (0, 1)})
        where[corner[2][0]] = np.mean([point["l"] for point in proposal.points])
    assert where[5] < 0.3
    assert where[0] > 0.7
    for weights, message in (
        (kf.Map("hours", [0, 1], [0, 1], np.ones((2, 2))), "each axis of the weights hours requires a channel"),
        (kf.Map("hours", *axes, -np.ones((3, 2))), "the weights hours must be finite and >= 0"),
    ):
        with pytest.raises(kf.ArgumentError, match=message):
            design(result, n=4, use=weights)


def test_a_stopped_design_has_the_segments_so_far_and_says_so():
    fit, candidates = fitted(lag_fit(drive(60, NARROW))), [drive(60, WIDE, 2, name="new")]
    designs = []

    def watch(design_so_far):
        designs.append(design_so_far())
        return len(designs) == 2

    proposal = design_segments(fit, candidates, candidates, 4, 10.0, None, watch=watch)
    assert [len(each.segments) for each in designs] == [1, 2]
    assert proposal.segments == designs[-1].segments
    assert str(proposal.findings[-1]) == "design: stopped: 2 of 4 segments were chosen"
    assert not design_segments(fit, candidates, candidates, 2, 10.0, None).findings


def test_recordings_that_were_dropped_before_a_stop_stay_dropped():
    drives = [drive(30, WIDE, 7, name=f"same {number}") for number in range(4)]
    fit = fitted(lag_fit(drives))
    proposal = reduce_recordings(fit, drives, drives, 1, watch=lambda designs: True)
    assert len(proposal.drop) == 1
    assert str(proposal.findings[0]) == "design: stopped: 1 of 3 recordings were chosen"


@pytest.mark.parametrize("names", [(), ("*",)], ids=["use", "names"])
def test_a_stopped_choice_of_points_has_those_so_far_and_says_so(names):
    fit = fitted(map_fit())
    columns = {name: np.random.default_rng(0).uniform(0, 1, 50) for name in ("n", "l")}
    designs = []

    def watch(design_so_far):
        designs.append(design_so_far())
        return len(designs) == 2

    proposal, chosen = design_points(fit, columns, 5, fit.problem.datasets, names=names, watch=watch)
    assert [own.size for _, own in designs] == [1, 2]
    assert set(chosen) == set(designs[-1][1])
    assert proposal.stopped == designs[-1][0].stopped == (2, 5)
    assert "stopped: 2 of 5 points were chosen" in str(proposal.findings[-1])
    np.testing.assert_array_equal(proposal.after["M"], designs[-1][0].after["M"])


def test_a_choice_ends_after_max_seconds_with_what_was_chosen():
    result = map_fit()
    ranges = {"n": (0, 1), "l": (0, 1)}
    with pytest.warns(kf.InputWarning, match="stopped: 1 of 6 points were chosen"):
        proposal = design(result, n=6, ranges=ranges, max_seconds=1e-9)
    assert len(proposal.points) == 1
    with pytest.raises(kf.InputError, match="max_seconds"):
        design(result, n=6, ranges=ranges, max_seconds=0)


def test_recordings_of_one_name_get_numbers():
    drives = [drive(30, NARROW, 1), drive(30, WIDE, 2), drive(30, NARROW, 1)]
    assert [each.file for each in cut_files(drives)] == ["drive (1)", "drive (2)", "drive (3)"]
    segments = cut_segments([*drives[:2], drive(30, WIDE, 3, name="other")], 15.0, 0.0)
    assert [each.file for each in segments] == ["drive (1)"] * 2 + ["drive (2)"] * 2 + ["other"] * 2


def two_nodes(n, l, random):  # noqa: E741
    y = 2 + np.sin(3 * n) + l
    noise = random.normal(0, 1, (2, n.size))
    return {"n": n, "l": l, "my": y + 0.1 * noise[0], "mz": y * (1 + n) + 0.5 * noise[1]}


def fit_two_nodes(data):
    axis = np.linspace(0, 1, 4)
    start = [kf.Map("M", kf.Axis(axis, "n"), kf.Axis(axis, "l"), np.full((4, 4), 2.0)), kf.Curve("K", axis, np.ones(4))]
    criteria = [kf.Criterion("y", "my"), kf.Criterion("z", "mz")]
    text = "y = M(n, l)\nz = y * K(n)"
    return kf.calibrate(text, data, kf.ParameterSet(start), criteria=criteria, smoothness=1e-3)


@pytest.mark.parametrize("weight", [1.0, 4.0])
def test_deviations_are_those_of_a_refit_if_criteria_differ_in_noise_and_data_have_a_weight(weight):
    random = np.random.default_rng(0)
    known = two_nodes(random.uniform(0, 0.6, 400), random.uniform(0, 1, 400), random)
    bench = kf.Dataset.of("bench", known, weight=weight)
    proposal = design(fit_two_nodes(bench), n=40, ranges={"n": (0, 1), "l": (0, 1)})
    n, l = (np.array([point[name] for point in proposal.points]) for name in "nl")  # noqa: E741
    refit = fit_two_nodes([bench, kf.Dataset.of("new", two_nodes(n, l, random), weight=weight)])
    np.testing.assert_allclose(proposal.after["M"], refit.trust.deviation["M"], rtol=0.1)
    # a deviation of a factor also depends on the values themselves, which differ between the fits
    np.testing.assert_allclose(proposal.after["K"][:3], refit.trust.deviation["K"][:3], rtol=0.1)
    assert np.nanmax(proposal.before["M"] / proposal.after["M"]) > 1.2


def test_recordings_are_dropped_by_their_weight_and_by_the_targets_that_they_have():
    random = np.random.default_rng(0)
    parts = [two_nodes(random.uniform(0, 1, 60), random.uniform(0, 1, 60), random) for _ in range(4)]
    for part in parts[:2]:
        part["mz"] = np.full(60, np.nan)  # says nothing of K
    weights = (1.0, 1.0, 1.0, 1e-3)
    recordings = [
        kf.Dataset.of(f"part {number}", part, weight=weight)
        for number, (part, weight) in enumerate(zip(parts, weights, strict=True))
    ]
    proposal = design(fit_two_nodes(recordings), reduce=True, keep=2)
    assert proposal.drop[0] == "part 3"
    assert set(proposal.drop) <= {"part 3", "part 0", "part 1"}
    kept = [recording for recording in recordings if recording.name not in proposal.drop]
    refit = fit_two_nodes(kept)
    np.testing.assert_allclose(proposal.after["K"], refit.trust.deviation["K"], rtol=0.03)


def test_a_recording_that_is_cut_out_keeps_its_pieces_and_its_weight():
    data = kf.Dataset.of(
        "d", {"u": np.arange(10.0)}, time=[0, 1, 2, 3, 0, 1, 2, 3, 4, 5], piece_starts=[0, 4], weight=3.0
    )
    whole = RecordedSegment(0, "d", 0, 0, 10, 0.0, 5.0).cut(data)
    assert (whole.piece_starts.tolist(), whole.weight) == ([0, 4], 3.0)
    part = RecordedSegment(0, "d", 5, 7, 10, 3.0, 5.0).cut(data)
    assert (part.piece_starts.tolist(), part.counting.tolist()) == ([0], [False, False, True, True, True])
