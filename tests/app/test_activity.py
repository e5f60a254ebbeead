"""Work that takes a while reports its progress and can be stopped."""

import threading
from pathlib import Path
from typing import Any

import pytest

from kennfeld.app.answer import Answer
from kennfeld.app.questions.overview import overview
from kennfeld.app.session.activity import Activity, StoppedError
from kennfeld.app.session.session import Session
from kennfeld.app.workspace import AppWorkspace
from kennfeld.base.errors import ArgumentError


class Reports(list[tuple[str, float | None]]):
    """The reports of an activity, which stops at a text."""

    def __init__(self, stop_at: str = "") -> None:
        super().__init__()
        self.activity = Activity(self.note)
        self._stop_at = stop_at

    def note(self, text: str, share: float | None) -> None:
        self.append((text, share))
        if self._stop_at and self._stop_at in text:
            threading.Thread(target=self.activity.stop).run()


def test_reading_tells_files_and_bytes_and_then_the_share_that_is_read(torque: Path) -> None:
    reports = Reports()
    Session(torque, activity=reports.activity)
    size = sum((torque.parent / name).stat().st_size for name in ("bench.csv", "fresh.csv", "motored.csv"))
    texts = [text for text, _ in reports]
    assert texts[0] == f"Reading recordings, 3 files, {size / 1e6:.3g} MB"
    assert reports[1:4] == [(f"Reading recordings, {k} of 3 files", pytest.approx(k / 3)) for k in (1, 2, 3)]
    assert texts[4] == "Evaluating the function over 3839 samples"


def test_a_project_whose_reading_was_stopped_is_open_and_reads_on_request(torque: Path) -> None:
    reports = Reports("1 of 3")
    session = Session(torque, activity=reports.activity)
    assert session.view is None
    assert session.interrupted
    state = overview(session)
    assert state.interrupted
    assert "you stopped it" in state.findings[0].text
    assert session.text_of("torque.kf")
    reports._stop_at = ""
    reports.activity.begin()
    session.reload()
    assert not session.interrupted
    assert session.view is not None


def test_a_stop_leaves_no_part_of_a_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    workspace = AppWorkspace()
    pushed: list[tuple[str, Any]] = []

    def push(topic: str, news: Answer, project: str) -> None:
        pushed.append((topic, news.head))
        if news.head.get("text", "").startswith("Writing the demo"):
            workspace.stop_activity()

    workspace.subscribe(push, lambda project: None)
    with pytest.raises(ArgumentError, match="stopped; nothing has changed"):
        workspace.answer("demo", {"name": "torque"})
    assert [*tmp_path.iterdir()] == []
    assert pushed[0] == ("activity", {"text": "Writing the demo into kennfeld-demo-torque", "share": None})
    assert pushed[-1] == ("activity", {"text": "", "share": None})


def test_an_earlier_wish_to_stop_does_not_stop_what_comes_later() -> None:
    activity = Activity()
    activity.stop()
    with pytest.raises(StoppedError):
        activity.say("first")
    activity.begin()
    activity.say("second")
