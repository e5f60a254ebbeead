"""States of a search in the results folder, and going on from them."""

import itertools
import json
import tomllib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from kennfeld import InputError, Stop, cli, read_parameters
from kennfeld.calfiles import describe
from kennfeld.optimize.search import worker_pool
from kennfeld.optimize.search.problem_digest import problem_digest
from kennfeld.project import Project
from kennfeld.project.checkpoints import Saves
from kennfeld.project.document import ProjectDocument
from tests.draws import mostly_slow

TEXT = "input x\nm = a * exp(b * x) + C(x)\n"
TOML = """\
model.file = "m.kf"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "m"
target = "y"
[parameters.a]
initial = 3.0
[parameters.b]
initial = 1.0
bounds = [-3, 3]
[parameters.C]
x = { input = "x", breakpoints = [0, 1, 2, 3, 4] }
initial = 0.1
smoothness = 1.0
lock = [{ x = [0, 0] }]
"""


@pytest.fixture
def make(tmp_path):
    """Write the project, with sections added to its file."""
    x = np.linspace(0, 4, 60)
    y = 2 * np.exp(-1.3 * x) + np.sin(x)
    rows = "\n".join(f"{a},{b}" for a, b in zip(x, y, strict=True))
    (tmp_path / "d.csv").write_text(f"x,y\n{rows}\n", encoding="utf-8")
    (tmp_path / "m.kf").write_text(TEXT, encoding="utf-8")

    def build(*sections):
        (tmp_path / "kennfeld.toml").write_text("\n".join([TOML, *sections]), encoding="utf-8")
        return Project.read(tmp_path / "kennfeld.toml")

    return build


SAVING = "[optimizer]\nsave_every = 2"


def after(count):
    """A progress that stops after so many steps."""
    lines = []

    def watch(line):
        lines.append(line)
        if len(lines) >= count:
            raise Stop

    return watch


def names(tmp_path):
    return sorted(path.name for path in (tmp_path / "results" / "saves").iterdir() if path.is_file())


@pytest.mark.slow
def test_every_nth_accepted_set_and_the_end_are_saved(make, tmp_path):
    result = make(SAVING).calibrate()
    expected = [f"1-{i:06d}.json" for i in range(2, result.iterations + 1, 2)]
    assert names(tmp_path) == [*expected, "1-end.json"]
    last = read_parameters(tmp_path / "results" / "saves" / "1-end.json")
    assert last["C"].values.tolist() == result.parameters["C"].values.tolist()


def test_no_state_is_saved_by_default(make, tmp_path):
    make().calibrate()
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_a_state_is_a_calibration_file_like_any_other(make, tmp_path):
    make(SAVING).calibrate()
    path = tmp_path / "results" / "saves" / "1-000002.json"
    assert {p.name for p in describe(path).parameters} == {"a", "b", "C"}
    (simulated,) = make().simulate(read_parameters(path))
    assert np.all(np.isfinite(simulated["m"].values))


@pytest.mark.slow
def test_a_stopped_search_resumes_from_its_best_state(make, tmp_path):
    whole = make(SAVING).calibrate()
    stopped = make(SAVING).calibrate(after(5))
    assert stopped.status == "stopped"
    assert names(tmp_path) == ["1-000002.json", "1-000004.json"]
    result = make(SAVING).calibrate(resume=True)
    assert result.status == "converged"
    assert result.resumed == ("saves/1-000004.json",)
    assert "Resumed from saves/1-000004.json." in result.message
    assert "changed" not in result.message
    assert result.cost_after == pytest.approx(whole.cost_after, rel=1e-9)
    assert result.cost_before == whole.cost_before
    assert result.trace[0].cost <= stopped.trace[3].cost
    assert result.as_json()["resumed"] == ["saves/1-000004.json"]
    assert names(tmp_path)[:3] == ["1-000002.json", "1-000004.json", "1-000006.json"]
    assert "1-end.json" in names(tmp_path)


