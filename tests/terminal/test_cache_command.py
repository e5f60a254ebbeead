"""Files that are kept between runs are listed and removed, and no others."""

import os

import pytest

from kennfeld import cli
from kennfeld.base.machine_code import code_cache

DIGEST = "0123456789" * 4
PROJECT = 'model.file = "m.kf"\n[[dataset]]\nfiles = "d.csv"\n[[criterion]]\nnode = "m"\ntarget = "y"\n'


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A project with one file of each kind that is kept, and others beside them."""
    (tmp_path / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    folders = {name: tmp_path / ".kennfeld" / name for name in ("cache", "partitions", "code")}
    names = {"cache": f"{DIGEST}-a-b.parquet", "partitions": f"{DIGEST}.columns", "code": f"{DIGEST}0123456789"}
    for name, folder in folders.items():
        folder.mkdir(parents=True)
        (folder / names[name]).write_bytes(b"x" * 1000)
        (folder / "mine.parquet").write_text("mine", encoding="utf-8")
    monkeypatch.setattr("kennfeld.project.kept_files.cache_folder", lambda: folders["code"])
    return tmp_path


def files(folder):
    return sorted(path.name for path in (folder / ".kennfeld").rglob("*") if path.is_file())


def test_kept_entries_are_listed(kept, capsys):
    before = files(kept)
    assert cli.run(["cache", str(kept)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines] == ["recordings that were read", "partitions", "compiled code"]
    assert all("1 file " in line for line in lines)
    assert files(kept) == before


def test_only_kept_entries_are_removed(kept):
    assert cli.run(["cache", str(kept / "kennfeld.toml"), "--clear"]) == 0
    assert files(kept) == ["mine.parquet"] * 3


def test_half_written_files_of_a_killed_process_are_removed(kept):
    for name, ending in (("cache", ".parquet"), ("partitions", ".columns"), ("code", "")):
        (kept / ".kennfeld" / name / f".{DIGEST}.4711-abcd{ending}").write_bytes(b"x")
    cli.run(["cache", str(kept), "--clear"])
    assert files(kept) == ["mine.parquet"] * 3


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="needs symbolic links")
def test_files_behind_links_stay(kept):
    target = kept / "target"
    target.write_text("mine", encoding="utf-8")
    link = kept / ".kennfeld" / "cache" / f"{DIGEST}-c-d.parquet"
    link.symlink_to(target)
    cli.run(["cache", str(kept), "--clear"])
    assert target.is_file()
    assert link.is_symlink()


def test_without_a_project_it_is_the_code_alone(kept, capsys):
    assert cli.run(["cache"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    assert code_cache.VARIABLE == "KENNFELD_CACHE"
