"""Missing terms of a project: found among all channels of its recordings, written into its files, taken back."""

import json

import numpy as np
import pytest

from kennfeld import InputError, Project, cli
from kennfeld.project.missing_terms import _with_more_channels, undo
from tests.project.partitioned_projects import in_partitions

TEXT = (
    "# two branches\n1 base[Nm] = MapBase(speed, load)\n2 drag[Nm] = CurveDrag(speed)  # motored\ny[Nm] = base - drag\n"
)
TOML = """# a bench
[model]
file = "f.kf"

[[dataset]]
name = "bench"
files = ["run_*.csv"]
{more}
[[criterion]]
node = "y"
target = {{ channel = "m" }}

[parameters.MapBase]
x = {{ input = "speed", breakpoints = [0, 0.5, 1] }}
y = {{ input = "load", breakpoints = [0, 0.5, 1] }}
initial = 1.0

[parameters.CurveDrag]
x = {{ input = "speed", breakpoints = [0, 0.5, 1] }}
initial = 0.5
lock = true
"""


def write_bench(folder, planted="drag", more="", timed=False, files=3, samples=150):
    rng = np.random.default_rng(4)
    for number in range(files):
        data = {name: rng.uniform(0, 1, samples) for name in ("speed", "load", "oil", "humidity")}
        y = 2 + data["speed"] + data["load"] - 0.5 + 0.02 * rng.normal(size=samples)
        y -= 0.3 * data["oil"] ** 2 if planted else 0.0
        columns = ({"time": 0.1 * np.arange(samples)} if timed else {}) | data | {"m": y, "flat": np.ones(samples)}
        rows = zip(*(column.round(5).tolist() for column in columns.values()), strict=True)
        lines = [",".join([*columns, "note"]), *(",".join([*map(str, row), "ok"]) for row in rows)]
        (folder / f"run_{number}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "f.kf").write_text(TEXT, encoding="utf-8")
    path = folder / "kennfeld.toml"
    path.write_text(TOML.format(more=more), encoding="utf-8")
    return path


def plant_map(folder, files=3):
    """Let speed and oil act together on what the recordings measure, so that no curve explains it."""
    for number in range(files):
        file = folder / f"run_{number}.csv"
        head, *rows = [row.split(",") for row in file.read_text(encoding="utf-8").splitlines()]
        speed, oil, m = (head.index(name) for name in ("speed", "oil", "m"))
        for row in rows:
            row[m] = f"{float(row[m]) - (float(row[speed]) - 0.5) * (float(row[oil]) - 0.5):.5f}"
        file.write_text("\n".join(map(",".join, [head, *rows])) + "\n", encoding="utf-8")


def test_a_channel_that_the_project_does_not_read_is_proposed(tmp_path):
    path = write_bench(tmp_path)
    proposals = Project.read(path).propose(kinds=["add"])
    first = proposals[0]
    assert (first.term.channel, first.held_name) == ("oil", "files")
    assert first.location
    assert proposals.excluded == {"m": "it is the target", "flat": "it is constant"}
    assert proposals.remarks[0] == "Calibrated first, as the results folder has no values of this function."
    assert "+[parameters.Add" in first.patch


def test_a_proposal_is_written_into_both_files_and_taken_back(tmp_path):
    path = write_bench(tmp_path)
    project = Project.read(path)
    before = [(tmp_path / name).read_bytes() for name in ("f.kf", "kennfeld.toml")]
    proposal = project.propose(kinds=["add"], nodes=["drag"], channels=["oil"])[0]
    assert project.apply(proposal) == (tmp_path / "f.kf", path)
    text = (tmp_path / "f.kf").read_text(encoding="utf-8")
    assert "2 drag[Nm] = CurveDrag(speed) + AddDragOil(oil)  # motored\n" in text
    changed = Project.read(path)
    result = changed.calibrate()
    rmse = [row.rmse_after for row in result.quality]
    assert rmse[0] == pytest.approx(proposal.rmse.after, rel=1e-3)
    assert undo(changed) == (proposal.change, (tmp_path / "f.kf", path))
    assert [(tmp_path / name).read_bytes() for name in ("f.kf", "kennfeld.toml")] == before


def test_a_map_is_written_with_both_axes_and_without_what_the_function_has_already(tmp_path):
    path = write_bench(tmp_path, planted="")
    plant_map(tmp_path)
    project = Project.read(path)
    proposal = project.propose(kinds=["map"], nodes=["drag"], channels=["speed", "oil"])[0]
    assert proposal.change == "Add a map of speed and oil to drag"
    project.apply(proposal)
    text = (tmp_path / "f.kf").read_text(encoding="utf-8")
    assert "drag[Nm] = CurveDrag(speed) + AddDragSpeedOil(speed, oil)  # motored" in text
    table = path.read_text(encoding="utf-8").split("[parameters.AddDragSpeedOil]")[1]
    x, y = proposal.term.breakpoints[3], proposal.term.second_breakpoints[3]
    # the map of the base can take over a constant
    assert f"lock = [{{ x = [{x}, {x}], y = [{y}, {y}] }}]" in table
    result = Project.read(path).calibrate()
    assert result.quality[0].rmse_after == pytest.approx(proposal.rmse.after, rel=1e-3)
    assert result.quality[0].rmse_after < 0.03


def test_an_offset_of_each_recording_is_written_with_a_reference(tmp_path):
    path = write_bench(tmp_path, planted="", files=4)
    for number, drift in enumerate((0.0, 0.2, -0.1, 0.3)):
        file = tmp_path / f"run_{number}.csv"
        head, *rows = [row.split(",") for row in file.read_text(encoding="utf-8").splitlines()]
        at = head.index("m")
        moved = [[*row[:at], f"{float(row[at]) + drift:.5f}", *row[at + 1 :]] for row in rows]
        file.write_text("\n".join(map(",".join, [head, *moved])) + "\n", encoding="utf-8")
    project = Project.read(path)
    proposal = project.propose(kinds=["offset"], nodes=["drag"])[0]
    assert list(proposal.offsets) == [f"run_{number}.csv" for number in range(4)]
    project.apply(proposal)
    assert "CurveDrag(speed) + OffsetDrag  # motored" in (tmp_path / "f.kf").read_text(encoding="utf-8")
    assert 'per = "recording"' in path.read_text(encoding="utf-8")
    result = Project.read(path).calibrate()
    offsets = result.parameters["OffsetDrag"].values
    np.testing.assert_allclose(offsets, [0, -0.2, 0.1, -0.3], atol=0.01)
    assert result.quality[0].rmse_after == pytest.approx(proposal.rmse.after, rel=1e-3)


@pytest.mark.slow
def test_an_undo_does_not_overwrite_later_changes(tmp_path):
    path = write_bench(tmp_path)
    project = Project.read(path)
    with pytest.raises(InputError, match="no proposal was applied that could be undone"):
        undo(project)
    project.apply(project.propose(kinds=["add"], nodes=["drag"], channels=["oil"])[0])
    path.write_text(path.read_text(encoding="utf-8") + "# mine\n", encoding="utf-8")
    with pytest.raises(InputError, match="the file was changed after the proposal was applied"):
        undo(project)
    assert path.read_text(encoding="utf-8").endswith("# mine\n")


@pytest.mark.slow
def test_files_with_a_byte_order_mark_in_other_folders_get_a_term_and_lose_it(tmp_path):
    path, function = write_bench(tmp_path), tmp_path / "parts" / "f.kf"
    function.parent.mkdir()
    function.write_text("\ufeff" + TEXT, encoding="utf-8")
    text = TOML.format(more="").replace('"f.kf"', '"parts/f.kf"')
    path.write_text("\ufeff" + text, encoding="utf-8")
    before = [file.read_bytes() for file in (function, path)]
    project = Project.read(path)
    proposal = project.propose(kinds=["add"], nodes=["drag"], channels=["oil"])[0]
    project.apply(proposal)
    assert all(file.read_bytes().startswith(b"\xef\xbb\xbf") for file in (function, path))
    assert not [finding for finding in Project.read(path).check() if finding.severity != "remark"]
    undo(project)
    assert [file.read_bytes() for file in (function, path)] == before
    stack = tmp_path / ".kennfeld" / "kennfeld" / "proposals.json"
    stack.unlink()
    stack.mkdir()
    with pytest.raises(InputError, match=r"proposals\.json"):
        project.apply(proposal)
    assert [file.read_bytes() for file in (function, path)] == before
    stack.rmdir()
    project.apply(proposal)
    function.unlink()
    with pytest.raises(InputError, match=r"f\.kf"):
        undo(project)


@pytest.mark.slow
def test_a_column_that_is_the_time_stays_the_time(tmp_path):
    path = write_bench(tmp_path, timed=True)
    for file in tmp_path.glob("run_*.csv"):
        file.write_text(file.read_text(encoding="utf-8").replace("time,", "t,", 1), encoding="utf-8")
    project = Project.read(path)
    proposals = project.propose(kinds=["add"], nodes=["drag"], channels=["*"])
    assert proposals[0].term.channel == "oil"
    problem, remarks = _with_more_channels(project, ["*"])
    assert (problem.datasets[0].time is not None, "oil" in problem.datasets[0], remarks) == (True, True, [])


def test_a_channel_that_test_data_lack_takes_no_part(tmp_path):
    path = write_bench(tmp_path, more='[[dataset]]\nname = "fresh"\nfiles = ["fresh.csv"]\nuse = "test"\n')
    text = (tmp_path / "run_0.csv").read_text(encoding="utf-8")
    (tmp_path / "fresh.csv").write_text(text.replace("oil", "water", 1), encoding="utf-8")
    proposals = Project.read(path).propose(kinds=["add"], nodes=["drag"])
    assert proposals.excluded["oil"] == "dataset fresh has no such channel"


def write_gaps(folder, files=4):
    """Blank the first samples of the oil temperature of each recording, and some of humidity in one."""
    for number in range(files):
        file = folder / f"run_{number}.csv"
        head, *rows = [row.split(",") for row in file.read_text(encoding="utf-8").splitlines()]
        oil, humidity = head.index("oil"), head.index("humidity")
        for at, row in enumerate(rows):
            row[oil] = "" if at < 4 else row[oil]
            row[humidity] = "" if number == 2 and at < 40 else row[humidity]
        file.write_text("\n".join(map(",".join, [head, *rows])) + "\n", encoding="utf-8")


def give_memory(folder):
    """Let the output settle, nearly at once."""
    text = (folder / "f.kf").read_text(encoding="utf-8")
    assert "base - drag" in text
    (folder / "f.kf").write_text(text.replace("base - drag", "PT1(base - drag, 0.01)"), encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "remembers"), [("add", False), ("map", False), ("add", True)])
