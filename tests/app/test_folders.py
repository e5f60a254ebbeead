"""Paths that a page may name."""

from pathlib import Path

import pytest

from kennfeld.app.folders import confined, free_path
from kennfeld.errors import ArgumentError


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
    ],
)
def test_dropped_files_get_plain_names(tmp_path: Path, name: str, stored: str) -> None:
    assert free_path(tmp_path, name) == tmp_path / stored


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("x")
    assert free_path(tmp_path, "run.csv").name == "run-2.csv"
