"""The folder of a project as a download: what is in it, and what is not."""

import io
import zipfile
from pathlib import Path

import pytest

from kennfeld.app import archive
from kennfeld.app.archive import write_archive
from kennfeld.base.errors import ArgumentError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    own = tmp_path / "project"
    (own / "results").mkdir(parents=True)
    (own / ".kennfeld").mkdir()
    (own / "kennfeld.toml").write_text("[model]\n")
    (own / "results" / "parameters.json").write_text("{}")
    (own / ".kennfeld" / "kennfeld.unsaved.json").write_text("{}")
    (own / ".data.csv.part").write_text("half")
    return own


def names(folder: Path) -> list[str]:
    target = io.BytesIO()
    write_archive(folder, target)
    return zipfile.ZipFile(target).namelist()


def test_the_files_are_in_a_folder_without_recovery_files(folder: Path) -> None:
    assert names(folder) == ["project/kennfeld.toml", "project/results/parameters.json"]


def test_links_are_not_followed(folder: Path) -> None:
    (folder.parent / "secret").mkdir()
    (folder.parent / "secret" / "key").write_text("secret")
    (folder / "link").symlink_to(folder.parent / "secret")
    (folder / "key").symlink_to(folder.parent / "secret" / "key")
    assert names(folder) == ["project/kennfeld.toml", "project/results/parameters.json"]


@pytest.mark.parametrize(("limit", "value"), [("MAX_BYTES", 5), ("MAX_FILES", 1)])
def test_a_folder_that_is_too_large_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, limit: str, value: int
) -> None:
    monkeypatch.setattr(archive, limit, value)
    with pytest.raises(ArgumentError, match="copy the folder instead"):
        names(folder)