def test_partitions_give_the_same_list(tmp_path, kind, remembers):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    for folder, more in ((whole, ""), (parts, "[cluster]\npartition = 200\n")):
        folder.mkdir()
        write_bench(folder, planted="drag" if kind == "add" else "", more=more, timed=True, files=4)
        if kind == "map":
            plant_map(folder, files=4)
        write_gaps(folder)
        if remembers:
            give_memory(folder)
    contents = []
    for folder in (whole, parts):
        project = Project.read(folder / "kennfeld.toml")
        content = project.propose(kinds=[kind], nodes=["drag"], channels=["oil", "humidity", "speed"]).as_json()
        contents.append(content | {"proposals": [each | {"patch": ""} for each in content["proposals"]]})
        project.close()
    assert json.dumps(contents[0]) == json.dumps(contents[1])
    assert contents[0]["excluded"] == {"humidity": "7% of its samples are missing"}
    assert len(contents[0]["proposals"]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("remembers", [False, True], ids=["without memory", "with memory"])
@pytest.mark.parametrize("kinds", [("add", "lag"), ("map",)], ids=["curves", "maps"])
def test_a_cluster_gives_the_same_list_to_the_bit(tmp_path, shared_cluster, kinds, remembers):
    path = write_bench(tmp_path, planted="drag" if "add" in kinds else "", timed=True, files=4)
    if "map" in kinds:
        plant_map(tmp_path, files=4)
    if remembers:
        give_memory(tmp_path)
    lists = []
    for address in ("", shared_cluster.address):
        project = in_partitions(path, 200, scheduler=address)
        lists.append(project.propose(kinds=kinds, nodes=["drag"], channels=["oil", "speed"]))
        project.close()
    here, there = (own.as_json()["proposals"] for own in lists)
    assert here == there != []
    assert lists[0][0].rmse == lists[1][0].rmse
    assert lists[0][0].held_out == lists[1][0].held_out
    assert [own.smallest_effect for own in lists] == [lists[0].smallest_effect] * 2
    np.testing.assert_array_equal(*(own[0].parameter.values for own in lists))


def test_the_command_prints_the_list_and_applies_one(tmp_path, capsys):
    path = write_bench(tmp_path)
    arguments = ["propose", str(path), "--kind", "add", "--node", "drag"]
    assert cli.run([*arguments, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [proposal["channel"] for proposal in content["proposals"]] == ["oil"]
    arguments += ["--channel", "oil"]
    assert cli.run([*arguments, "--apply", "2"]) == 2
    assert "there is no proposal 2, only 1 proposal" in capsys.readouterr().err
    assert cli.run([*arguments, "--apply", "1"]) == 0
    assert f"Undo: kennfeld propose {path} --undo" in capsys.readouterr().out
    assert cli.run(["propose", str(path), "--undo"]) == 0
    assert capsys.readouterr().out.startswith("Undone: Add a curve of oil to drag.")


def test_nothing_missing_is_an_empty_list_and_no_error(tmp_path, capsys):
    path = write_bench(tmp_path, planted="")
    assert cli.run(["propose", str(path), "--kind", "add", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["proposals"], content["status"]) == ([], "none")
    assert cli.run(["propose", str(path), "--kind", "add", "--apply", "1"]) == 2
    assert "--apply: there is no proposal 1. Nothing is missing that these channels explain" in capsys.readouterr().err


def test_a_calibration_says_in_all_its_files_what_is_missing(tmp_path, capsys):
    path = write_bench(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("lock = true\n", ""), encoding="utf-8")
    # base instead of the planted term: the load is read, but not looked up
    (tmp_path / "f.kf").write_text(TEXT.replace("MapBase(speed, load)", "MapBase(speed, 0 * load)"), encoding="utf-8")
    assert cli.run(["calibrate", str(path)]) == 0
    line = "Add a curve of load to base: would take 9"
    assert line in capsys.readouterr().out
    results = tmp_path / "results"
    entry = json.loads((results / "result.json").read_text(encoding="utf-8"))["missing"]
    assert (entry["scored"], entry["best"]) == (True, "Add a curve of load to base")
    assert 0.9 < entry["share"] < 1
    again = tmp_path / "again.html"
    assert cli.run(["report", str(path), "-o", str(again)]) == 0
    for report in (results / "report.html", again):
        text = report.read_text(encoding="utf-8")
        assert "<h2>What is missing?</h2>" in text
        assert line in text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["torque", "exhaust", "idle"])
def test_a_calibrated_demo_says_if_something_is_missing(name, tmp_path, capsys):
    assert cli.run(["demo", name, "--dir", str(tmp_path / name)]) in (0, 1)
    assert "would take" in capsys.readouterr().out


def test_a_wrong_pattern_is_wrong_input(tmp_path, capsys):
    path = write_bench(tmp_path)
    assert cli.run(["propose", str(path), "--channel", "oli"]) == 2
    assert "the training data have no channel oli. Did you mean oil?" in capsys.readouterr().err