@pytest.mark.slow
def test_locked_values_are_those_of_the_project(make, monkeypatch):
    monkeypatch.setattr(f"{__name__}.TOML", TOML.replace("initial = 0.1\n", ""))
    make("initial = 0.1", SAVING).calibrate(after(5))
    result = make("initial = 0.3", SAVING).calibrate(resume=True)
    assert result.parameters["C"].values[0] == 0.3


@pytest.mark.slow
def test_a_completed_search_is_not_continued(make):
    result = make(SAVING).calibrate()
    lines = []
    again = make(SAVING).calibrate(lines.append, resume=True)
    assert lines == []
    assert again.cost_after == result.cost_after
    assert again.starts == result.starts


@pytest.mark.slow
def test_a_search_that_ran_out_of_iterations_continues(make):
    short = make(f"{SAVING}\nmax_iterations = 2").calibrate()
    assert short.status == "max_iterations"
    result = make(SAVING).calibrate(resume=True)
    assert result.status == "converged"
    assert result.cost_after < short.cost_after


def test_an_end_that_was_resumed_is_a_state_like_others(make, tmp_path):
    make(f"{SAVING}\nmax_iterations = 3").calibrate()
    assert names(tmp_path) == ["1-000002.json", "1-end.json"]
    make(SAVING).calibrate(after(2), resume=True)
    assert names(tmp_path) == ["1-000002.json", "1-000003.json", "1-000004.json"]
    state = make(SAVING).saves().resume_points().states[1]
    costs = [json_note(tmp_path, name)["cost"] for name in names(tmp_path)]
    assert state.cost == min(costs)


def json_note(tmp_path, name):
    content = json.loads((tmp_path / "results" / "saves" / name).read_text(encoding="utf-8"))
    return json.loads(content["kennfeld_save"]["text"])


@pytest.mark.slow
def test_other_data_are_noticed_with_the_same_project_file(make, tmp_path):
    first = make(SAVING).calibrate()
    path = tmp_path / "d.csv"
    x, y = np.loadtxt(path, delimiter=",", skiprows=1).T
    path.write_text("x,y\n" + "\n".join(f"{a},{b + 0.3}" for a, b in zip(x, y, strict=True)), encoding="utf-8")
    lines = []
    again = make(SAVING).calibrate(lines.append, resume=True)
    assert lines
    assert again.parameters["a"].value != first.parameters["a"].value


@pytest.mark.slow
def test_a_changed_project_file_is_a_warning(make):
    make(SAVING).calibrate(after(5))
    project = make(SAVING, "# a word")
    (finding,) = project.saves().resume_points().findings
    assert finding.severity == "warning"
    assert "kennfeld.toml: changed since" in project.calibrate(resume=True).message


def test_tables_of_another_size_cannot_be_resumed(make):
    make(SAVING).calibrate(after(5))
    project = make(SAVING)
    text = project.path.read_text(encoding="utf-8").replace("[0, 1, 2, 3, 4]", "[0, 2, 4]")
    project.path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"saves/1-000004.json: C has shape \[5\], but the problem has \[3\]"):
        Project.read(project.path).calibrate(resume=True)


def test_a_search_without_a_state_cannot_be_resumed(make):
    with pytest.raises(InputError, match=r"no checkpoint to resume from.*Set save_every"):
        make().calibrate(resume=True)


@pytest.mark.slow
@pytest.mark.parametrize("content", mostly_slow([b"", b'{"a": {"kind": "sca', b"\0\0\0\0", b"[]", b"{}"], 2))
def test_a_half_written_state_is_ignored(make, tmp_path, content):
    make(SAVING).calibrate(after(5))
    (tmp_path / "results" / "saves" / "1-000004.json").write_bytes(content)
    project = make(SAVING)
    (finding,) = project.saves().resume_points().findings
    assert str(finding.location) == "saves/1-000004.json"
    assert project.calibrate(resume=True).resumed == ("saves/1-000002.json",)


