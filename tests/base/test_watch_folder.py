"""The folder by which a process is watched, and what is removed with it."""

from pathlib import Path

import pytest

from kennfeld.base.atomic_files import replace_atomically
from kennfeld.base.watch_folder import FOLDER, note_temporary, remove_noted, watch_folder


def test_a_temporary_file_that_a_crash_leaves_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path))
    target = tmp_path / "result.json"
    with replace_atomically(target) as temporary:
        temporary.write_text("half")
        remove_noted(tmp_path)  # as another process does after a crash at this place
        assert not temporary.exists()
        temporary.write_text("whole")
    remove_noted(tmp_path)
    assert target.read_text() == "whole"


def test_names_with_line_breaks_are_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path))
    file = tmp_path / "a\nb"
    file.touch()
    note_temporary(file)
    remove_noted(tmp_path)
    assert not file.exists()


def test_without_a_watching_process_nothing_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(FOLDER, raising=False)
    note_temporary(tmp_path / "file")
    assert watch_folder() is None
    assert list(tmp_path.iterdir()) == []
