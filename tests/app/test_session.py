"""Sessions: edits that are followed at once, undo, and runs in a process of their own."""

import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS
from kennfeld.app.session.reference import deviation_of
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetValues
from kennfeld.app.session.value_edits import ValueEdit
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.project import Project

forked = pytest.mark.usefixtures("forked_workers")


def wait_for_end(session: Session) -> None:
    deadline = time.monotonic() + 120
    while session.job.state in ("running", "stopping"):
        assert time.monotonic() < deadline, "the run does not end"
        time.sleep(0.02)
        session.pump()


def raise_value(session: Session, name: str, by: float) -> None:
    table = session.parameters[name]
    session.do(SetValues("raised", name, table.values + by))


def test_an_edit_is_followed_as_the_command_line_would_score_it(torque: Path) -> None:
    session = Session(torque)
    raise_value(session, "MapOptTorque", 10.0)
    project = Project.read(torque)
    edited = project.problem().parameters.with_parameters(session.parameters["MapOptTorque"])
    [bench] = [data for data in project.simulate(edited) if data.name == "bench"]
    error = bench["TorquePredict"].values - bench["Torque"].values
    training = next(score for score in session.require_view().now.scores if score.use == "training")
    assert training.rmse == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=1e-12)


def test_undo_and_redo_restore_the_numbers(torque: Path) -> None:
    session = Session(torque)
    start = session.require_view().now.scores
    raise_value(session, "MapOptTorque", 10.0)
    edited = session.require_view().now.scores
    assert edited != start
    session.undo()
    assert session.require_view().now.scores == start
    session.redo()
    assert session.require_view().now.scores == edited


@pytest.mark.bits
def test_a_run_gives_the_same_values_as_the_command_line(exhaust: Path) -> None:
    session = Session(exhaust)
    session.run()
    wait_for_end(session)
    assert session.job.state == "converged"
    expected = Project.read(exhaust).calibrate()
    for name, table in expected.parameters.items():
        np.testing.assert_array_equal(session.parameters[name].values, table.values)
    assert deviation_of(session, "MapSettled") is not None
    (progress,) = [
        row for row in QUESTIONS["progress"](session, {}).head["tables"] if row["name"] == "CurveTimeConstant"
    ]
    final = expected.parameters["CurveTimeConstant"].values
    np.testing.assert_allclose(np.ravel(progress["values"]), final, rtol=1e-6)  # not those of an earlier step


@forked
def test_a_second_run_is_refused_during_the_first(exhaust: Path) -> None:
    session = Session(exhaust)
    session.run()
    with pytest.raises(ArgumentError, match="a run is in progress"):
        session.run()
    session.close()


@forked
def test_a_run_can_be_stopped_and_keeps_its_best_values(torque: Path) -> None:
    session = Session(torque)
    session.run()
    deadline = time.monotonic() + 60
    while not session.job.trace and session.job.state == "running":
        assert time.monotonic() < deadline
        time.sleep(0.005)
        session.pump()
    session.stop()
    wait_for_end(session)
    assert session.job.state in ("stopped", "converged")
    assert session.require_view().now.scores[0].rmse < session.require_view().start.scores[0].rmse


@pytest.mark.slow
@forked
def test_a_worker_that_dies_is_reported_and_the_session_continues(torque: Path) -> None:
    session = Session(torque)
    session.run()
    session.close()  # kills the process
    wait_for_end(session)
    assert session.job.state == "failed"
    assert "ended unexpectedly" in session.job.message
    raise_value(session, "MapOptTorque", 1.0)
    session.run()
    wait_for_end(session)
    assert session.job.state == "converged"


def test_a_project_that_cannot_be_read_shows_the_reason(torque: Path) -> None:
    torque.write_text(torque.read_text(encoding="utf-8").replace('"torque.kf"', '"missing.kf"'), encoding="utf-8")
    session = Session(torque)
    assert session.view is None
    assert any("missing.kf" in str(finding) for finding in session.findings)
    with pytest.raises(InputError):
        session.run()