def test_a_new_search_moves_only_the_states_of_the_previous_one(make, tmp_path):
    make(SAVING).calibrate()
    before = names(tmp_path)
    mine = tmp_path / "results" / "saves" / "notes.json"
    mine.write_text("{}", encoding="utf-8")
    make(SAVING).calibrate(after(3))
    assert names(tmp_path) == ["1-000002.json", "notes.json"]
    aside = tmp_path / "results" / "saves" / "before"
    assert sorted(path.name for path in aside.iterdir()) == before
    make(SAVING).calibrate(after(1))
    assert names(tmp_path) == ["1-000002.json", "notes.json"]
    make(SAVING).calibrate(after(3))
    assert [path.name for path in aside.iterdir()] == ["1-000002.json"]


def test_fixed_values_are_not_saved(make, tmp_path):
    make(SAVING, "[calibration]\nfree = ['a', 'b']").calibrate()
    assert set(read_parameters(tmp_path / "results" / "saves" / "1-end.json")) == {"a", "b"}


@pytest.mark.slow
def test_a_step_added_to_a_finished_sequence_is_run(make):
    make("[[step]]\nfree = ['a']", SAVING).calibrate()
    result = make("[[step]]\nfree = ['a']\n[[step]]\nname = 'more'\nfree = ['a', 'b']", SAVING).calibrate(resume=True)
    assert {line.stage.split(":")[0] for line in result.trace} == {"more"}


@pytest.mark.slow
def test_a_sequence_resumes_in_its_interrupted_step(make, tmp_path):
    sequence = "[[step]]\ngrid_reduction = 2\n[[step]]\nname = 'fine'"
    whole = make(sequence, SAVING).calibrate()
    count = sum(line.stage.startswith("step 1") for line in whole.trace)
    make(sequence, SAVING).calibrate(after(count + 1))
    state = make(sequence, SAVING).saves().resume_points().states[1]
    assert state.step == 2
    result = make(sequence, SAVING).calibrate(resume=True)
    assert {line.stage.split(":")[0] for line in result.trace} == {"fine"}
    assert result.cost_after == pytest.approx(whole.cost_after, rel=1e-6)


