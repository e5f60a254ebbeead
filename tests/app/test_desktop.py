"""Files that are opened on the desktop."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from kennfeld.app import desktop
from kennfeld.app.questions import QUESTIONS
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Have a desktop that only notes what it is to open."""
    programs: list[list[str]] = []

    def note(command: list[str], **_: Any) -> None:
        programs.append(command)

    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(subprocess, "Popen", note)
    return programs


def test_exported_files_and_their_folder_are_opened(torque: Path, started: list[list[str]]) -> None:
    session = Session(torque)
    files = QUESTIONS["export"](session, {"formats": [".dcm"]}).head["files"]
    assert files == ["results/parameters.dcm"]
    QUESTIONS["open-file"](session, {"file": files[0]})
    QUESTIONS["open-file"](session, {})
    results = torque.parent.resolve() / "results"
    assert started == [["xdg-open", str(results / "parameters.dcm")], ["xdg-open", str(results)]]


@pytest.mark.parametrize("name", ["../other.txt", "/etc/hostname", "gone.csv"])
def test_only_files_of_the_project_are_opened(torque: Path, started: list[list[str]], name: str) -> None:
    (torque.parent.parent / "other.txt").write_text("")
    with pytest.raises(ArgumentError, match=r"is outside of|is not a file"):
        QUESTIONS["open-file"](Session(torque), {"file": name})
    assert started == []


def test_what_a_desktop_may_run_is_not_opened(torque: Path, started: list[list[str]]) -> None:
    (torque.parent / "calibrate.PY").write_text("")
    with pytest.raises(ArgumentError, match="not of a kind"):
        QUESTIONS["open-file"](Session(torque), {"file": "calibrate.PY"})
    assert started == []


def test_without_a_desktop_files_are_downloaded_only(torque: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    session = Session(torque)
    assert not QUESTIONS["formats"](session, {}).head["opens"]
    with pytest.raises(ArgumentError, match="has no desktop"):
        desktop.open_on_desktop(torque)
