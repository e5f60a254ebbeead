import json

import numpy as np
import pytest

import kennfeld as kf
from kennfeld import cli
from tests.design.fits import drive, surface

STEADY = """
[model]
file = "map.kf"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "y"
target = { channel = "m" }
[parameters.M]
x = { input = "n", breakpoints = [0, 0.33, 0.67, 1] }
y = { input = "l", breakpoints = [0, 0.5, 1] }
initial = 0
smoothness = 0.01
[design]
"""
LAG = """
[model]
file = "lag.kf"
[[dataset]]
files = ["drive_*.csv"]
[[criterion]]
node = "y"
target = { channel = "m" }
[parameters.C]
x = { input = "u", breakpoints = [0, 0.25, 0.5, 0.75, 1] }
initial = 0
smoothness = 1e-3
[parameters.T]
initial = 2
bounds = [0.01, 100]
"""


def write_csv(path, columns):
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]), "utf-8")


@pytest.fixture
def steady(tmp_path):
    (tmp_path / "map.kf").write_text("input n\ninput l\ny = M(n, l)\n", "utf-8")
    random = np.random.default_rng(0)
    n, l = random.uniform(0, 0.6, 40), random.uniform(0, 1, 40)  # noqa: E741
    write_csv(tmp_path / "bench.csv", {"n": n, "l": l, "m": surface(n, l) + random.normal(0, 0.05, 40)})
    (tmp_path / "kennfeld.toml").write_text(STEADY, "utf-8")
    return tmp_path / "kennfeld.toml"


@pytest.fixture
def lagging(tmp_path):
    (tmp_path / "lag.kf").write_text("input u\ny = PT1(C(u), T)\n", "utf-8")
    for number, levels in enumerate(((0.0, 0.25), (0.0, 0.25), (0.25, 0.5))):
        write_recording(tmp_path / f"drive_{number}.csv", drive(30, levels, number))
    write_recording(tmp_path / "old.csv", drive(60, (0.0, 0.5, 0.75, 1.0), 9))
    (tmp_path / "kennfeld.toml").write_text(LAG, "utf-8")
    return tmp_path / "kennfeld.toml"


def write_recording(path, data, names=("u", "m")):
    write_csv(path, {"time": data.time, **{name: data[name].values for name in names}})


