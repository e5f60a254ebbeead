"""Unsaved values keep their meaning when breakpoints, recordings or other files change."""

import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld import RBF, Axis, Curve, Expansion, ParameterSet, Scalar
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.edited_values import fit_onto, moved_breakpoints, with_edits
from kennfeld.app.session.reference import deviation_of
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SignalName
from kennfeld.app.session.state import SetText, SetValues
from kennfeld.app.session.summary import summarise_session
from kennfeld.base.errors import ArgumentError
from kennfeld.project import Project

TOML = """\
model.file = "m.kf"
[[dataset]]
files = "d*.csv"
[[criterion]]
node = "m"
target = "y"
[parameters.C]
x = { input = "x", breakpoints = [0, 1, 2, 3] }
initial = 1.0
"""
X = np.linspace(0.0, 3.0, 25)


def ask(session: Session, question: str, **arguments: Any) -> dict[str, Any]:
    return dict((QUESTIONS.get(question) or COMMANDS[question])(session, arguments).head)


def record(path: Path, y: np.ndarray, z: np.ndarray = X) -> None:
    rows = (f"{a:.6f},{b:.6f},{c:.6f}" for a, b, c in zip(X, y, z, strict=True))
    path.write_text("x,y,z\n" + "\n".join(rows) + "\n", encoding="utf-8")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a curve over 0, 1, 2, 3, whose data are y = 2 x."""
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: tmp_path / "home"))
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "m.kf").write_text("input x\nm = C(x)\n", encoding="utf-8")
    (folder / "kennfeld.toml").write_text(TOML, encoding="utf-8")
    record(folder / "d1.csv", 2.0 * X)
    return folder / "kennfeld.toml"


def rmse(session: Session) -> float:
    return session.require_view().now.scores[0].rmse


def calibrate(session: Session) -> None:
    session.run()
    deadline = time.monotonic() + 120
    while session.job.state in ("running", "stopping"):
        assert time.monotonic() < deadline
        time.sleep(0.01)
        session.pump()


def edit(session: Session, values: list[float]) -> None:
    session.do(SetValues("edited", "C", np.array(values)))


WIDER = TOML.replace("[0, 1, 2, 3]", "[0, 2, 4, 6]")
INTERPOLATED = [0.0, 4.0, 6.0, 6.0]  # of 0, 2, 4, 6 over 0, 1, 2, 3


def test_values_follow_breakpoints_that_another_program_changes(project: Path) -> None:
    session = Session(project)
    edit(session, [0, 2, 4, 6])
    assert not session.findings
    project.write_text(WIDER, encoding="utf-8")
    ask(session, "reload")
    assert session.parameters["C"].values.tolist() == INTERPOLATED
    assert "the breakpoints of C have changed" in str(session.findings[-1])
    session.undo()
    assert session.parameters["C"].values.tolist() == [0, 2, 4, 6]
    assert not session.findings


def test_values_follow_additional_breakpoints(project: Path) -> None:
    session = Session(project)
    edit(session, [0, 2, 4, 6])
    session.do(SetText("finer", project.name, TOML.replace("[0, 1, 2, 3]", "[0, 0.5, 1, 2, 3]")))
    assert session.parameters["C"].values.tolist() == [0, 1, 2, 4, 6]


def test_recovered_values_follow_breakpoints(project: Path) -> None:
    edit(Session(project), [0, 2, 4, 6])
    project.write_text(WIDER, encoding="utf-8")
    session = Session(project)
    ask(session, "recover")
    assert session.parameters["C"].values.tolist() == INTERPOLATED


def test_a_table_that_becomes_a_scalar_drops_its_edits(project: Path) -> None:
    session = Session(project)
    edit(session, [0, 2, 4, 6])
    scalar = TOML[: TOML.index("x = {")] + "initial = 1.0\n"
    project.with_name("m.kf").write_text("input x\nm = C * x\n", encoding="utf-8")
    session.do(SetText("scalar", project.name, scalar))
    assert session.parameters["C"].values.tolist() == 1.0
    assert "another kind of table" in str(session.findings[-1])


@pytest.mark.usefixtures("forked_workers")
def test_the_end_of_a_run_belongs_to_the_breakpoints_of_its_start(project: Path) -> None:
    session = Session(project)
    session.run()
    session.do(SetText("wider", project.name, WIDER))
    deadline = time.monotonic() + 120
    while session.job.state == "running" and time.monotonic() < deadline:
        time.sleep(0.01)
        session.pump()
    np.testing.assert_allclose(session.parameters["C"].values, INTERPOLATED, atol=1e-5)
    assert deviation_of(session, "C") is None


@pytest.mark.usefixtures("forked_workers")
def test_breakpoints_that_a_run_moved_are_shown_saved_and_undone(project: Path) -> None:
    record(project.with_name("d1.csv"), np.interp(X, [0, 0.5, 1.7, 3], [0, 5, -3, 4]))
    project.write_text(TOML.replace("[0, 1, 2, 3] }", "[0, 1, 2.5, 3], free = true }"), encoding="utf-8")
    session = Session(project)
    calibrate(session)
    [quality] = session.runs[-1].result.quality
    assert rmse(session) == pytest.approx(quality.rmse_after, rel=1e-6)
    assert deviation_of(session, "C") is not None
    session.undo()
    assert session.parameters["C"].axes[0].breakpoints.tolist() == [0, 1, 2.5, 3]
    ask(session, "accept", title="all", source={"from": 1}, cells={"C": None})
    assert rmse(session) == pytest.approx(quality.rmse_after, rel=1e-6)
    recovered = Session(project)
    ask(recovered, "recover")
    assert rmse(recovered) == pytest.approx(quality.rmse_after, rel=1e-6)
    recovered.save()
    assert rmse(Session(project)) == pytest.approx(quality.rmse_after, rel=1e-6)
    session.undo()
    ask(session, "accept", title="one", source={"from": 1}, cells={"C": [1]})
    assert session.parameters["C"].axes[0].breakpoints.tolist() == [0, 1, 2.5, 3]


def test_moved_breakpoints_need_a_free_axis_of_their_size() -> None:
    initial = ParameterSet([Curve("C", Axis([0, 1, 2], free=True), [0.0, 1.0, 4.0]), Scalar("k", 1.0)])
    edited = ParameterSet([Curve("C", Axis([0, 0.5, 2], free=True), [0.0, 1.0, 4.0])])
    values = {"C": edited["C"].values, **moved_breakpoints(edited)}
    now, findings = with_edits(initial, values, {"C": edited["C"]})
    assert now["C"].axes[0].breakpoints.tolist() == [0, 0.5, 2]
    assert findings == ()
    fixed = ParameterSet([Curve("C", [0, 1, 2], [0.0, 1.0, 4.0])])
    now, findings = with_edits(fixed, values, {"C": edited["C"]})
    np.testing.assert_allclose(now["C"].values, [0.0, 2.0, 4.0])
    assert len(findings) == 1
    assert with_edits(initial, {}, {}) == (initial, ())


@pytest.mark.usefixtures("forked_workers")
def test_a_recording_that_appears_or_goes_is_a_change(project: Path) -> None:
    session = Session(project)
    assert not session.changed_on_disk
    record(project.with_name("d2.csv"), 4.0 * X)
    assert [str(change) for change in session.disk_changes] == ["d2.csv is new"]
    session.reload()
    calibrate(session)
    expected = Project.read(project).calibrate().parameters["C"].values
    np.testing.assert_allclose(session.runs[-1].result.parameters["C"].values, expected, rtol=1e-6, atol=1e-9)
    assert not session.changed_on_disk
    project.with_name("d2.csv").unlink()
    assert [str(change) for change in session.disk_changes] == ["d2.csv was deleted"]


def test_a_plot_does_not_mix_a_recording_with_its_successor(project: Path) -> None:
    session = Session(project)
    recording = session.require_view().model.recordings[0]
    record(project.with_name("d1.csv"), 2.0 * X, X + 100.0)
    with pytest.raises(ArgumentError, match="have changed since they were read"):
        session._recordings.further_channels(recording, ["z"])
    session.refresh()
    recording = session.require_view().model.recordings[0]
    np.testing.assert_allclose(session._recordings.further_channels(recording, ["z"])["z"], X + 100.0, atol=1e-6)


@pytest.mark.parametrize("tables", ["{}", '{"C": {"kind": "curve"}}', "not JSON"])
def test_recovered_values_whose_breakpoints_are_damaged_are_not_guessed(project: Path, tables: str) -> None:
    edit(Session(project), [0, 2, 4, 6])
    path = Session(project).recovery.path
    recovery = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(recovery | {"tables": tables}), encoding="utf-8")
    session = Session(project)
    ask(session, "recover")
    expected = [0, 2, 4, 6] if tables == "{}" else [1, 1, 1, 1]  # earlier versions kept no breakpoints
    assert session.parameters["C"].values.tolist() == expected


def test_a_recording_of_the_same_size_and_time_is_read_again(project: Path) -> None:
    path = project.with_name("d1.csv")
    os.utime(path, ns=(10**18, 10**18))
    session, size = Session(project), path.stat().st_size
    record(path, 3.0 * X)
    os.utime(path, ns=(10**18, 10**18))
    assert path.stat().st_size == size
    assert session.changed_on_disk
    session.refresh()
    assert rmse(session) == pytest.approx(np.sqrt(np.mean((1 - 3.0 * X) ** 2)), rel=1e-5)


def test_an_excerpt_is_read_again_from_a_recording_of_the_same_size_and_time(project: Path) -> None:
    project.write_text(f"{TOML}[cluster]\npartition = 100000\n", encoding="utf-8")
    path = project.with_name("d1.csv")
    session = Session(project)
    before, status = rmse(session), path.stat()
    record(path, 2.0 * X[::-1])
    assert path.stat().st_size == status.st_size
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    session.refresh()
    record(path, 3.0 * X)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    session.refresh()
    assert rmse(session) == pytest.approx(np.sqrt(np.mean((1 - 3.0 * X) ** 2)), rel=1e-5)
    assert rmse(session) != before


@pytest.mark.usefixtures("forked_workers")
def test_an_export_states_changes_since_the_run(project: Path) -> None:
    session, file = Session(project), project.with_name("results") / "result.json"

    def exported() -> dict[str, Any]:
        ask(session, "export", whole=True, report=True)
        return dict(json.loads(file.read_text(encoding="utf-8")))

    calibrate(session)
    result = exported()
    assert result["status"] == "converged"
    assert result["cost"]["after"] == session.runs[-1].result.cost_after
    edit(session, [0, 2, 4, 7])
    result = exported()
    assert result["status"] == "stopped"
    assert result["message"].startswith("The values differ from those of run 1, which ended with status converged")
    assert result["cost"]["after"] is None
    session.undo()
    assert exported()["status"] == "converged"
    record(project.with_name("d1.csv"), 3.0 * X)
    session.refresh()
    assert exported()["message"].startswith("The project or its data have changed since run 1")


def test_a_target_that_is_a_node_follows_edits(project: Path) -> None:
    project.with_name("m.kf").write_text("input x\nm = C(x)\nn = k * x + 1\n", encoding="utf-8")
    text = TOML.replace('target = "y"', 'target = { node = "n" }') + "[parameters.k]\ninitial = 1.0\n"
    project.write_text(text, encoding="utf-8")
    session = Session(project)
    signals, recording = session.require_view().signals, session.require_view().model.recordings[0]
    np.testing.assert_allclose(signals.values(recording, SignalName("target", "0")), X + 1.0, atol=1e-5)
    session.do(SetValues("edited", "k", np.array(5.0)))
    np.testing.assert_allclose(signals.values(recording, SignalName("target", "0")), 5.0 * X + 1.0, atol=1e-5)
    worst = ask(session, "worst", dataset=0, criterion=0)["samples"][0]
    assert worst["measured"] == pytest.approx(16.0, abs=1e-5)
    assert worst["error"] == pytest.approx(-15.0, abs=1e-5)
    picture = summarise_session(session)["picture"]
    assert picture["measured"][-1] == pytest.approx(16.0, rel=1e-4)
    assert picture["start"][-1] == picture["now"][-1] == 1.0


def test_saving_keeps_values_saved_before(project: Path) -> None:
    project.with_name("m.kf").write_text("input x\nm = C(x) + k\n", encoding="utf-8")
    project.write_text(f"{TOML}[parameters.k]\ninitial = 1.0\n", encoding="utf-8")
    session = Session(project)
    edit(session, [0, 2, 4, 6])
    session.save()
    session = Session(project)
    session.do(SetValues("edited", "k", np.array(5.0)))
    session.save()
    session = Session(project)
    assert session.parameters["C"].values.tolist() == [0, 2, 4, 6]
    assert session.parameters["k"].values.tolist() == 5.0


def test_values_of_an_expansion_with_other_kinks_are_not_taken():
    parts = 0.0, [1.0], [2.0], [[0.0]], [[1.0]]
    own, other = (RBF("F", Expansion(*parts, hinges=[(0, 0.5, height)])) for height in (1.0, 3.0))
    matern = RBF("F", Expansion(*parts, "matern52", own.hinges))
    np.testing.assert_array_equal(fit_onto(own, own.with_values(own.values + 1)).values, own.values + 1)
    for unlike in (other, matern):
        with pytest.raises(ArgumentError, match="F has another kernel or other kinks in the file"):
            fit_onto(own, unlike)
        parameters, findings = with_edits(ParameterSet([own]), {"F": own.values + 1}, {"F": unlike})
        assert parameters["F"].values.tolist() == own.values.tolist()
        assert "its unsaved values are not used" in str(findings[0])
