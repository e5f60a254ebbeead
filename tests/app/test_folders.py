"""Paths that a page may name."""

from pathlib import Path

import pytest

from kennfeld.app.folders import confined, free_path, writable
from kennfeld.base.errors import ArgumentError, InputError


@pytest.mark.parametrize(
    "name", ["../secret.txt", "a/../../secret.txt", "/etc/passwd", "link/secret.txt", "\0", "x" * 5000]
)
def test_paths_outside_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "secret.txt").write_text("secret")
    inside = tmp_path / "project"
    inside.mkdir()
    (inside / "link").symlink_to(tmp_path)
    with pytest.raises(ArgumentError):
        confined(inside, name)


def test_a_link_within_the_folder_is_followed(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x")
    (tmp_path / "b.csv").symlink_to(tmp_path / "a.csv")
    assert confined(tmp_path, "b.csv").name == "a.csv"


@pytest.mark.parametrize(
    ("name", "stored"),
    [
        ("run.csv", "run.csv"),
        ("../../run.csv", "run.csv"),
        ("C:\\data\\run.mf4", "run.mf4"),
        ("...", "file"),
        ("a\nb.csv", "a_b.csv"),
        ("<img src=x>.csv", "_img src=x_.csv"),
        ("CON", "_CON"),
        ("nul.csv", "_nul.csv"),
        ("com1.tar.gz", "_com1.tar.gz"),
        ("a.csv. . ", "a.csv"),
        ("gpj\u202evsc.exe", "gpj_vsc.exe"),
        ("a\u200bb.csv", "a_b.csv"),
        ("\ud800.csv", "_.csv"),
    ],
)
def test_dropped_files_get_plain_names(tmp_path: Path, name: str, stored: str) -> None:
    assert free_path(tmp_path, name) == tmp_path / stored


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("x")
    assert free_path(tmp_path, "run.csv").name == "run-2.csv"


@pytest.mark.parametrize("letter", ["x", "\u00e4", "\u6f22", "\U0001f600"])
def test_a_name_of_any_length_can_be_stored(tmp_path: Path, letter: str) -> None:
    path = free_path(tmp_path, f"{letter * 255}.csv")
    path.write_text("x")
    assert path.suffix == ".csv"
    assert len(path.name.encode()) <= 200
    assert free_path(tmp_path, f"{letter * 255}.csv") != path


def test_a_link_that_leads_nowhere_takes_its_name(tmp_path: Path) -> None:
    (tmp_path / "run.csv").symlink_to(tmp_path / "gone.csv")
    assert free_path(tmp_path, "run.csv").name == "run-2.csv"


@pytest.mark.parametrize(
    "name", ["../a.csv", "/a.csv", "a/../../a.csv", "C:\\a.csv", "link/a.csv", "link", "..\\a.csv", "a\u202e.csv", "\0"]
)
def test_nothing_is_written_outside_or_through_a_link(tmp_path: Path, name: str) -> None:
    inside = tmp_path / "project"
    inside.mkdir()
    (inside / "link").symlink_to(tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        writable(inside, name)


def test_the_folder_itself_may_be_reached_by_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert writable(tmp_path / "link", "deep/a.csv") == tmp_path / "link/deep/a.csv"
