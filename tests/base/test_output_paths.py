"""Paths that a command or the app may write."""

import os
from pathlib import Path

import pytest

from kennfeld.base.output_paths import below, is_below, is_link, is_plain_name, plain_name, within

links = pytest.mark.skipif(os.name != "posix", reason="making links needs rights on Windows")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    folder = tmp_path / "project"
    folder.mkdir()
    return folder


@pytest.mark.parametrize("name", ["a.csv", "deep/a.csv", ".kennfeld/cache", "a b.csv", "\u00e4.csv", "a:b.csv"])
def test_names_within_are_paths(project: Path, name: str) -> None:
    if os.name == "nt" and ":" in name:
        pytest.skip("not a name on Windows")
    assert within(project, name) == project / name


@pytest.mark.parametrize(
    "name", ["..", "../a", "a/../..", "/a", "C:\\a", "\\\\server\\a", "a\nb", "a\u202eb", "a\0", "a\\b"]
)
def test_other_names_are_refused(project: Path, name: str) -> None:
    with pytest.raises(OSError, match=r"it is outside of the folder|is not a name for a file"):
        within(project, name)


@links
@pytest.mark.parametrize("name", ["link", "link/a", "nowhere", "self", "deep/link/a"])
def test_no_part_may_be_a_link(project: Path, name: str) -> None:
    (project / "deep").mkdir()
    for link, target in (("link", ".."), ("nowhere", "gone"), ("self", "self"), ("deep/link", "..")):
        (project / link).symlink_to(target)
    with pytest.raises(OSError, match="it is a symbolic link to"):
        within(project, name)


@links
def test_files_named_by_the_user_may_be_links(project: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path)
    (project / "link").symlink_to(tmp_path)
    assert below(project, tmp_path / "link" / "a") == tmp_path / "link" / "a"
    with pytest.raises(OSError, match="symbolic link"):
        below(project, project / "link" / "a")
    with pytest.raises(OSError, match="symbolic link"):  # the project by another way
        below(project, tmp_path / "link" / "project" / "link" / "a")


@links
def test_a_way_back_through_a_link_is_outside(project: Path, tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (project / "link").symlink_to(tmp_path / "deep")
    assert not is_below(project, project / "link" / ".." / "a")
    assert is_below(project, project / "deep" / "a")
    assert not is_below(project, tmp_path / "a")


def test_a_file_is_not_a_link(project: Path) -> None:
    (project / "a").write_text("")
    assert not is_link(project / "a")
    assert not is_link(project / "gone")


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a\\b", "\u202e", "a\x7f", "\ud800"])
def test_names_that_are_not_plain(name: str) -> None:
    assert not is_plain_name(name)
    assert is_plain_name(plain_name(name))
