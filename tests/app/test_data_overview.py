"""The data as a whole: errors by file, signals over all files, gaps, and the shift of a channel."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.app.answer import Answer
from kennfeld.app.questions.overview import overview
from kennfeld.app.server.frames import pack
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.project import Project
from tests.app import questions

SETTINGS = """
[model]
file = "gain.kf"

[[dataset]]
name = "steady"
files = ["steady.csv"]
use = "off"

[[dataset]]
name = "drives"
files = ["a.csv", "b.csv"]
warmup = 1.0

[[dataset]]
name = "fresh"
files = ["c.csv"]
use = "test"

[parameters.k]
initial = 2.0

[[criterion]]
node = "y"
target = "m"
"""


def ask(session: Session, question: str, **arguments: Any) -> Answer:
    answer = questions.ask(session, question, **arguments)
    pack(answer.head, answer.arrays)  # it can be sent
    return answer


def write_drive(path: Path, seed: int, *, late: int = 0, gap: slice = slice(0, 0)) -> None:
    """Write 60 s at 10 Hz: m is twice u, `late` samples later; extra is used by nothing."""
    rng = np.random.default_rng(seed)
    time, u = 0.1 * np.arange(600), np.repeat(rng.uniform(0, 10, 60), 10)
    m = 2 * u[np.maximum(np.arange(600) - late, 0)] + 0.1 * rng.standard_normal(600)
    u = np.where(np.isin(np.arange(600), np.arange(600)[gap]), np.nan, u)
    rows = "\n".join(f"{t:.1f},{'' if np.isnan(a) else a},{b},{seed}" for t, a, b in zip(time, u, m, strict=True))
    path.write_text(f"time [s],u,m,extra\n{rows}\n", encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_drive(tmp_path / "a.csv", 1, late=3)
    write_drive(tmp_path / "b.csv", 2, late=3, gap=slice(200, 222))
    write_drive(tmp_path / "c.csv", 3, late=3)
    (tmp_path / "gain.kf").write_text("y = k * u\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(SETTINGS, encoding="utf-8")
    return tmp_path


@pytest.fixture
def session(folder: Path) -> Session:
    session = Session(folder / "kennfeld.toml")
    assert not session.stale, session.findings
    return session


def test_errors_by_file_are_those_that_a_run_reports(session: Session) -> None:
    ask(session, "set-values", name="k", cells=[0], values=[2.1], title="edited")
    answer = ask(session, "file-errors")
    view = session.require_view()
    reported = Scorer(view.model.problem).scores(view.start.parameters, view.now.parameters).recordings
    rows = answer.head["files"]
    assert [row["name"] for row in rows] == ["a.csv", "b.csv", "c.csv"]
    assert [row["use"] for row in rows] == ["training", "training", "test"]
    for row, own in zip(rows, reported, strict=True):
        assert row["samples"] == own.samples
        assert row["rmse"] == pytest.approx(own.rmse_after)
        assert row["before"] == pytest.approx(own.rmse_before)
        assert row["worst"] == pytest.approx([own.worst.begin, own.worst.end, own.worst.rmse])
        assert (row["begin"], row["end"]) == pytest.approx((0.0, 59.9))


def test_lines_keep_the_extremes_of_each_file_and_holes_where_nothing_is_recorded(session: Session) -> None:
    rows = ask(session, "file-errors", pixels=60)
    errors = session.require_view().now.errors
    drives = [values for values in rows.arrays if not values.startswith("bins")]
    assert sorted(drives) == ["0", "1", "2"]
    assert np.nanmax(rows.arrays["2"]) == pytest.approx(np.nanmax(errors[1][0]))
    assert np.isnan(rows.arrays["0"][:2]).all()  # the warm-up is not scored
    counts = sum(rows.arrays[f"bins {k}"].sum() for k in range(3))
    assert counts == sum(np.isfinite(each).sum() for each in errors)
    lines = ask(session, "file-lines", signals=[{"kind": "channel", "name": "u"}], pixels=60)
    assert np.isnan(lines.arrays["0 1"][2 * 20 + 2 : 2 * 22]).all()
    assert not np.isnan(lines.arrays["0 0"]).any()


def test_a_gap_is_named_with_its_file_and_its_times(session: Session) -> None:
    rows = ask(session, "file-errors").head["files"]
    assert [row["gaps"] for row in rows] == [[0, 0.0], [1, pytest.approx(2.3)], [0, 0.0]]
    [facts] = ask(session, "file-lines", signals=[{"kind": "channel", "name": "u"}]).head["signals"]
    assert facts["gaps"] == {1: [pytest.approx([19.9, 22.2])]}


def test_channels_that_the_project_does_not_use_are_read_when_they_are_asked_for(session: Session) -> None:
    answer = ask(session, "file-lines", signals=[{"kind": "channel", "name": "extra"}], pixels=8)
    assert [set(answer.arrays[f"0 {k}"]) for k in range(3)] == [{1.0}, {2.0}, {3.0}]
    assert (answer.head["signals"][0]["least"], answer.head["signals"][0]["greatest"]) == (1.0, 3.0)
    [facts] = ask(session, "file-lines", signals=[{"kind": "channel", "name": "none"}]).head["signals"]
    assert facts["missing"] == "none has no values"


def test_the_shift_of_a_channel_is_seen_in_the_error(session: Session) -> None:
    for channel, shift in (("u", 0.3), ("m", -0.3)):
        answer = ask(session, "shift-scan", channel=channel)
        head = answer.head
        assert head["best"] == pytest.approx(shift, abs=0.02)
        assert head["seen"]
        assert not head["atTheEnd"]
        assert 0 < head["deviation"] < 0.05
        assert answer.arrays["rmse"].min() < 0.3 < answer.arrays["rmse"][20]
        assert answer.arrays["shifts"][20] == 0.0
    # written to the project, the delay is gone
    changes = [[["dataset", number, "shift", "m"], -0.3] for number in (2, 3)]
    ask(session, "set-keys", changes=changes, title="shifted")
    assert ask(session, "shift-scan", channel="m").head["best"] == pytest.approx(0.0, abs=0.02)


def test_a_shift_that_no_error_shows_is_not_seen(session: Session) -> None:
    ask(session, "set-values", name="k", cells=[0], values=[0.0], title="edited")
    head = ask(session, "shift-scan", channel="u").head
    assert not head["seen"]
    assert head["deviation"] is None
    with pytest.raises(ArgumentError, match="extra is in no training data"):
        ask(session, "shift-scan", channel="extra")
    with pytest.raises(ArgumentError, match="no criterion 5"):
        ask(session, "shift-scan", channel="u", criterion=4)


def test_a_dataset_that_is_off_is_as_if_it_were_not_there(session: Session) -> None:
    # its file does not even exist
    rows = overview(session).datasets
    assert [(row.name, row.number) for row in rows] == [("drives", 2), ("fresh", 3)]
    assert [each["use"] for each in ask(session, "files").head["datasets"]] == ["off", "training", "test"]
    ask(session, "set-keys", changes=[[["dataset", 3, "use"], "off"]], title="off")
    assert [row.name for row in overview(session).datasets] == ["drives"]
    ask(session, "set-keys", changes=[[["dataset", 2, "use"], "off"]], title="off")
    assert session.stale
    assert "all datasets are off" in str(session.findings[0])
    session.undo()
    session.undo()
    assert not session.stale
    assert not [finding for finding in Project.read(session.path).check() if finding.severity == "error"]


def test_steady_points_are_drawn_over_their_numbers(torque: Path) -> None:
    session = Session(torque)
    answer = ask(session, "file-errors", pixels=10)
    assert not any(row["timed"] for row in answer.head["files"])
    assert answer.head["files"][0]["end"] == session.require_view().model.recordings[0].bound.dataset.samples
    assert np.isfinite(answer.arrays["0"]).all()
    # of 27 points, in place of holes between them
    number = [row["name"] for row in answer.head["files"]].index("motored.csv")
    few = ask(session, "file-lines", signals=[{"kind": "channel", "name": "Speed"}], pixels=300)
    assert few.arrays[f"0 {number}"].size == 26
    assert np.isfinite(few.arrays[f"0 {number}"]).all()
    # motored.csv lacks the target of the first criterion, which is no gap
    torque_facts = ask(session, "file-lines", signals=[{"kind": "channel", "name": "Torque"}]).head["signals"][0]
    assert torque_facts["gaps"] == {}
    with pytest.raises(ArgumentError, match="no training data with time stamps"):
        ask(session, "shift-scan", channel="Speed")


def test_a_file_with_several_groups_lists_them_with_their_steps(tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    from asammdf import MDF, Signal

    fast, slow = np.arange(0, 2, 0.01), np.arange(0, 2, 0.1)
    with MDF(version="4.10") as file:
        file.append([Signal(slow, slow, name="Speed", unit="rpm")], comment="100ms")
        file.append([Signal(fast, fast, name="Speed", unit="rpm")], comment="10ms")
        file.save(tmp_path / "drive.mf4")
    (tmp_path / "kennfeld.toml").write_text('[[dataset]]\nfiles = ["drive.mf4"]\n')
    [dataset] = questions.ask(Session(tmp_path / "kennfeld.toml"), "files").head["datasets"]
    [own] = dataset["files"]
    assert {each["name"]: each["step"] for each in own["groups"]} == pytest.approx({"100ms": 0.1, "10ms": 0.01})
    assert own["step"] == pytest.approx(0.01)
    assert [(each["name"], each["group"]) for each in own["channels"] if each["name"] != "time"] == [
        ("100ms/Speed", "100ms"),
        ("10ms/Speed", "10ms"),
    ]