def test_a_run_on_data_that_have_changed_is_refused_with_what_changed(exhaust: Path) -> None:
    session = Session(exhaust)
    drive, other = exhaust.parent / "drive.csv", exhaust.parent / "another_drive.csv"
    stat, text, others = drive.stat(), drive.read_text(encoding="utf-8"), other.read_text(encoding="utf-8")
    drive.write_text("\n".join(text.splitlines()[:2001]) + "\n", encoding="utf-8")
    os.utime(drive, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    other.unlink()
    changes = [str(each) for each in session.disk_changes]
    assert changes == ["drive.csv has 54.65 kB instead of 185.7 kB", "another_drive.csv was deleted"]
    with pytest.raises(InputError, match=r"drive\.csv: has .* since it was read") as refused:
        session.run()
    assert [finding.location.file for finding in refused.value.findings] == ["drive.csv", "another_drive.csv"]
    other.write_text(others, encoding="utf-8")
    session.reload()
    assert not session.changed_on_disk
    assert session.require_view().model.problem.datasets[0].samples == 1999  # below two lines of header
    assert not session.findings


def test_a_recording_that_a_change_of_a_setting_reads_again_is_announced(exhaust: Path) -> None:
    session = Session(exhaust)
    drive = exhaust.parent / "another_drive.csv"
    drive.write_text("\n".join(drive.read_text(encoding="utf-8").splitlines()[:1001]) + "\n", encoding="utf-8")
    session.do(SetKeys("a title", exhaust.name, [(("report", "title"), "Exhaust")]))
    [finding] = session.findings
    assert (finding.severity, finding.location.file) == ("warning", "another_drive.csv")
    assert "was read again" in finding.message
    session.reload()
    assert not session.findings


@pytest.mark.slow
@forked
def test_a_file_that_is_deleted_during_a_run_is_named_at_its_end(exhaust: Path) -> None:
    session = Session(exhaust)
    session.run()
    (exhaust.parent / "another_drive.csv").unlink()
    wait_for_end(session)
    assert session.job.state == "converged"
    assert "another_drive.csv was deleted" in session.job.message


@pytest.mark.slow
def test_files_saved_by_the_app_do_not_count_as_changed_on_disk(torque: Path) -> None:
    session = Session(torque)
    for _ in range(2):
        raise_value(session, "MapOptTorque", 1.0)
        session.save()
        assert not session.changed_on_disk
        session.refresh()


def training(session: Session) -> float:
    return session.require_view().now.scores[0].rmse


def step(session: Session, amount: float, cells: Sequence[int] = (0,), drag: str = "") -> None:
    session.edit(ValueEdit("MapSettled", cells, f"raised by {amount}", kind="add", amount=amount, drag=drag))


def test_many_steps_add_up(exhaust: Path) -> None:
    session = Session(exhaust)
    session.edit(ValueEdit("MapSettled", (3,), "set", values=(100.0,)))
    for _ in range(30):
        step(session, 0.1, (3,))
    assert session.parameters["MapSettled"].values.ravel()[3] == 103.0
    for _ in range(30):
        session.undo()
    assert session.parameters["MapSettled"].values.ravel()[3] == 100.0


def test_an_edit_of_values_that_a_table_does_not_have_is_refused(exhaust: Path) -> None:
    session = Session(exhaust)
    size = session.parameters["MapSettled"].size
    for edit in (
        ValueEdit("MapSettled", (size,), "x", values=(1.0,)),
        ValueEdit("MapSettled", (-1,), "x", values=(1.0,)),
        ValueEdit("MapSettled", (0, 1), "x", values=(1.0,)),
        ValueEdit("Missing", (0,), "x", values=(1.0,)),
    ):
        with pytest.raises(ArgumentError, match=r"MapSettled|Missing"):
            session.edit(edit)
    assert session.history.undoable == ""


@forked
def test_edits_during_a_run_wait_and_are_applied_to_its_values(exhaust: Path) -> None:
    session = Session(exhaust)
    session.run()
    before = session.parameters["MapSettled"].values.ravel()[:2].tolist()
    step(session, 1.5)
    step(session, 2.5)  # joins the first
    session.edit(ValueEdit("MapSettled", (1,), "typed", values=(321.0,)))
    session.edit(ValueEdit("CurveTimeConstant", (0,), "taken back", values=(99.0,)))
    assert session.undo() == "taken back"
    assert [edit.title for edit in session.waiting] == ["raised by 2.5", "typed"]
    assert session.parameters["MapSettled"].values.ravel()[:2].tolist() == before
    wait_for_end(session)
    fitted = session.runs[-1].result.parameters["MapSettled"].values.ravel()
    now = session.parameters["MapSettled"].values.ravel()
    assert now[:2].tolist() == [pytest.approx(fitted[0] + 4.0, rel=1e-11), 321.0]
    np.testing.assert_array_equal(now[2:], fitted[2:])
    assert "2 edits that waited were applied" in session.job.message
    assert [session.undo() for _ in range(3)] == ["typed", "raised by 2.5", "Run 1"]


@forked
def test_an_edit_that_no_table_takes_any_more_after_a_run_is_reported(exhaust: Path) -> None:
    session = Session(exhaust)
    session.run()
    session.waiting.append(ValueEdit("MapSettled", (10_000,), "raised a point", kind="add", amount=1.0))
    wait_for_end(session)
    assert "raised a point was not applied: MapSettled has" in session.job.message


def test_the_change_of_the_last_edit_is_that_of_one_edit(exhaust: Path) -> None:
    session = Session(exhaust)
    start = training(session)
    step(session, 5.0, range(50))
    first = training(session)
    step(session, 5.0, range(50), drag="drag 1")
    step(session, 5.0, range(50), drag="drag 1")
    assert session.last[0].rmse == first != start
    second = training(session)
    session.do(SetKeys("a title", exhaust.name, [(("report", "title"), "Exhaust")]))
    assert session.last[0].rmse == second == training(session)