@pytest.mark.slow
def test_a_coarse_step_is_resumed_on_its_coarse_grid(make):
    sequence = "[[step]]\ngrid_reduction = 2\n[[step]]\nname = 'fine'"
    whole = make(sequence, SAVING).calibrate()
    stopped = make(sequence, SAVING).calibrate(after(3))
    assert stopped.status == "stopped"
    result = make(sequence, SAVING).calibrate(resume=True)
    assert result.trace[0].stage.startswith("step 1")
    assert result.trace[0].cost <= stopped.trace[1].cost
    assert result.cost_after == pytest.approx(whole.cost_after, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("workers", mostly_slow([1, 2], 1))
def test_finished_starts_are_not_repeated(make, workers):
    several = f"{SAVING}\nstarts = 2\nspread = 0.2"
    whole = make(several).calibrate(workers=1)

    def watch(line):
        if line.start == 2:
            raise Stop

    make(several).calibrate(watch, workers=workers)
    result = make(several).calibrate(workers=workers, resume=True)
    assert result.resumed
    assert [row.status for row in result.starts] == [row.status for row in whole.starts]
    assert result.cost_after == pytest.approx(whole.cost_after, rel=1e-6)
    assert [row.cost_before for row in result.starts] == [row.cost_before for row in whole.starts]


@pytest.mark.slow
def test_a_resumed_search_lists_the_state_of_each_start(make, capsys):
    several = f"{SAVING}\nstarts = 3\nspread = 0.2"

    def watch(line):
        if line.start == 2 and line.iteration >= 3:
            raise Stop

    project = make(several)
    project.calibrate(watch, workers=1)
    states = project.saves().resume_points().states
    assert {number: state.ended is not None for number, state in states.items()} == {1: True, 2: False}
    assert cli.run(["calibrate", str(project.path), "--resume", "--workers", "1"]) in (0, 1)
    out, err = capsys.readouterr()
    assert "Resumed from saves/1-end.json, saves/2-000002.json." in out
    assert "Not repeated, because converged: start 1." in out
    assert "Without a checkpoint, begun anew: start 3." in out
    lines = [line for line in err.splitlines() if line.startswith("start ") and "cost" not in line[:30]]
    assert lines[0].startswith("start  1  had converged at cost ")
    assert lines[1].startswith("start  2  resumes from saves/2-000002.json: iteration ")
    assert lines[2] == "start  3  begins anew: it has no checkpoint"


def test_a_single_start_names_the_state_that_it_resumes(make, capsys):
    project = make(SAVING)
    project.calibrate(after(5))
    assert cli.run(["calibrate", str(project.path), "--resume"]) == 0
    assert capsys.readouterr().err.startswith("resumes from saves/1-000004.json: iteration 4, cost ")
    assert cli.run(["calibrate", str(project.path), "--resume", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_a_state_that_cannot_be_written_does_not_end_the_search(make, tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "saves").write_text("a file", encoding="utf-8")
    result = make(SAVING).calibrate()
    assert result.status == "converged"
    assert "checkpoints cannot be written" in result.message


@pytest.mark.slow
def test_states_may_be_saved_in_another_folder(make, tmp_path):
    make(SAVING).calibrate(folder=tmp_path / "other")
    assert (tmp_path / "other" / "saves" / "1-end.json").exists()
    assert isinstance(make(SAVING).saves(tmp_path / "other"), Saves)


@pytest.mark.slow
def test_moving_breakpoints_are_saved_and_resumed(make, tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.TOML", TOML.replace("[0, 1, 2, 3, 4] }", "[0, 1, 2, 3, 4], free = true }"))
    whole = make(SAVING).calibrate()
    states = [read_parameters(path) for path in (tmp_path / "results" / "saves").glob("*.json")]
    assert len({tuple(state["C"].axes[0].breakpoints) for state in states}) > 1
    lines = []
    again = make(SAVING).calibrate(lines.append, resume=True)
    assert lines == []
    assert again.cost_after == pytest.approx(whole.cost_after, rel=1e-9)
    assert again.parameters["C"].axes[0].breakpoints.tolist() == whole.parameters["C"].axes[0].breakpoints.tolist()


@pytest.mark.parametrize(
    "section",
    ["[calibration]\nfree = ['a', 'b']\n", "[[limit]]\nnode = 'm'\nmax = 1.0\n", "[parameters.b]\nbounds = [-1, 1]"],
)
def test_free_parameters_and_limits_identify_a_problem(make, section):
    plain, other = with_sections(make, ""), with_sections(make, section)
    assert problem_digest(other.problem(), other.options) != problem_digest(plain.problem(), plain.options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "after"),
    [
        pytest.param(
            "[calibration]\nfree = ['a', 'b']\n[parameters.b]\ninitial = 0.0",
            "[calibration]\nfree = ['*']",
            marks=pytest.mark.slow,
            id="free",
        ),
        pytest.param(
            "[parameters.b]\nbounds = [-1, 1]", "[parameters.b]\nbounds = [-3, 3]", marks=pytest.mark.slow, id="bounds"
        ),
        pytest.param("[[limit]]\nnode = 'm'\nmax = 1.0", "", marks=pytest.mark.slow, id="limit"),
        ("[parameters.C]\nsmoothness = 1e3", "[parameters.C]\nsmoothness = 1.0"),
        pytest.param(
            "[optimizer]\ntolerance = 0.1", "[optimizer]\ntolerance = 1e-8", marks=pytest.mark.slow, id="tolerance"
        ),
    ],
)
def test_the_end_of_another_problem_does_not_end_a_search(make, before, after):
    """A search under a limit ends where the cost without it is the same, but not least."""
    solved = with_sections(make, after).calibrate()
    with_sections(make, before).calibrate()
    result = with_sections(make, after).calibrate(resume=True)
    assert result.resumed == ("saves/1-end.json",)
    assert result.status == "converged"
    assert result.cost_after == pytest.approx(solved.cost_after, rel=1e-3)


def with_sections(make, text):
    """The project with keys of sections replaced by those of a text, and checkpoints."""
    document = ProjectDocument(TOML)
    for section, keys in tomllib.loads(text).items():
        for key, value in keys.items() if isinstance(keys, dict) else [(None, keys)]:
            if isinstance(value, dict):
                for inner, number in value.items():
                    document.set((section, key, inner), number)
            else:
                document.set((section,) if key is None else (section, key), value)
    document.set(("optimizer", "save_every"), 2)
    project = make()
    project.path.write_text(document.text, encoding="utf-8")
    return Project.read(project.path)


def test_checkpoints_of_another_project_in_the_folder_are_not_resumed(make, tmp_path):
    make(SAVING).calibrate()
    other = tmp_path / "other.toml"
    other.write_bytes((tmp_path / "kennfeld.toml").read_bytes())
    with pytest.raises(InputError, match=r"Those in it are of kennfeld\.toml"):
        Project.read(other).calibrate(resume=True)


PROPORTIONAL = """\
model.file = "p.kf"
[[dataset]]
files = "p.csv"
[[criterion]]
node = "m"
target = "y"
[parameters.a]
initial = 0.3
[parameters.C]
x = { input = "x", breakpoints = [-9, 0, 9, 10] }
initial = 0
lock = [{ x = [-9, 9] }]
[optimizer]
save_every = 1
"""


@pytest.fixture
def proportional(tmp_path):
    """Write a project whose optimum is a = x'y / x'x, with a value that no sample informs."""
    (tmp_path / "p.kf").write_text("input x\nm = a * x + C(x)\n", encoding="utf-8")
    x, y = np.arange(-3.0, 5.0), np.array([-5.5, -4.5, -1.0, 1.0, 1.5, 4.5, 5.0, 9.5])

    def write(y):
        rows = "\n".join(f"{float(a)!r},{float(b)!r}" for a, b in zip(x, y, strict=True))
        (tmp_path / "p.csv").write_text(f"x,y\n{rows}\n", encoding="utf-8")
        (tmp_path / "p.toml").write_text(PROPORTIONAL, encoding="utf-8")
        return Project.read(tmp_path / "p.toml")

    write.x, write.y, write.best = x, y, lambda y: (x @ y) / (x @ x)
    return write


def test_other_data_of_the_same_cost_are_noticed(proportional):
    """Residuals of the other sign cost the same at the old optimum, but pull it elsewhere."""
    x, y = proportional.x, proportional.y
    proportional(y).calibrate()
    mirrored = np.where(x > 2, 2 * proportional.best(y) * x - y, y)
    result = proportional(mirrored).calibrate(resume=True)
    assert result.resumed == ("saves/1-end.json",)
    assert result.parameters["a"].value == pytest.approx(proportional.best(mirrored), rel=1e-6)


@pytest.mark.slow
def test_another_version_of_the_code_poses_another_problem(make, monkeypatch):
    make(SAVING).calibrate()
    monkeypatch.setattr("kennfeld.optimize.search.problem_digest.code_digest", lambda: "another")
    assert "Not repeated" not in make(SAVING).calibrate(resume=True).message


def test_a_checkpoint_with_damaged_values_is_ignored(proportional, tmp_path):
    proportional(proportional.y).calibrate()
    path = tmp_path / "results" / "saves" / "1-end.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["C"]["values"][-1] = 777.0
    path.write_text(json.dumps(content), encoding="utf-8")
    result = Project.read(tmp_path / "p.toml").calibrate(resume=True)
    assert result.parameters["C"].values[-1] == 0.0
    assert "1-end.json: incomplete or damaged checkpoint" in result.message


def test_costs_of_other_data_are_not_compared(proportional, tmp_path):
    """A run with other data goes on from its own checkpoint, though an earlier one has a lower cost."""
    proportional(2 * proportional.x).calibrate()
    proportional(proportional.y).calibrate(after(1), resume=True)
    project = proportional(proportional.y)
    state = project.saves().resume_points().states[1]
    assert state.cost > 1.0
    assert state.values["a"] == pytest.approx(proportional.best(proportional.y), abs=0.1)


def test_an_end_with_a_later_checkpoint_does_not_end_a_search(make, tmp_path):
    """As after a process that was killed before it renamed the end."""
    make(f"{SAVING}\nmax_iterations = 3").calibrate()
    folder = tmp_path / "results" / "saves"
    end = (folder / "1-end.json").read_bytes()
    make(SAVING).calibrate(after(2), resume=True)
    (folder / "1-end.json").write_bytes(end)
    state = make(SAVING).saves().resume_points().states[1]
    assert state.ended is None
    assert state.iteration == 4


@pytest.mark.slow
def test_a_start_that_is_not_repeated_has_its_present_cost(make, monkeypatch):
    make(SAVING).calibrate()
    monkeypatch.setattr(f"{__name__}.TOML", TOML.replace("initial = 3.0", "initial = 2.5"))
    result = make(SAVING).calibrate(resume=True)
    assert "Not repeated, because converged" in result.message
    assert result.starts[0].cost_before == result.cost_before


@pytest.mark.slow
def test_four_runs_at_once_leave_whole_checkpoints(make, tmp_path):
    project = make(SAVING)
    with ThreadPoolExecutor(4) as threads:
        results = list(threads.map(lambda _: Project.read(project.path).calibrate(), range(4)))
    for path in (tmp_path / "results" / "saves").rglob("*.json"):
        assert read_parameters(path)
    result = make(SAVING).calibrate(resume=True)
    assert result.cost_after == results[0].cost_after
    assert "incomplete" not in result.message


class _Killer:
    """A killer of some busy workers of a pool, all at once, after so many steps."""

    def __init__(self, monkeypatch, count, steps):
        self.workers, self.count, self.steps = [], count, steps
        outer = self

        class Mortal(worker_pool._Worker):
            def __init__(self, *arguments):
                super().__init__(*arguments)
                outer.workers.append(self)

        monkeypatch.setattr(worker_pool, "_Worker", Mortal)

    def __call__(self, line):
        self.steps -= 1
        if self.steps == 0:
            for worker in [worker for worker in self.workers if worker.point is not None][: self.count]:
                worker.process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4])