def as_json(capsys, *arguments):
    assert cli.run(["design", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def append(path, text):
    path.write_text(path.read_text("utf-8") + text, "utf-8")


def test_points_are_designed_within_the_limits_of_the_project(steady, capsys):
    append(steady, 'ranges = { n = [0, 1], l = [0, 1] }\nwhere = ["n + l < 1.5"]\nslew = { n = 0.1 }\nwait = 5\n')
    proposal = as_json(capsys, steady, "-n", 6, "--for", "M")
    assert len(proposal["points"]) == 6
    assert all(point["n"] + point["l"] < 1.5 for point in proposal["points"])
    assert proposal["deviation"]["after"]["M"][2][1] < proposal["deviation"]["before"]["M"][2][1]
    assert any("s of waiting" in sentence for sentence in proposal["sentences"])


def test_recordings_shorter_than_a_segment_are_an_error(lagging, capsys):
    assert cli.run(["design", str(lagging), "--segments", "2", "--from", str(lagging.parent / "old.csv")]) == 2
    assert "no recording is as long as a segment of 60 s with its warm-up of" in capsys.readouterr().err


def test_segments_have_file_and_times(lagging, capsys):
    folder = lagging.parent
    append(lagging, "[design]\nlength = 10\n")
    proposal = as_json(capsys, lagging, "--segments", 2, "--from", folder / "ol*.csv", "-o", folder / "next.csv")
    assert [segment["file"] for segment in proposal["segments"]] == [str(folder / "old.csv")] * 2
    assert all(segment["end"] - segment["begin"] == pytest.approx(9.9, abs=0.11) for segment in proposal["segments"])
    assert len((folder / "next.csv").read_text("utf-8").splitlines()) == 3


def test_planned_manoeuvres_are_candidates(lagging, capsys):
    append(
        lagging,
        "[design]\nlength = 10\nranges = { u = [0, 1] }\n"
        'manoeuvres = [{ kind = "steps", duration = 60, name = "plan" }]\n',
    )
    proposal = as_json(capsys, lagging, "--segments", 1)
    assert proposal["segments"][0]["file"] == "plan"
    planned = as_json(capsys, lagging, "-o", lagging.parent / "plan.csv")
    assert planned["sentences"] == ["plan: 60 s, 601 samples."]
    assert kf.read(lagging.parent / "plan.csv").samples == 601


def test_recordings_that_add_nothing_are_named(lagging, capsys):
    proposal = as_json(capsys, lagging, "--reduce", "--keep", 2)
    assert [name.rpartition("_")[2] for name in proposal["drop"]] in (["0.csv"], ["1.csv"])


def test_the_use_of_a_cycle_changes_the_choice(lagging, capsys):
    append(lagging, "[design]\nlength = 10\n")
    folder = lagging.parent
    write_recording(folder / "low.csv", drive(40, (0.0, 0.1), 20), ("u",))
    write_recording(folder / "high.csv", drive(40, (0.9, 1.0), 21), ("u",))
    for name in ("low", "high"):
        words = ["--segments", 1, "--from", folder / "low.csv", "--from", folder / "high.csv"]
        proposal = as_json(capsys, lagging, *words, "--use", folder / f"{name}.csv")
        assert proposal["segments"][0]["file"] == str(folder / f"{name}.csv")


def test_without_recordings_points_fill_the_ranges(steady, capsys):
    (steady.parent / "bench.csv").unlink()
    append(steady, "ranges = { n = [0, 1], l = [0, 2] }\n")
    assert cli.run(["design", str(steady), "-n", "8"]) == 0
    text = capsys.readouterr()
    assert "there are no recordings: the points fill the ranges" in text.err
    assert len(text.out.splitlines()) >= 9


@pytest.mark.parametrize("method", ["lhs", "factorial", "d-optimal", "i-optimal"])
def test_other_methods_need_no_fit(steady, capsys, method):
    append(steady, f'ranges = {{ n = [0, 1], l = [0, 2] }}\nmethod = "{method}"\n')
    assert len(as_json(capsys, steady, "-n", 9)["points"]) == 9


def test_a_project_in_python_takes_the_same_words(steady):
    project = kf.Project.read(steady)
    proposal = project.design(n=4, names=["M"], ranges={"n": (0, 1), "l": (0, 1)})
    assert len(proposal.points) == 4
    assert "4 points of bench leave" in str(proposal)


@pytest.mark.parametrize(
    ("text", "arguments", "messages"),
    [
        ("ranges = { n = [1, 0] }", [], ["must be two numbers, the lower one first, got [1, 0]"]),
        ('hard = ["x"]\nwhere = ["q > 1"]', ["-n", "3"], ["unknown channel x", "unknown channel q"]),
        ('curves = [{ channel = "l", over = "n", at = [0, 0], limits = [1] }]', [], ["must rise", "1 limits for 2"]),
        ("", ["--from", "missing.csv"], ["missing.csv matches no file"]),
        ("", ["-n", "3", "--reduce"], ["exclude each other"]),
        ("", ["--direction", "7"], ["there is no direction 7"]),
        ("", ["-o", "points.txt"], ["must have the extension"]),
    ],
)
def test_bad_input_is_reported_with_all_problems(steady, capsys, text, arguments, messages):
    append(steady, text)
    assert cli.run(["design", str(steady), *arguments]) == 2
    error = capsys.readouterr().err
    for message in messages:
        assert message in error


def test_the_command_is_named_where_the_data_leave_something_open(steady, capsys):
    text = steady.read_text("utf-8").replace("smoothness = 0.01\n", "")
    steady.write_text(text, "utf-8")
    assert cli.run(["calibrate", str(steady)]) == 0
    out = capsys.readouterr().out
    assert "What would settle the first of them, if anything: kennfeld design " in out
    assert "kennfeld design PROJECT --direction 1" in (steady.parent / "results" / "report.html").read_text("utf-8")


def test_after_measuring_a_command_compares_with_the_prediction(steady, capsys):
    append(steady, "ranges = { n = [0, 1], l = [0, 1] }\n")
    proposal = as_json(capsys, steady, "-n", 12, "--for", "M", "-o", steady.parent / "next.json")
    n, l = (np.array([point[name] for point in proposal["points"]]) for name in ("n", "l"))  # noqa: E741
    write_csv(steady.parent / "bench_2.csv", {"n": n, "l": l, "m": surface(n, l)})
    steady.write_text(steady.read_text("utf-8").replace('"bench.csv"', '"bench*.csv"'), "utf-8")
    reached = as_json(capsys, steady, "--compare", steady.parent / "next.json")
    (row,) = reached["parameters"]
    assert row["reached"] < 0.7 * row["before"]
    assert cli.run(["design", str(steady), "--compare", str(steady.parent / "next.json")]) == 0
    assert "parameter  values  before" in capsys.readouterr().out
    assert cli.run(["design", str(steady), "--compare", "next.json", "-n", "3"]) == 2
    assert "--compare: cannot be combined with a new design" in capsys.readouterr().err


def test_points_of_the_use_are_weighted_by_a_channel(steady, capsys):
    append(steady, 'ranges = { n = [0, 1], l = [0, 1] }\nuse = ["use.csv"]\nuse_weight = "hours"\n')
    means = []
    for hours in ((9, 0), (0, 9)):
        write_csv(steady.parent / "use.csv", {"n": [1.0, 1.0], "l": [0.0, 1.0], "hours": hours})
        points = as_json(capsys, steady, "-n", 4)["points"]
        means.append(np.mean([point["l"] for point in points]))
    assert means[0] < means[1] - 0.3


def test_the_offset_of_a_recording_to_come_is_not_known(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    random, drives = np.random.default_rng(0), {}
    for day in (1, 2, 3):
        x = random.uniform(0, 1, 40)
        drives[day] = {"time": np.arange(40.0), "x": x, "m": 2 * x + day + random.normal(0, 0.1, 40)}
        write_csv(tmp_path / f"day_{day}.csv", drives[day])
    (tmp_path / "line.kf").write_text("input x\nscalar Gain\nscalar Offset\ny = Gain * x + Offset\n", "utf-8")
    (tmp_path / "kennfeld.toml").write_text(
        """
[model]
file = "line.kf"
[[dataset]]
files = ["day_1.csv", "day_2.csv"]
[[criterion]]
node = "y"
target = { channel = "m" }
[parameters.Gain]
initial = 1.0
[parameters.Offset]
per = "recording"
initial = 0.0
""",
        "utf-8",
    )
    project = kf.Project.read(tmp_path / "kennfeld.toml")
    proposal = project.design(segments=1, candidates=["day_3.csv"], length=20.0)
    (segment,) = proposal.segments
    chosen = slice(round(segment.begin), round(segment.end) + 1)
    parts = [drives[1]["x"], drives[2]["x"], drives[3]["x"][chosen]]
    days = np.repeat(np.arange(3), [part.size for part in parts])
    rows = np.column_stack([np.concatenate(parts), days[:, None] == np.arange(3)])
    fit = project.calibrate()
    deviation = fit.trust.noise["y"] * np.sqrt(np.diagonal(np.linalg.inv(rows.T @ rows)))
    assert float(proposal.after["Gain"]) == pytest.approx(deviation[0], rel=1e-6)
    np.testing.assert_allclose(proposal.after["Offset"], deviation[1:], rtol=1e-6)
    assert proposal.before["Offset"][2] == np.inf
    # the offset of another day is one more, with which there is nothing to compare
    reached = proposal.compare(fit)
    assert [row.parameter for row in reached.rows] == ["Gain"]
    assert any("Offset: has the shape [2], but [3] in the design" in str(each) for each in reached.findings)