def test_after_workers_were_killed_the_run_ends_and_resuming_completes_it(make, monkeypatch, count):
    project = make("[optimizer]\nsave_every = 1\nstarts = 6")
    whole = project.calibrate(workers=1)
    broken = project.calibrate(_Killer(monkeypatch, count, 3), workers=4)
    failed = [row for row in broken.starts if row.status == "failed"]
    assert 1 <= len(failed) <= count  # one may have come to its end before
    assert broken.status == "converged"
    assert f"{len(failed)} of them failed, one with the message: The worker process of this start" in broken.message
    resumed = project.calibrate(workers=4, resume=True)
    assert {row.status for row in resumed.starts} == {"converged"}
    np.testing.assert_allclose(resumed.parameters["C"].values, whole.parameters["C"].values, rtol=1e-5)


@pytest.mark.slow
def test_a_clock_that_goes_backwards_has_no_effect(make, monkeypatch):
    project = make(SAVING)
    whole = project.calibrate()
    clock = itertools.count(1_800_000_000, -3600)
    monkeypatch.setattr("time.time", lambda: float(next(clock)))
    monkeypatch.setattr("time.time_ns", lambda: 10**9 * next(clock))
    stopped = project.calibrate(after(3))
    resumed = project.calibrate(resume=True)
    assert stopped.status == "stopped"
    np.testing.assert_allclose(resumed.parameters["C"].values, whole.parameters["C"].values, rtol=1e-5)
    assert all(seconds >= 0 for seconds in vars(resumed.seconds).values() if isinstance(seconds, float))
